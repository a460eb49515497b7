//! Plans and controllers of others in the runs of a study, and plans in files.

use crate::closed_loop::RunOptions;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use upswing_config::{Config, read_file};
use upswing_model::{ActuatedVector, JointVector, State, Workspace};
use upswing_ocp::lqr::synthesize;
use upswing_planner::offline::{lqr_recursion, lqr_weights};
use upswing_trajectory::{INTERVALS, Plan, Trajectory};
use xxhash_rust::xxh3::xxh3_64;

/// What takes the place of planner and controller in the runs of a study.
pub trait Contender: Sync {
    /// Plan and controller of the run from start number `index`, with the state `start` of the model.
    ///
    /// # Errors
    /// Why there is no plan for this start; the run has failed.
    fn options(&self, index: u64, start: &State) -> Result<RunOptions<'_>, String>;
}

/// A plan for each start of a study. Their gains are those of the LQR (23) with the weights of the settings.
#[derive(Clone, Debug)]
pub struct GivenPlans<'a> {
    config: &'a Config,
    trajectories: Vec<Option<Trajectory>>,
    fingerprint: u64,
}

/// Error of a file of plans.
#[derive(Debug, thiserror::Error)]
pub enum GivenPlansError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Cause.
        cause: std::io::Error,
    },
    /// The file is not a sequence of JSON documents of plans.
    #[error(
        "{}: plan {index}: {cause}; expected JSON documents one after the other, each a plan as `upswing plan --json` prints it, or null",
        path.display()
    )]
    Document {
        /// The file.
        path: PathBuf,
        /// Number of the plan, that of its start.
        index: usize,
        /// Cause.
        cause: serde_json::Error,
    },
    /// A plan is not one of this system.
    #[error("{}: plan {index}: {reason}", path.display())]
    Plan {
        /// The file.
        path: PathBuf,
        /// Number of the plan, that of its start.
        index: usize,
        /// What is expected, and what it is.
        reason: String,
    },
    /// A start has no plan.
    #[error("{}: expected a plan for each of {expected} starts, or null, got {got}; choose fewer starts", path.display())]
    Few {
        /// The file.
        path: PathBuf,
        /// Number of starts.
        expected: u64,
        /// Number of plans.
        got: usize,
    },
}

/// A plan in a file: that of `upswing plan --json` and `upswing optimize --json`, with x, or that of the exports of the Python package, with q and
/// qd; joints in the chain's order.
#[derive(Deserialize)]
struct PlanDocument {
    /// s
    t_f: f64,
    /// Rows [q, qd].
    x: Option<Vec<Vec<f64>>>,
    q: Option<Vec<Vec<f64>>>,
    qd: Option<Vec<Vec<f64>>>,
    u: Vec<Vec<f64>>,
    /// Times of the rows, s; uniform ones without.
    t: Option<Vec<f64>>,
    /// Names of the joints; those of the system without.
    joints: Option<Vec<String>>,
    actuated: Option<Vec<String>>,
}

impl PlanDocument {
    /// The trajectory of these rows for the system of `config`; otherwise what is expected.
    fn trajectory(self, config: &Config) -> Result<Trajectory, String> {
        let (model, sizes, order) = (&config.model, config.model.sizes(), config.model.order());
        let same = |what: &str, got: Option<Vec<String>>, expected: Vec<&str>| match got {
            Some(got) if got != expected => {
                Err(format!("expected the {what} {}, got {}", expected.join(", "), got.join(", ")))
            }
            _ => Ok(()),
        };
        same("joints", self.joints, model.joint_names().collect())?;
        same("actuated joints", self.actuated, (0..sizes.actuated()).map(|i| model.joint_name(i)).collect())?;
        let x = match (self.x, self.q, self.qd) {
            (Some(x), None, None) => x,
            (None, Some(q), Some(qd)) if q.len() == qd.len() => {
                q.into_iter().zip(qd).map(|(q, qd)| [q, qd].concat()).collect()
            }
            _ => return Err("expected rows `x`, or as many rows `q` as `qd`".into()),
        };
        let intervals = x.len().saturating_sub(1);
        if !INTERVALS.contains(&intervals) || self.u.len() != x.len() {
            let (least, most) = (INTERVALS.start() + 1, INTERVALS.end() + 1);
            let (states, inputs) = (x.len(), self.u.len());
            return Err(format!(
                "expected {least} to {most} knots, as many states as inputs, got {states} and {inputs}"
            ));
        }
        let t_f = self.t_f;
        if !(t_f > 0.0 && t_f <= Trajectory::LONGEST) {
            return Err(format!("`t_f`: expected above 0 to {} s, got {t_f}", Trajectory::LONGEST));
        }
        if let Some(t) = self.t {
            /// Of t_F; digits that a file may leave out.
            const ROUNDING: f64 = 1e-6;
            let uniform =
                |(k, t): (usize, &f64)| (t - t_f * k as f64 / intervals as f64).abs() <= ROUNDING * t_f;
            if t.len() != x.len() || !t.iter().enumerate().all(uniform) {
                return Err("`t`: expected uniform times from 0 to t_f, one per knot".into());
            }
        }
        let row = |name: &str, k: usize, row: &[f64], width: usize| {
            let finite = row.iter().all(|v| v.is_finite());
            match row.len() == width && finite {
                true => Ok(()),
                false => Err(format!("`{name}`, knot {k}: expected {width} finite numbers, got {row:?}")),
            }
        };
        let joints = |values: &[f64]| JointVector::from_fn(sizes, |c| values[order.joint(c)]);
        let mut trajectory = Trajectory { t_f, x: Vec::new(), u: Vec::new() };
        for (k, (x, u)) in x.iter().zip(&self.u).enumerate() {
            row("x", k, x, sizes.state())?;
            row("u", k, u, sizes.actuated())?;
            let (q, qd) = x.split_at(sizes.joints());
            trajectory.x.push(State::new(&joints(q), &joints(qd)));
            trajectory.u.push(ActuatedVector::from_fn(sizes, |i| u[i]));
        }
        Ok(trajectory)
    }
}

impl<'a> GivenPlans<'a> {
    /// Reads plans, the i-th one for start number i: JSON documents one after the other, each as `upswing plan --json` prints it, or null for
    /// a start without a plan.
    ///
    /// # Errors
    /// [`GivenPlansError`] if the file cannot be read, or is not made of plans of this system.
    pub fn read(path: &Path, config: &'a Config) -> Result<Self, GivenPlansError> {
        let bytes = read_file(path).map_err(|cause| GivenPlansError::Io { path: path.to_owned(), cause })?;
        let documents = serde_json::Deserializer::from_slice(&bytes).into_iter::<Option<PlanDocument>>();
        let trajectories = documents.enumerate().map(|(index, document)| {
            let path = || path.to_owned();
            document
                .map_err(|cause| GivenPlansError::Document { path: path(), index, cause })?
                .map(|plan| plan.trajectory(config))
                .transpose()
                .map_err(|reason| GivenPlansError::Plan { path: path(), index, reason })
        });
        let trajectories = trajectories.collect::<Result<_, _>>()?;
        Ok(Self { config, trajectories, fingerprint: xxh3_64(&bytes) })
    }

    /// Fails unless there are plans for the first `starts` starts, for the message that names `path`.
    ///
    /// # Errors
    /// [`GivenPlansError::Few`]
    pub fn require(&self, starts: u64, path: &Path) -> Result<(), GivenPlansError> {
        let got = self.trajectories.len();
        match (got as u64) < starts {
            true => Err(GivenPlansError::Few { path: path.to_owned(), expected: starts, got }),
            false => Ok(()),
        }
    }

    /// XXH3 hash of the file.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }
}

impl Contender for GivenPlans<'_> {
    fn options(&self, index: u64, _: &State) -> Result<RunOptions<'_>, String> {
        let given = usize::try_from(index).ok().and_then(|index| self.trajectories.get(index)?.clone());
        let trajectory = given.ok_or("the file has no plan for this start")?;
        let Config { model, planner, daemon, .. } = self.config;
        let weights = lqr_weights(planner, model.sizes());
        let (period, recursion) = (daemon.cycle.period.seconds(), lqr_recursion(planner));
        let gains = synthesize(model, &trajectory, &weights, period, recursion, &mut Workspace::default())
            .map_err(|e| e.to_string())?;
        Ok(RunOptions { plan: Some(Plan::new(model, trajectory, gains)), ..RunOptions::default() })
    }
}
