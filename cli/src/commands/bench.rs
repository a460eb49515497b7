//! `upswing bench`: a fixed benchmark of planners and controllers, and its scores.

use super::{CommonArgs, print_json, print_line, progress_bar, writable};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use upswing_config::{Config, System, check_regular};
use upswing_planner::replan::Planner;
use upswing_process::number::{whole, within};
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::benchmark::{Benchmark, BenchmarkError, table};
use upswing_rig::montecarlo::StudyError;
use upswing_rig::montecarlo::contender::{Contender, GivenPlans};

/// A fixed benchmark of planners and controllers: its starts and conditions as a file, and the scores of its runs
///
/// Example: upswing bench export benchmark.json
#[derive(Clone, Debug, clap::Args)]
pub struct BenchArgs {
    /// The action.
    #[command(subcommand)]
    pub command: BenchCommand,
}

/// Actions on benchmarks.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum BenchCommand {
    /// Write starts, conditions and criteria as JSON, rad and m: the i-th plan of a planner of your own begins at the i-th start
    ///
    /// Example: upswing bench export benchmark.json --system cart-pole --samples 20
    Export {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// File to write
        #[arg(value_name = "FILE")]
        file: Destination,
        /// Number of starts
        #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole(1_u64, 100_000))]
        samples: u64,
        /// Seed of the random starts, those of `upswing montecarlo`
        #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole(0, u64::MAX))]
        seed: u64,
        /// Conditions, as of `upswing montecarlo closed-loop`
        #[arg(long, value_name = "NAME|FILE,..", value_delimiter = ',', default_value = "nominal,everyday")]
        condition: Vec<String>,
        /// Time at the end of the plan, s (2 to 600); success is judged in the last second
        #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = within(2.0, 600.0))]
        seconds: f64,
        /// Overwriting of existing files.
        #[command(flatten)]
        overwrite: Overwrite,
    },
    /// Run every start under every condition, with our plans or those of a file, and print a table in Markdown
    ///
    /// The system is that of the file. Controllers of your own: the package for Python, `upswing.benchmark`. Exit code 0: the benchmark ran to its end.
    ///
    /// Example: upswing bench score benchmark.json --plans plans.json --name mine
    Score {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// File of `upswing bench export`
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Plans in place of ours, the i-th one for the i-th start: JSON documents one after the other, each as `upswing plan --json` prints it, or
        /// null for none; they get our gains
        #[arg(long, value_name = "FILE")]
        plans: Option<PathBuf>,
        /// Name of planner and controller in the table
        #[arg(long, default_value = "ours")]
        name: String,
        /// Number of threads, 1 to 1024 [default: one per core]
        #[arg(long, value_name = "N", value_parser = whole(1_u16, 1024))]
        threads: Option<u16>,
    },
}

#[derive(Serialize)]
struct ExportResult<'a> {
    file: &'a Path,
    samples: usize,
    conditions: &'a [String],
}

impl std::fmt::Display for ExportResult<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} starts under {}", self.file.display(), self.samples, self.conditions.join(", "))
    }
}

/// Runs a command on benchmarks.
///
/// # Errors
/// [`Failure::BadInput`] for an unusable file or option, [`Failure::Failed`] if a file cannot be written or the runs were interrupted.
pub fn run(args: &BenchArgs) -> Result<(), Failure> {
    match &args.command {
        BenchCommand::Export { common, file, samples, seed, condition, seconds, overwrite } => {
            let config = common.process.load()?;
            let benchmark =
                Benchmark::new(&config, *samples, *seed, condition.clone(), *seconds).map_err(failure)?;
            export(common, &benchmark, file, *overwrite)
        }
        BenchCommand::Score { common, file, plans, name, threads } => {
            let threads = threads.map(usize::from);
            score(common, file, plans.as_deref(), name, threads)
        }
    }
}

/// Only what happens during the runs is no bad input.
fn failure(e: BenchmarkError) -> Failure {
    match e {
        BenchmarkError::Study(StudyError::Threads(_)) => Failure::failed(e),
        e => Failure::bad_input(e),
    }
}

fn export(
    common: &CommonArgs,
    benchmark: &Benchmark,
    path: &Destination,
    overwrite: Overwrite,
) -> Result<(), Failure> {
    let Some(output) = writable("FILE", Some(path), overwrite)? else { return Ok(()) };
    let mut file = output.begin().map_err(Failure::failed)?;
    let text = serde_json::to_string_pretty(benchmark).map_err(Failure::failed)?;
    writeln!(file, "{text}").map_err(|e| Failure::failed(format!("cannot write {}: {e}", path.display())))?;
    file.finish().map_err(Failure::failed)?;
    let (samples, conditions) = (benchmark.starts.len(), &benchmark.conditions[..]);
    common.print(&ExportResult { file: path, samples, conditions })
}

fn score(
    common: &CommonArgs,
    path: &Path,
    plans: Option<&Path>,
    name: &str,
    threads: Option<usize>,
) -> Result<(), Failure> {
    if let Some(plans) = plans {
        check_regular(plans).map_err(|e| Failure::bad_input(format!("{}: {e}", plans.display())))?;
    }
    let benchmark = Benchmark::read(path).map_err(failure)?;
    let system: System =
        benchmark.system.parse().map_err(|e| Failure::bad_input(format!("{}: {e}", path.display())))?;
    let wanted = &common.process.system;
    if *wanted != System::default() && wanted.to_string() != system.to_string() {
        return Err(Failure::BadInput(format!(
            "--system: expected {system}, the system of {}, got {wanted}",
            path.display()
        )));
    }
    let planner = Planner::new(Config::load(&system)?).map_err(Failure::bad_input)?;
    let plans = plans.map(|path| -> Result<_, Failure> {
        let plans = GivenPlans::read(path, planner.config()).map_err(Failure::bad_input)?;
        plans.require(benchmark.starts.len() as u64, path).map_err(Failure::bad_input)?;
        Ok(plans)
    });
    let plans = plans.transpose()?;
    let contender = plans.as_ref().map(|plans| plans as &dyn Contender);
    let stop = shutdown_flag()?;
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let bar = progress_bar(benchmark.runs() as u64, "runs");
    let score =
        benchmark.score(name, &planner, contender, threads.unwrap_or_else(cores), &stop, &|| bar.inc(1));
    bar.finish_and_clear();
    let score = score.map_err(|e| match e {
        e @ (BenchmarkError::Model { .. } | BenchmarkError::Start { .. }) => {
            Failure::bad_input(format!("{}: {e}", path.display()))
        }
        e => failure(e),
    })?;
    let done: usize = score.conditions.iter().map(|condition| condition.samples).sum();
    if common.json { print_json(&score) } else { print_line(&table(&[score])) }?;
    match benchmark.runs() - done {
        0 => Ok(()),
        left => Err(Failure::failed(format!("interrupted with {left} runs left"))),
    }
}
