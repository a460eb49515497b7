//! Monte Carlo studies: swing-ups from many random starts at rest, on several threads.

pub mod closed_loop;
pub mod condition;
pub mod contender;
pub mod replan;
pub mod robustness;
mod runs;
mod statistics;
pub mod variation;

pub use runs::{RunsError, StudyIdentity, StudyRuns};
pub use statistics::{Spread, wilson};

use crate::closed_loop::{Aborted, Disturbances, ReplanCounts, RunOptions, swing_up};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, PendulumStart};
use upswing_ipc::Telemetry;
use upswing_model::{ActuatedVector, Model, State};
use upswing_ocp::qp::QpSolver;
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswing_record::evaluation::SwingUpEvaluation;

/// Largest rest angle of the unactuated joints at a start, rad: 5 deg below the limit of joint 9, Table II.
const LARGEST_REST_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;
/// Largest number of poses drawn for one start. In the paper's ranges about half of all poses are suitable.
const DRAWS: u32 = 1000;
/// Numbers of the generator's sequence reserved for one start: more than its draws use, and odd, because jumps by a
/// power of two repeat the low bits of a linear congruential generator.
const BLOCK: u128 = 1_000_003;

/// Error: no random pose within the ranges of the grid has a rest position of the pendulum within its limits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the ranges of the grid hold no start: in none of {DRAWS} random poses the pendulum hangs within {:.0} deg; \
     choose ranges with poses in which it does", LARGEST_REST_ANGLE.to_degrees()
)]
pub struct NoStart;

/// Random starts at standstill, uniform in the ranges of the grid's axes (Section VI of the paper); the pendulum hangs at rest within
/// 40 deg.
#[derive(Clone, Copy, Debug)]
pub struct RandomStarts<'a> {
    /// Settings with the grid's ranges, the limits and the model.
    pub config: &'a Config,
    /// Seed of the random numbers; starts of different seeds are independent.
    pub seed: u64,
}

impl RandomStarts<'_> {
    /// The state of start number `index`; a function of index, seed and settings only.
    ///
    /// # Errors
    /// [`NoStart`] if none of the drawn poses is suitable.
    pub fn start(&self, index: u64) -> Result<State, NoStart> {
        let mut rng = self.generator(index);
        for _ in 0..DRAWS {
            let mut q_a = ActuatedVector::zeros(self.config.model.sizes());
            for axis in self.config.manoeuvres.iter().take(1).flat_map(|first| &first.grid.axes) {
                q_a[axis.joint] = axis.from + (axis.to - axis.from) * unit(&mut rng);
            }
            if let Ok(x) = self.config.start_state(&q_a, PendulumStart::Rest)
                && x.q_u().amax() <= LARGEST_REST_ANGLE
            {
                return Ok(x);
            }
        }
        Err(NoStart)
    }

    /// A random number in [0, 1) of start number `index`, independent of its pose.
    pub fn share(&self, index: u64) -> f64 {
        self.shares(index).next().unwrap_or_default()
    }

    /// Random numbers in [0, 1) of start number `index`, at most half a million; [`Self::share`] is the first.
    pub fn shares(&self, index: u64) -> impl Iterator<Item = f64> + use<> {
        let mut rng = self.generator(index);
        rng.advance(BLOCK / 2);
        std::iter::repeat_with(move || unit(&mut rng))
    }

    fn generator(&self, index: u64) -> Pcg64 {
        let mut rng = Pcg64::seed_from_u64(self.seed);
        rng.advance(u128::from(index) * BLOCK);
        rng
    }
}

/// A random number, uniform in [0, 1): the upper 53 bits, the precision of an `f64`.
fn unit(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Positions of the actuated joints in the state `x`, deg or m.
pub fn shown_pose(model: &Model, x: &State) -> Vec<f64> {
    x.q_a().iter().enumerate().map(|(i, q)| model.joint_kind(i).shown(*q).0).collect()
}

/// A study of many runs from random starts.
pub struct Study<'a> {
    /// The planner of all runs; its settings are also those of the controller.
    pub planner: &'a Planner,
    /// Random starts of the runs.
    pub starts: RandomStarts<'a>,
    /// Numbers of the starts to run.
    pub indices: Vec<u64>,
    /// Runs in files, of a shard or of all shards; `None`: the study runs all jobs and keeps no file.
    pub runs: Option<&'a StudyRuns>,
    /// Number of threads.
    pub threads: usize,
    /// Set to true to end the study: runs in progress are completed, the others are skipped.
    pub stop: &'a AtomicBool,
    /// Called after each run, also after a skipped one.
    pub progress: &'a (dyn Fn() + Sync),
}

/// Error of a study without a result.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The ranges of the grid contain no suitable start.
    #[error(transparent)]
    NoStart(#[from] NoStart),
    /// The files of a shard, or of all shards, cannot be used.
    #[error(transparent)]
    Runs(#[from] RunsError),
    /// The threads could not be started.
    #[error("cannot start threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

impl Study<'_> {
    /// Executes `work` for each of the `jobs` of a `part` of the study on all threads, each with its own `scratch`; results in the order of
    /// the jobs, without skipped ones. Jobs of other shards are skipped, the results of those in files are taken from there.
    ///
    /// # Errors
    /// [`StudyError`]
    pub fn each<S, T: Send + Serialize + DeserializeOwned>(
        &self,
        part: usize,
        jobs: &[u64],
        scratch: impl Fn() -> S + Sync + Send,
        work: impl Fn(&mut S, u64) -> Result<T, NoStart> + Sync + Send,
    ) -> Result<Vec<T>, StudyError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.threads).build()?;
        let results: Vec<Result<Option<T>, StudyError>> = pool.install(|| {
            jobs.par_iter()
                .map_init(&scratch, |scratch, job| {
                    let result = self.result_of(part, *job, || work(scratch, *job));
                    (self.progress)();
                    result
                })
                .collect()
        });
        results.into_iter().filter_map(Result::transpose).collect()
    }

    /// The result of a job, from a file or from `work`; `None` if it is skipped.
    fn result_of<T: Serialize + DeserializeOwned>(
        &self,
        part: usize,
        job: u64,
        work: impl FnOnce() -> Result<T, NoStart>,
    ) -> Result<Option<T>, StudyError> {
        if self.runs.is_some_and(|runs| runs.skips(job)) {
            return Ok(None);
        }
        if let Some(runs) = self.runs
            && let Some(known) = runs.result(part, job)?
        {
            return Ok(Some(known));
        }
        if self.stop.load(Ordering::Acquire) || self.runs.is_some_and(StudyRuns::failed) {
            return Ok(None);
        }
        let result = work()?;
        if let Some(runs) = self.runs {
            runs.append(part, job, &result);
        }
        Ok(Some(result))
    }
}

/// Scratch memory of a thread, reused from one swing-up to the next.
struct Scratch {
    solver: QpSolver,
    /// Every control cycle of the last swing-up.
    records: Vec<Telemetry>,
    /// What continuous replanning did in the last swing-up.
    replans: ReplanCounts,
}

impl Scratch {
    fn new(planner: &Planner) -> Self {
        Self { solver: planner.solver(), records: Vec::new(), replans: ReplanCounts::default() }
    }

    /// Swings up from start number `index`, with the pendulum in the rest position of this plant, and balances for `seconds` (s).
    /// `controller` and `plant` are the settings of controller and plant; `disturbances` maps t_F (s) to the disturbances; `options` may replace
    /// plan and controller.
    fn swing_up(
        &mut self,
        planner: &Planner,
        (index, start): (u64, &State),
        controller: &Config,
        mut plant: Config,
        seconds: f64,
        disturbances: impl FnOnce(f64) -> Disturbances,
        options: RunOptions<'_>,
    ) -> Result<SwingUpEvaluation, Aborted> {
        plant.plant.start.q = start.q_a();
        plant.plant.start.pendulum = PendulumStart::Rest;
        plant.plant.encoder.seed = plant.plant.encoder.seed.wrapping_add(index);
        let plant = Plant::new(&plant)?;
        self.replans = ReplanCounts::default();
        let options = RunOptions { replans: Some(&mut self.replans), ..options };
        let Self { solver, records, .. } = self;
        swing_up(planner, solver, controller, plant, seconds, disturbances, options, records)
    }
}

/// Kind of failure of a run that was completed without success.
const ENDED_BADLY: &str = "came to its end, but not as it should";
