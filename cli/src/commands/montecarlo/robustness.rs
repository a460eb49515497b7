//! `upswing montecarlo robustness`.

use super::{SamplingArgs, Scratch, failed, no_start, writable};
use crate::parse::within;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;
use upswing_config::{Config, VelocityEstimate};
use upswing_model::{NU, State};
use upswing_planner::replan::Planner;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_record::report::Report;
use upswing_rig::closed_loop::Aborted;
use upswing_rig::montecarlo::variation::{Misses, Variation};
use upswing_rig::montecarlo::{NoStart, Starts, arm_degrees, wilson};
use upswing_view::picture::{self, curves};

/// What to vary.
#[derive(Clone, Debug, clap::Args)]
pub struct RobustnessArgs {
    /// Which starts, from which database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// What to vary, one curve each
    #[arg(long, value_name = "WHAT,..", value_delimiter = ',', required = true)]
    pub over: Vec<Variation>,
    /// By how much, in the unit of --over [default: values that reach from harmless to lost]
    #[arg(long, value_name = "V,..", value_delimiter = ',', allow_hyphen_values = true)]
    pub values: Option<Vec<f64>>,
    /// Where the controller takes velocities from, to compare [default: cycle.velocity of daemon.toml]
    #[arg(long, value_name = "HOW,..", value_delimiter = ',')]
    pub velocity: Option<Vec<VelocityEstimate>>,
    /// What else is different about the plant: a scenario of the settings, or the path of a .toml file
    #[arg(long, value_name = "NAME|FILE")]
    pub scenario: Option<String>,
    /// How often cycles were missed, for `--over jitter`: what `upswing soak --clock wall --json` printed
    #[arg(long, value_name = "FILE")]
    pub missed: Option<PathBuf>,
    /// How long to balance, s (2 to 600); the last second is judged. One second longer where the balance is disturbed
    #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = within(2.0, 600.0))]
    pub seconds: f64,
    /// Draw the curves (SVG)
    #[arg(long, value_name = "FILE")]
    pub svg: Option<Destination>,
    /// Draw the swing-up of --only as far as it came (SVG); one --over, --values and --velocity
    #[arg(long, value_name = "FILE", requires = "only")]
    pub picture: Option<Destination>,
    /// What becomes of an existing file.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

/// One value of one curve.
struct Case {
    over: Variation,
    value: f64,
    velocity: VelocityEstimate,
    /// Of controller and plant.
    config: Config,
}

/// All runs.
struct Runs<'a> {
    planner: &'a Planner,
    starts: Starts<'a>,
    misses: Misses,
    seconds: f64,
}

/// A start that did not end balanced.
#[derive(Clone, Debug, Serialize)]
struct Failed {
    index: u64,
    start_deg: [f64; NU],
    kind: String,
    reasons: Vec<String>,
}

impl Runs<'_> {
    /// What became of one start; `None`: it ended balanced.
    fn sample(&self, case: &Case, scratch: &mut Scratch, index: u64) -> Result<Option<Failed>, NoStart> {
        let start = self.starts.start(index)?;
        let (kind, reasons) = match self.run(case, scratch, index, &start) {
            Ok(report) if report.success => return Ok(None),
            Ok(report) => ("came to its end, but not as it should".into(), report.failures),
            Err(e) => (e.kind(), vec![e.to_string()]),
        };
        Ok(Some(Failed { index, start_deg: arm_degrees(&start), kind, reasons }))
    }

    fn run(&self, case: &Case, scratch: &mut Scratch, index: u64, start: &State) -> Result<Report, Aborted> {
        let config = &case.config;
        let seconds = case.over.seconds(self.seconds);
        let period = config.daemon.cycle.period.as_secs_f64();
        let shares = self.starts.shares(index);
        let disturbances =
            |t_f: f64| case.over.disturbances(case.value, t_f, seconds, period, &self.misses, shares);
        scratch.swing_up(self.planner, (index, start), config, config.clone(), seconds, disturbances)
    }
}

#[derive(Serialize)]
struct Answer {
    success: bool,
    complete: bool,
    database: String,
    seed: u64,
    curves: Vec<Curve>,
    times: Times,
}

#[derive(Serialize)]
struct Curve {
    over: Variation,
    label: &'static str,
    velocity: &'static str,
    points: Vec<Point>,
}

#[derive(Serialize)]
struct Point {
    value: f64,
    samples: usize,
    succeeded: usize,
    /// 95 % interval of the probability of success (Wilson).
    interval: (f64, f64),
    /// How often each kind of failure occurred.
    failures: BTreeMap<String, usize>,
    failed: Vec<Failed>,
}

/// In s; the only part that differs from run to run.
#[derive(Serialize)]
struct Times {
    total: f64,
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        write!(f, "seed {}, {}{part}, {:.0} s", self.seed, self.database, self.times.total)?;
        self.curves.iter().try_for_each(|c| write!(f, "\n{c}"))
    }
}

impl std::fmt::Display for Curve {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, velocities from the {}:", self.label, self.velocity)?;
        self.points.iter().try_for_each(|p| write!(f, "\n{p}"))
    }
}

impl std::fmt::Display for Point {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const SHOWN: usize = 10;
        let (low, high) = (100.0 * self.interval.0, 100.0 * self.interval.1);
        let (value, succeeded, samples) = (self.value, self.succeeded, self.samples);
        write!(f, "  {value:>8}: {succeeded} of {samples}, 95 % interval {low:.1} to {high:.1} %")?;
        if self.failed.is_empty() {
            return Ok(());
        }
        let starts: Vec<_> = self.failed.iter().take(SHOWN).map(|s| s.index.to_string()).collect();
        let more = if self.failed.len() > SHOWN { ", .." } else { "" };
        write!(f, "; failed: {}{more}", starts.join(", "))?;
        self.failures.iter().try_for_each(|(kind, n)| write!(f, "\n            {n} times: {kind}"))
    }
}

fn name(velocity: VelocityEstimate) -> &'static str {
    match velocity {
        VelocityEstimate::Filter => "filter",
        VelocityEstimate::Model => "model",
    }
}

/// Swings up from every start at every value of every curve.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if it was interrupted, or if the start of
/// `--only` did not end balanced.
pub fn run(args: &RobustnessArgs) -> Result<(), Failure> {
    let begin = Instant::now();
    let misses = args.missed.as_deref().map_or_else(|| Ok(Misses::default()), Misses::read)?;
    if args.over.contains(&Variation::Jitter) && args.missed.is_none() {
        return Err(Failure::BadInput("--over jitter: expected a file by --missed, got none".into()));
    }
    let svg = writable("--svg", args.svg.as_ref(), args.overwrite)?;
    let picture = writable("--picture", args.picture.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let planner = args.sampling.planner(None, &stop)?;
    let cases = cases(args, planner.config())?;
    let starts = Starts { config: planner.config(), seed: args.sampling.seed };
    let runs = Runs { planner: &planner, starts, misses, seconds: args.seconds };
    if let (Some(output), Some(index)) = (&picture, args.sampling.only) {
        let [case] = &cases[..] else {
            let got = cases.len();
            let text = format!("--picture: expected one --over, --values and --velocity, got {got} runs");
            return Err(Failure::BadInput(text));
        };
        let mut scratch = Scratch::new(&planner);
        // How it ended, the answer says.
        let _ = runs.run(case, &mut scratch, index, &starts.start(index).map_err(no_start)?);
        let period = case.config.daemon.cycle.period.as_secs_f64();
        picture::draw(output, &scratch.records, &case.config.robot.limits, period).map_err(failed)?;
    }

    let indices = args.sampling.indices();
    let jobs: Vec<u64> = (0..(cases.len() * indices.len()) as u64).collect();
    // In the order of the starts, so that the values of a curve take turns and the estimate of the time left is fair.
    let place = |job: u64| (job as usize % cases.len(), job as usize / cases.len());
    let results = args.sampling.run(
        &jobs,
        &stop,
        || Scratch::new(&planner),
        |scratch, job| {
            let (case, start) = place(job);
            runs.sample(&cases[case], scratch, indices[start]).map(|failed| (case, failed))
        },
    )?;
    let complete = results.len() == jobs.len();
    let curves = curves_of(&cases, results);
    if let Some(output) = &svg {
        curves::draw(output, &panels(&curves)).map_err(failed)?;
    }
    let succeeded = curves.iter().flat_map(|c| &c.points).all(|p| p.succeeded == p.samples);
    let success = complete && (succeeded || args.sampling.only.is_none());
    args.sampling.common.print(&Answer {
        success,
        complete,
        database: planner.origin().to_owned(),
        seed: args.sampling.seed,
        curves,
        times: Times { total: begin.elapsed().as_secs_f64() },
    })?;
    match (complete, success) {
        (true, true) => Ok(()),
        (true, false) => Err(failed("the start did not end balanced")),
        (false, _) => Err(failed("interrupted")),
    }
}

/// All values of all curves: the values of a curve one after the other.
fn cases(args: &RobustnessArgs, config: &Config) -> Result<Vec<Case>, Failure> {
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
                over.check(*value)?;
                let mut config = base.clone();
                config.daemon.cycle.velocity = *velocity;
                over.apply(*value, &mut config);
                cases.push(Case { over: *over, value: *value, velocity: *velocity, config });
            }
        }
    }
    Ok(cases)
}

/// The results, which name their case, as curves.
fn curves_of(cases: &[Case], results: Vec<(usize, Option<Failed>)>) -> Vec<Curve> {
    let mut points: Vec<Point> = cases
        .iter()
        .map(|case| Point {
            value: case.value,
            samples: 0,
            succeeded: 0,
            interval: (0.0, 1.0),
            failures: BTreeMap::new(),
            failed: Vec::new(),
        })
        .collect();
    for (case, failed) in results {
        let point = &mut points[case];
        point.samples += 1;
        point.succeeded += usize::from(failed.is_none());
        if let Some(failed) = failed {
            *point.failures.entry(failed.kind.clone()).or_default() += 1;
            point.failed.push(failed);
        }
    }
    let mut curves: Vec<Curve> = Vec::new();
    for (case, mut point) in cases.iter().zip(points) {
        point.interval = wilson(point.succeeded, point.samples);
        let velocity = name(case.velocity);
        match curves.last_mut().filter(|c| c.over == case.over && c.velocity == velocity) {
            Some(curve) => curve.points.push(point),
            None => {
                let label = case.over.label();
                curves.push(Curve { over: case.over, label, velocity, points: vec![point] });
            }
        }
    }
    curves
}

/// One panel for each thing that is varied.
fn panels(all: &[Curve]) -> Vec<curves::Panel> {
    let mut panels: Vec<curves::Panel> = Vec::new();
    for curve in all {
        let points = curve.points.iter().map(|p| curves::Point {
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
