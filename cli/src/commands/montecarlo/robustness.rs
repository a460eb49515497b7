//! `upswing montecarlo robustness`: success rates over growing errors of one kind.

use super::{SamplingArgs, draw_run, study_failure, writable};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use upswing_config::{Config, VelocityEstimate};
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::montecarlo::robustness::{RobustnessCase, RobustnessStudy, SuccessCurve, SuccessPoint};
use upswing_rig::montecarlo::variation::{MissedCycleCounts, Variation};
use upswing_view::picture::curves;

/// Options of `montecarlo robustness`.
#[derive(Clone, Debug, clap::Args)]
pub struct RobustnessArgs {
    /// Starts and database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Quantities to vary, one curve each
    #[arg(long, value_name = "WHAT,..", value_delimiter = ',', required = true)]
    pub over: Vec<Variation>,
    /// Values, in the unit of --over [default: from harmless to certain failure]
    #[arg(long, value_name = "V,..", value_delimiter = ',', allow_hyphen_values = true)]
    pub values: Option<Vec<f64>>,
    /// Sources of the controller's velocities, to compare [default: cycle.velocity of daemon.toml]
    #[arg(long, value_name = "HOW,..", value_delimiter = ',')]
    pub velocity: Option<Vec<VelocityEstimate>>,
    /// Scenario of the plant, in addition: a name, or the path of a .toml file
    #[arg(long, value_name = "NAME|FILE")]
    pub scenario: Option<String>,
    /// Replan continuously while the plan is tracked, also where the settings of the planner do not say so
    #[arg(long)]
    pub continuous: bool,
    /// Histogram of missed cycles for `--over jitter`: the output of `upswing soak --clock wall --json`
    #[arg(long, value_name = "FILE")]
    pub missed: Option<PathBuf>,
    /// Duration of the balance, s (2 to 600); success is judged in the last second. A disturbed balance lasts one second longer
    #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = within(2.0, 600.0))]
    pub seconds: f64,
    /// Draw the curves (SVG)
    #[arg(long, value_name = "FILE", conflicts_with = "output")]
    pub svg: Option<Destination>,
    /// Draw the swing-up of --only, up to its failure (SVG); needs one --over, --values and --velocity
    #[arg(long, value_name = "FILE", requires = "only")]
    pub picture: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct RobustnessResult {
    success: bool,
    complete: bool,
    database: String,
    seed: u64,
    curves: Vec<SuccessCurve>,
    times: RobustnessTimes,
}

/// Computing time, s; the only part that differs from run to run.
#[derive(Serialize)]
struct RobustnessTimes {
    total: f64,
}

impl std::fmt::Display for RobustnessResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        write!(f, "seed {}, {}{part}, {:.0} s", self.seed, self.database, self.times.total)?;
        self.curves.iter().try_for_each(|c| write_curve(f, c))
    }
}

fn write_curve(f: &mut std::fmt::Formatter<'_>, c: &SuccessCurve) -> std::fmt::Result {
    write!(f, "\n{}, velocities from the {}:", c.label, c.velocity)?;
    c.points.iter().try_for_each(|p| write_point(f, p))
}

fn write_point(f: &mut std::fmt::Formatter<'_>, p: &SuccessPoint) -> std::fmt::Result {
    const SHOWN: usize = 10;
    let (low, high) = (100.0 * p.interval.0, 100.0 * p.interval.1);
    let (value, succeeded, samples) = (p.value, p.succeeded, p.samples);
    write!(f, "\n  {value:>8}: {succeeded} of {samples}, 95 % interval {low:.1} to {high:.1} %")?;
    if p.failed.is_empty() {
        return Ok(());
    }
    let starts: Vec<_> = p.failed.iter().take(SHOWN).map(|s| s.index.to_string()).collect();
    let more = if p.failed.len() > SHOWN { ", .." } else { "" };
    write!(f, "; failed: {}{more}", starts.join(", "))?;
    p.failures.iter().try_for_each(|(kind, n)| write!(f, "\n            {n} times: {kind}"))
}

/// Swings up from every start at every value of every curve.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if the command was interrupted, or if the start of
/// `--only` did not end balanced.
pub fn run(args: &RobustnessArgs) -> Result<(), Failure> {
    let begin = Instant::now();
    let misses = args.missed.as_deref().map_or_else(|| Ok(MissedCycleCounts::default()), misses)?;
    if args.over.contains(&Variation::Jitter) && args.missed.is_none() {
        return Err(Failure::BadInput("--over jitter: expected a file by --missed, got none".into()));
    }
    let svg = writable("--svg", args.svg.as_ref(), args.overwrite)?;
    let picture = writable("--picture", args.picture.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let continuous = |config: &mut Config| config.planner.continuous.enabled |= args.continuous;
    let planner = args.sampling.planner(continuous, &stop)?;
    let cases = cases(args, planner.config())?;
    let jobs = cases.len() * args.sampling.indices().len();
    let runs =
        args.sampling.runs("robustness", &planner, &(&cases, &misses, args.seconds), args.overwrite)?;
    let curves = args.sampling.study(&planner, runs.as_ref(), jobs, &stop, |study| {
        let study = RobustnessStudy { study, misses: &misses, seconds: args.seconds };
        if let (Some(output), Some(index)) = (&picture, args.sampling.only) {
            let [case] = &cases[..] else {
                let got = cases.len();
                let text = format!("--picture: expected one --over, --values and --velocity, got {got} runs");
                return Err(Failure::BadInput(text));
            };
            draw_run(output, planner.config(), study.records(case, index))?;
        }
        study.run(&cases).map_err(study_failure)
    })?;
    let samples = curves.iter().flat_map(|c| &c.points).map(|p| p.samples).sum::<usize>();
    if let Some(result) = args.sampling.conclude_shard(runs, 0..jobs as u64, samples) {
        return result;
    }
    let complete = samples == jobs;
    if let Some(output) = &svg {
        curves::draw(output, &panels(&curves)).map_err(Failure::failed)?;
    }
    let succeeded = curves.iter().flat_map(|c| &c.points).all(|p| p.succeeded == p.samples);
    let success = complete && (succeeded || args.sampling.only.is_none());
    args.sampling.common.print(&RobustnessResult {
        success,
        complete,
        database: planner.origin(0).to_owned(),
        seed: args.sampling.seed,
        curves,
        times: RobustnessTimes { total: begin.elapsed().as_secs_f64() },
    })?;
    match (complete, success) {
        (true, true) => Ok(()),
        (true, false) => Err(Failure::failed("the start did not end balanced")),
        (false, _) => Err(Failure::failed("interrupted")),
    }
}

/// Returns the cases of all values of all curves, curve by curve.
fn cases(args: &RobustnessArgs, config: &Config) -> Result<Vec<RobustnessCase>, Failure> {
    let mut base = config.clone();
    if let Some(scenario) = &args.scenario {
        base.use_scenario(scenario)?;
    }
    let velocities = args.velocity.clone().unwrap_or_else(|| vec![base.daemon.cycle.velocity]);
    let mut cases = Vec::new();
    for over in &args.over {
        let values = args.values.as_deref().unwrap_or(over.values());
        for velocity in &velocities {
            for value in values {
                let case = RobustnessCase::new(*over, *value, *velocity, &base);
                cases.push(case.map_err(|e| Failure::BadInput(format!("--values: {e}")))?);
            }
        }
    }
    Ok(cases)
}

/// Reads a histogram of missed cycles from a file, as printed by `upswing soak --json`.
fn misses(path: &Path) -> Result<MissedCycleCounts, Failure> {
    let refuse = |e: &dyn std::fmt::Display| Failure::BadInput(format!("--missed {}: {e}", path.display()));
    let text = upswing_config::read_file(path).map_err(|e| refuse(&e))?;
    let misses: MissedCycleCounts = serde_json::from_slice(&text).map_err(|e| {
        refuse(&format_args!("expected {{\"cycles\": N, \"missed\": {{\"LENGTH\": COUNT, ..}}}}: {e}"))
    })?;
    if misses.cycles == 0 || misses.missed.values().all(|n| *n == 0) || misses.missed.contains_key(&0) {
        return Err(refuse(&"expected cycles and stretches of at least one missed cycle"));
    }
    Ok(misses)
}

/// Returns one panel with all curves for each quantity that is varied.
fn panels(all: &[SuccessCurve]) -> Vec<curves::Panel> {
    let mut panels: Vec<curves::Panel> = Vec::new();
    for curve in all {
        let points = curve.points.iter().map(|p| curves::CurvePoint {
            x: p.value,
            share: p.succeeded as f64 / p.samples.max(1) as f64,
            interval: p.interval,
        });
        let series = (curve.velocity.to_owned(), points.collect());
        match panels.last_mut().filter(|p| p.label == curve.label) {
            Some(panel) => panel.series.push(series),
            None => panels.push(curves::Panel { label: curve.label.into(), series: vec![series] }),
        }
    }
    panels
}
