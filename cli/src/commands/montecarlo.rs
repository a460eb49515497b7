//! `upswing montecarlo`: repeats plans or swing-ups from many random starts.

mod closed_loop;
mod replan;
mod robustness;

use super::{CommonArgs, progress_bar, writable};
use clap::ValueEnum;
use serde::Serialize;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use upswing_config::Config;
use upswing_ipc::Telemetry;
use upswing_planner::database::{self, DatabaseFile};
use upswing_planner::replan::Planner;
use upswing_process::Failure;
use upswing_process::number::whole;
use upswing_process::output::{Destination, OutputFile, Overwrite};
use upswing_process::shard::Shard;
use upswing_rig::montecarlo::{
    NoStart, RandomStarts, RunsError, Spread, Study, StudyError, StudyIdentity, StudyRuns,
};
use upswing_view::picture;

pub use closed_loop::ClosedLoopArgs;
pub use replan::ReplanArgs;
pub use robustness::RobustnessArgs;

/// Plans or swings up from many random starts and counts successes.
///
/// Example: upswing montecarlo replan --samples 1000
#[derive(Clone, Debug, clap::Args)]
pub struct MonteCarloArgs {
    /// The study.
    #[command(subcommand)]
    pub command: MonteCarloCommand,
}

/// Studies.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum MonteCarloCommand {
    /// Plan, and let the daemon check the plans
    ///
    /// Starts are uniform in the ranges of the grid (the paper's, Section VI), the pendulum hangs at rest within
    /// 40 deg. The same seed gives the same results on any number of threads, except for times.
    ///
    /// Example: upswing montecarlo replan --samples 1000 --seed 1 --svg margins.svg
    Replan(ReplanArgs),
    /// Plan, swing up and balance with controller and simulated plant in lock-step
    ///
    /// The starts are those of `montecarlo replan` with the same seed.
    ///
    /// Example: upswing montecarlo closed-loop --samples 100 --condition nominal,arm-mass,second-arm
    ClosedLoop(ClosedLoopArgs),
    /// Success rate of closed-loop over growing errors of one kind, as a curve
    ///
    /// All values of all curves use the same starts, those of the other two commands with the same seed. A failed start is
    /// repeated with --only and its value.
    ///
    /// Example: upswing montecarlo robustness --over torque-delay,friction --samples 100 --svg curves.svg
    Robustness(RobustnessArgs),
}

/// Options of every study.
#[derive(Clone, Debug, clap::Args)]
pub struct SamplingArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Number of starts
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = whole(1, MOST))]
    pub samples: u64,
    /// Seed of the random starts
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole(0, u64::MAX))]
    pub seed: u64,
    /// Run only start number INDEX, counted from 0, to repeat one result of a longer run
    #[arg(long, value_name = "INDEX", conflicts_with = "samples", value_parser = whole(0, u64::MAX))]
    pub only: Option<u64>,
    /// Database of the planner; `paper` is built first, which takes up to a minute
    #[arg(long, default_value = "default")]
    pub grid: Grid,
    /// Database file of the planner, from `upswing db build`
    #[arg(long, value_name = "FILE", conflicts_with = "grid")]
    pub database: Option<PathBuf>,
    /// Number of threads, 1 to 1024 [default: one per core]
    #[arg(long, value_name = "N", value_parser = whole(1_u16, 1024))]
    pub threads: Option<u16>,
    /// Run only shard i of n; needs --output
    #[arg(long, value_name = "i/n", requires = "output")]
    pub shard: Option<Shard>,
    /// Append each run to this file, for --merge; repeated, the command goes on from where it was interrupted
    #[arg(long, value_name = "FILE", conflicts_with = "only")]
    pub output: Option<Destination>,
    /// Take the runs from the files of all shards, made with the same options, instead of running them
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["output", "only"])]
    pub merge: Vec<PathBuf>,
}

/// Most starts: a month on two cores.
const MOST: u64 = 100_000_000;

/// Databases without a file.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Grid {
    /// The database of the settings
    Default,
    /// The paper's 4 x 4 x 4 x 4 poses
    Paper,
}

/// Runs a study.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &MonteCarloArgs) -> Result<(), Failure> {
    match &args.command {
        MonteCarloCommand::Replan(args) => replan::run(args),
        MonteCarloCommand::ClosedLoop(args) => closed_loop::run(args),
        MonteCarloCommand::Robustness(args) => robustness::run(args),
    }
}

/// Converts the error of a study: ranges without a valid start are [`Failure::BadInput`].
fn study_failure(e: StudyError) -> Failure {
    match e {
        StudyError::NoStart(_) => Failure::bad_input(e),
        StudyError::Runs(e) => runs_failure(e),
        StudyError::Threads(_) => Failure::failed(e),
    }
}

/// Converts the error of a file of runs: files that do not belong together are [`Failure::BadInput`].
fn runs_failure(e: RunsError) -> Failure {
    match e {
        RunsError::Journal(_) | RunsError::File { action: "write", .. } => Failure::failed(e),
        e => Failure::bad_input(e),
    }
}

/// Result of one shard.
#[derive(Serialize)]
struct ShardResult {
    success: bool,
    file: PathBuf,
    shard: u64,
    shards: u64,
    runs: usize,
    resumed: usize,
    left: usize,
}

impl std::fmt::Display for ShardResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { file, shard, shards, runs, resumed, .. } = self;
        write!(f, "{}: shard {shard} of {shards}, {runs} runs", file.display())?;
        if *resumed > 0 { write!(f, "; {resumed} were there already") } else { Ok(()) }
    }
}

/// Draws the `records` of one run to `output`.
fn draw_run(
    output: &OutputFile,
    config: &Config,
    records: Result<Vec<Telemetry>, NoStart>,
) -> Result<(), Failure> {
    let records = records.map_err(|e| study_failure(e.into()))?;
    let period = config.daemon.cycle.period.seconds();
    picture::draw(output, &records, &config.model, &config.robot.limits, period).map_err(Failure::failed)
}

impl SamplingArgs {
    /// Creates the planner with the database of the options. `change` may change the settings; setting `stop` ends the build of a database.
    fn planner(&self, change: impl FnOnce(&mut Config), stop: &AtomicBool) -> Result<Planner, Failure> {
        let mut config = self.common.process.load()?;
        change(&mut config);
        let stored = |path: &Path| DatabaseFile::open(path).map_err(Failure::bad_input);
        match (&self.database, self.grid) {
            (Some(path), _) => Planner::with_database(config, 0, stored(path)?),
            (None, Grid::Paper) => {
                config.use_paper_grid()?;
                let dir = tempfile::tempdir()
                    .map_err(|e| Failure::failed(format!("no folder for the database: {e}")))?;
                let path = dir.path().join("paper.bin");
                build_database(&config, &path, stop)?;
                let database = DatabaseFile { origin: "the paper's grid".into(), ..stored(&path)? };
                Planner::with_database(config, 0, database)
            }
            (None, Grid::Default) => Planner::new(config),
        }
        .map_err(Failure::bad_input)
    }

    /// Indices of the starts.
    fn indices(&self) -> Vec<u64> {
        self.only.map_or_else(|| (0..self.samples).collect(), |index| vec![index])
    }

    /// Number of threads.
    fn threads(&self) -> usize {
        let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        self.threads.map_or_else(cores, usize::from)
    }

    /// Result of a run over `samples` starts: [`Failure::Failed`] if it was interrupted or a start failed.
    fn verdict(&self, complete: bool, samples: usize, succeeded: usize) -> Result<(), Failure> {
        match (complete, samples - succeeded) {
            (true, 0) => Ok(()),
            (true, n) => {
                Err(Failure::failed(format!("{n} of {samples} starts failed; --only INDEX repeats one")))
            }
            (false, _) => Err(Failure::failed(format!("interrupted after {samples} starts"))),
        }
    }

    /// The shard of --shard.
    fn share(&self) -> Shard {
        self.shard.unwrap_or(Shard::WHOLE)
    }

    /// Opens the files of --output or --merge, for the `study` whose results `options` determine besides these options, the settings and the
    /// database.
    fn runs(
        &self,
        study: &'static str,
        planner: &Planner,
        options: &dyn Debug,
        overwrite: Overwrite,
    ) -> Result<Option<StudyRuns>, Failure> {
        let config = planner.config();
        let settings = (&config.robot, &config.planner, &config.daemon, &config.plant, &config.manoeuvres);
        let models = [&config.model, &config.plant_model].map(|model| model.fingerprint());
        let all = (self.samples, self.seed, models, planner.fingerprint(0), settings, options);
        let identity = StudyIdentity::new(study, &all);
        let runs = match &self.output {
            Some(output) => StudyRuns::of_shard(&identity, self.share(), &overwrite.output(output)),
            None if self.merge.is_empty() => return Ok(None),
            None => StudyRuns::merged(&identity, &self.merge),
        };
        runs.map(Some).map_err(runs_failure)
    }

    /// Completes the file of a shard that has `done` runs of its share of the `jobs`, and prints its result. `None` without --output.
    fn conclude_shard(
        &self,
        runs: Option<StudyRuns>,
        jobs: impl Iterator<Item = u64>,
        done: usize,
    ) -> Option<Result<(), Failure>> {
        let (shard, output) = (self.share(), self.output.as_deref()?);
        let share = jobs.filter(|job| shard.contains(*job)).count();
        let conclude = || {
            let resumed = runs.as_ref().map_or(0, StudyRuns::known);
            runs.map_or(Ok(()), StudyRuns::finish).map_err(runs_failure)?;
            let left = share.saturating_sub(done);
            self.common.print(&ShardResult {
                success: left == 0,
                file: output.to_owned(),
                shard: shard.number,
                shards: shard.of,
                runs: done,
                resumed,
                left,
            })?;
            match left {
                0 => Ok(()),
                n => Err(Failure::failed(format!(
                    "interrupted with {n} runs left; the same command goes on from here"
                ))),
            }
        };
        Some(conclude())
    }

    /// Runs `work` on the study of these options, with a progress bar over its `jobs`.
    fn study<T>(
        &self,
        planner: &Planner,
        runs: Option<&StudyRuns>,
        jobs: usize,
        stop: &AtomicBool,
        work: impl FnOnce(&Study<'_>) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let bar = progress_bar(jobs as u64, "runs");
        let study = Study {
            planner,
            starts: RandomStarts { config: planner.config(), seed: self.seed },
            indices: self.indices(),
            runs,
            threads: self.threads(),
            stop,
            progress: &|| bar.inc(1),
        };
        let result = work(&study);
        bar.finish_and_clear();
        result
    }
}

/// Writes a table with one row per quantity: its name, its spread, and the factor of its values. A quantity without a spread has no
/// row.
fn write_spreads(f: &mut std::fmt::Formatter<'_>, rows: &[(&str, Option<Spread>, f64)]) -> std::fmt::Result {
    let [min, p01, median, p99, max] = ["min", "1 %", "median", "99 %", "max"];
    writeln!(f, "  {:<22} {min:>11} {p01:>11} {median:>11} {p99:>11} {max:>11}", "")?;
    for (name, spread, unit) in rows {
        let Some(s) = spread else { continue };
        write!(f, "  {name:<22}")?;
        for v in [s.min, s.p01, s.median, s.p99, s.max].map(|v| v * unit) {
            if v != 0.0 && v.abs() < 1e-3 { write!(f, " {v:>11.1e}")? } else { write!(f, " {v:>11.4}")? }
        }
        writeln!(f)?;
    }
    Ok(())
}

/// Lists failed starts: index, positions of the actuated joints (deg or m), reason. If there are many, only the first are listed.
fn list_failures<'a>(
    f: &mut std::fmt::Formatter<'_>,
    failures: impl Iterator<Item = (u64, &'a [f64], String)>,
) -> std::fmt::Result {
    const SHOWN: usize = 20;
    let mut left = 0;
    for (i, (index, start_deg, reason)) in failures.enumerate() {
        if i < SHOWN {
            let start: Vec<String> = start_deg.iter().map(|d| format!("{d:.2}")).collect();
            write!(f, "\n  start {index} at [{}]: {reason}", start.join(", "))?;
        } else {
            left += 1;
        }
    }
    if left > 0 { write!(f, "\n  and {left} more; --json lists all") } else { Ok(()) }
}

/// Builds the database of the settings' grid in the file `path`.
fn build_database(config: &Config, path: &Path, stop: &AtomicBool) -> Result<(), Failure> {
    let bar = progress_bar(database::poses(&config.manoeuvres[0]) as u64, "poses of the database");
    let summary =
        database::build(config, 0, Shard::WHOLE, &OutputFile::new(path), stop, |n| bar.inc(n as u64))
            .map_err(Failure::failed)?;
    bar.finish_and_clear();
    match (summary.left, summary.failed.len()) {
        (0, 0) => Ok(()),
        (0, n) => Err(Failure::failed(format!("{n} poses of the database have no solution"))),
        (n, _) => Err(Failure::failed(format!("interrupted with {n} poses of the database left"))),
    }
}
