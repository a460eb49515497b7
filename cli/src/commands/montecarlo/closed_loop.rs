//! `upswing montecarlo closed-loop`.

use super::{SamplingArgs, Scratch, failed, list_failures, no_start, writable};
use crate::parse::within;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use upswing_model::{NU, State};
use upswing_planner::replan::Planner;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_record::report::Report;
use upswing_rig::closed_loop::{Aborted, Disturbances};
use upswing_rig::montecarlo::condition::Condition;
use upswing_rig::montecarlo::{NoStart, Spread, Starts, arm_degrees};
use upswing_view::picture;

/// How to swing up.
#[derive(Clone, Debug, clap::Args)]
pub struct ClosedLoopArgs {
    /// Which starts, from which database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// In what the plant differs from what planner and controller believe, separated by commas: `nominal`;
    /// `arm-mass`, `pendulum-mass`, `pendulum-length` (scaled by 0.9 to 1.1, drawn for each start); or scenarios of the
    /// plant, by name or as .toml files
    #[arg(long, value_name = "NAME|FILE,..", value_delimiter = ',', default_value = "nominal")]
    pub condition: Vec<String>,
    /// How long to balance, s (2 to 600); the last second is judged
    #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = within(2.0, 600.0))]
    pub seconds: f64,
    /// Draw the swing-up of --only as far as it came (SVG)
    #[arg(long, value_name = "FILE", requires = "only")]
    pub picture: Option<Destination>,
    /// What becomes of an existing file.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

/// What became of one start. All but the time depends on settings, condition, seed and index alone.
#[derive(Clone, Debug, Serialize)]
struct Sample {
    index: u64,
    start_deg: [f64; NU],
    end: Option<Figures>,
    /// The kind of failure, and what exactly was wrong.
    failure: Option<String>,
    reasons: Vec<String>,
    #[serde(skip)]
    time_s: f64,
}

/// Some of the figures of a [`Report`].
#[derive(Clone, Debug, Serialize)]
struct Figures {
    t_f: f64,
    tracking_error_arm: f64,
    tracking_error_pendulum: f64,
    peak_position: f64,
    peak_velocity: f64,
    peak_velocity_pendulum: f64,
    peak_torque: f64,
    limited_share: f64,
    final_tilt_deg: f64,
    final_speed: f64,
}

impl From<&Report> for Figures {
    fn from(r: &Report) -> Self {
        Self {
            t_f: r.t_f,
            tracking_error_arm: r.figures.tracking_error_arm,
            tracking_error_pendulum: r.figures.tracking_error_pendulum,
            peak_position: r.figures.peak_position,
            peak_velocity: r.figures.peak_velocity,
            peak_velocity_pendulum: r.figures.peak_velocity_pendulum,
            peak_torque: r.figures.peak_torque,
            limited_share: r.figures.limited_share,
            final_tilt_deg: r.figures.final_tilt_deg,
            final_speed: r.figures.final_speed,
        }
    }
}

/// All runs under one condition.
struct Runs<'a> {
    planner: &'a Planner,
    starts: Starts<'a>,
    condition: Condition,
    seconds: f64,
}

impl Runs<'_> {
    fn sample(&self, scratch: &mut Scratch, index: u64) -> Result<Sample, NoStart> {
        let begin = Instant::now();
        let start = self.starts.start(index)?;
        let (end, failure, reasons) = match self.run(scratch, index, &start) {
            Ok(report) => {
                let failure = (!report.success).then(|| "came to its end, but not as it should".into());
                (Some(Figures::from(&report)), failure, report.failures)
            }
            Err(e) => (None, Some(e.kind()), vec![e.to_string()]),
        };
        let time_s = begin.elapsed().as_secs_f64();
        Ok(Sample { index, start_deg: arm_degrees(&start), end, failure, reasons, time_s })
    }

    fn run(&self, scratch: &mut Scratch, index: u64, start: &State) -> Result<Report, Aborted> {
        let (planner, plant) = (self.planner, self.condition.plant(&self.starts, index));
        let undisturbed = |_| Disturbances::default();
        scratch.swing_up(planner, (index, start), planner.config(), plant, self.seconds, undisturbed)
    }

    fn all(&self, sampling: &SamplingArgs, stop: &AtomicBool) -> Result<ConditionAnswer, Failure> {
        let begin = Instant::now();
        let results = sampling.run(
            &sampling.indices(),
            stop,
            || Scratch::new(self.planner),
            |scratch, index| self.sample(scratch, index),
        )?;
        let spread =
            |value: fn(&Figures) -> f64| Spread::of(results.iter().filter_map(|s| s.end.as_ref()).map(value));
        Ok(ConditionAnswer {
            condition: self.condition.name.clone(),
            purpose: self.condition.purpose.clone(),
            samples: results.len(),
            failures: results.iter().filter_map(|s| s.failure.clone()).fold(
                BTreeMap::new(),
                |mut n, kind| {
                    *n.entry(kind).or_default() += 1;
                    n
                },
            ),
            succeeded: results.iter().filter(|s| s.failure.is_none()).count(),
            tracking_error_arm: spread(|e| e.tracking_error_arm),
            tracking_error_pendulum: spread(|e| e.tracking_error_pendulum),
            peak_position: spread(|e| e.peak_position),
            peak_velocity: spread(|e| e.peak_velocity),
            peak_velocity_pendulum: spread(|e| e.peak_velocity_pendulum),
            peak_torque: spread(|e| e.peak_torque),
            limited_share: spread(|e| e.limited_share),
            final_tilt_deg: spread(|e| e.final_tilt_deg),
            final_speed: spread(|e| e.final_speed),
            times: Times {
                run: Spread::of(results.iter().map(|s| s.time_s)),
                total: begin.elapsed().as_secs_f64(),
            },
            results,
        })
    }
}

#[derive(Serialize)]
struct Answer {
    success: bool,
    complete: bool,
    database: String,
    seed: u64,
    conditions: Vec<ConditionAnswer>,
}

/// Figures are those of the runs that came to their end.
#[derive(Serialize)]
struct ConditionAnswer {
    condition: String,
    purpose: String,
    samples: usize,
    succeeded: usize,
    /// How often each kind of failure occurred.
    failures: BTreeMap<String, usize>,
    tracking_error_arm: Option<Spread>,
    tracking_error_pendulum: Option<Spread>,
    peak_position: Option<Spread>,
    peak_velocity: Option<Spread>,
    peak_velocity_pendulum: Option<Spread>,
    peak_torque: Option<Spread>,
    limited_share: Option<Spread>,
    final_tilt_deg: Option<Spread>,
    final_speed: Option<Spread>,
    times: Times,
    results: Vec<Sample>,
}

/// All in s; the only part that differs from run to run.
#[derive(Serialize)]
struct Times {
    run: Option<Spread>,
    total: f64,
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        write!(f, "seed {}, {}{part}", self.seed, self.database)?;
        self.conditions.iter().try_for_each(|c| write!(f, "\n{c}"))
    }
}

impl std::fmt::Display for ConditionAnswer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}: {} of {} starts end balanced", self.condition, self.succeeded, self.samples)?;
        writeln!(f, "  {}", self.purpose)?;
        Spread::write_heading(f)?;
        let rows = [
            ("tracking of arm, rad", self.tracking_error_arm, 1.0),
            ("tracking of rod, rad", self.tracking_error_pendulum, 1.0),
            ("position, % of limit", self.peak_position, 100.0),
            ("velocity, % of limit", self.peak_velocity, 100.0),
            ("pendulum, % of limit", self.peak_velocity_pendulum, 100.0),
            ("torque, % of limit", self.peak_torque, 100.0),
            ("cut torques, % of time", self.limited_share, 100.0),
            ("final tilt, deg", self.final_tilt_deg, 1.0),
            ("final speed, rad/s", self.final_speed, 1.0),
            ("one run, s", self.times.run, 1.0),
        ];
        for (name, spread, unit) in rows {
            Spread::write_row(f, name, spread, unit)?;
        }
        write!(f, "  time {:.1} s", self.times.total)?;
        self.failures.iter().try_for_each(|(kind, n)| write!(f, "\n  {n} times: {kind}"))?;
        let failed = self.results.iter().filter(|s| s.failure.is_some());
        list_failures(f, failed.map(|s| (s.index, &s.start_deg, s.reasons.join("; "))))
    }
}

/// Swings up from every start under every condition.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &ClosedLoopArgs) -> Result<(), Failure> {
    let picture = writable("--picture", args.picture.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let planner = args.sampling.planner(None, &stop)?;
    let config = planner.config();
    let starts = Starts { config, seed: args.sampling.seed };
    let conditions: Vec<Condition> =
        args.condition.iter().map(|name| Condition::new(name, config)).collect::<Result<_, _>>()?;
    if args.picture.is_some() && conditions.len() != 1 {
        let got = conditions.len();
        return Err(Failure::BadInput(format!("--picture: expected one --condition, got {got}")));
    }
    let expected = args.sampling.indices().len() * conditions.len();
    let answers: Vec<ConditionAnswer> = conditions
        .into_iter()
        .map(|condition| {
            let runs = Runs { planner: &planner, starts, condition, seconds: args.seconds };
            if let (Some(output), Some(index)) = (&picture, args.sampling.only) {
                let mut scratch = Scratch::new(&planner);
                // How it ended, the answer says.
                let _ = runs.run(&mut scratch, index, &starts.start(index).map_err(no_start)?);
                let period = config.daemon.cycle.period.as_secs_f64();
                picture::draw(output, &scratch.records, &config.robot.limits, period).map_err(failed)?;
            }
            runs.all(&args.sampling, &stop)
        })
        .collect::<Result<_, _>>()?;
    let samples = answers.iter().map(|c| c.samples).sum();
    let succeeded = answers.iter().map(|c| c.succeeded).sum();
    let complete = samples == expected;
    args.sampling.common.print(&Answer {
        success: complete && succeeded == samples,
        complete,
        database: planner.origin().to_owned(),
        seed: args.sampling.seed,
        conditions: answers,
    })?;
    args.sampling.verdict(complete, samples, succeeded)
}
