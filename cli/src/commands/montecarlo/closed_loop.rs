//! `upswing montecarlo closed-loop`.

use super::SamplingArgs;
use crate::closed_loop::swing_up;
use crate::montecarlo::{NoStart, Spread, Starts, arm_degrees};
use serde::Serialize;
use std::time::Instant;
use upswing_config::process::{Failure, shutdown_flag};
use upswing_ipc::Telemetry;
use upswing_model::{NU, State, position, velocity};
use upswing_planner::qp::Solver;
use upswing_planner::replan::Planner;
use upswing_plant::Plant;

/// How to swing up.
#[derive(Clone, Debug, clap::Args)]
pub struct ClosedLoopArgs {
    /// Which starts, from which database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// How long to balance, s (at least 2); the last second is judged
    #[arg(long, default_value_t = 2.0)]
    pub seconds: f64,
}

/// What became of one start. All but the time depends on settings, seed and index alone.
#[derive(Clone, Debug, Serialize)]
struct Sample {
    index: u64,
    start_deg: [f64; NU],
    end: Option<Figures>,
    /// Why it is no success.
    failures: Vec<String>,
    #[serde(skip)]
    time_s: f64,
}

#[derive(Clone, Debug, Serialize)]
struct Figures {
    tracking_error_arm: f64,
    tracking_error_pendulum: f64,
    peak_position: f64,
    peak_velocity: f64,
    peak_torque: f64,
    final_tilt_deg: f64,
}

struct Scratch {
    solver: Solver,
    records: Vec<Telemetry>,
}

fn sample(planner: &Planner, scratch: &mut Scratch, seconds: f64, index: u64, start: &State) -> Sample {
    let begin = Instant::now();
    let config = planner.config();
    let mut run = || -> Result<_, String> {
        let plant = Plant::at(config, &position(start), &velocity(start)).map_err(|e| e.to_string())?;
        swing_up(planner, &mut scratch.solver, plant, seconds, &mut scratch.records)
            .map_err(|e| e.to_string())
    };
    let (end, failures) = match run() {
        Ok(report) => {
            let figures = Figures {
                tracking_error_arm: report.tracking_error_arm,
                tracking_error_pendulum: report.tracking_error_pendulum,
                peak_position: report.peak_position,
                peak_velocity: report.peak_velocity,
                peak_torque: report.peak_torque,
                final_tilt_deg: report.final_tilt_deg,
            };
            (Some(figures), report.failures)
        }
        Err(reason) => (None, vec![reason]),
    };
    Sample { index, start_deg: arm_degrees(start), end, failures, time_s: begin.elapsed().as_secs_f64() }
}

#[derive(Serialize)]
struct Answer {
    success: bool,
    complete: bool,
    database: String,
    seed: u64,
    samples: usize,
    succeeded: usize,
    tracking_error_arm: Option<Spread>,
    tracking_error_pendulum: Option<Spread>,
    peak_position: Option<Spread>,
    peak_velocity: Option<Spread>,
    peak_torque: Option<Spread>,
    final_tilt_deg: Option<Spread>,
    times: AnswerTimes,
    results: Vec<Sample>,
    #[serde(skip)]
    threads: usize,
}

/// All in s; the only part that differs from run to run.
#[derive(Serialize)]
struct AnswerTimes {
    run: Option<Spread>,
    total: f64,
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        let (n, seed) = (self.samples, self.seed);
        writeln!(f, "{} of {n} starts end balanced{part}, seed {seed}", self.succeeded)?;
        writeln!(f, "  database  {}", self.database)?;
        Spread::write_heading(f)?;
        let rows = [
            ("tracking of arm, rad", self.tracking_error_arm, 1.0),
            ("tracking of rod, rad", self.tracking_error_pendulum, 1.0),
            ("position, % of limit", self.peak_position, 100.0),
            ("velocity, % of limit", self.peak_velocity, 100.0),
            ("torque, % of limit", self.peak_torque, 100.0),
            ("final tilt, deg", self.final_tilt_deg, 1.0),
            ("one run, s", self.times.run, 1.0),
        ];
        for (name, spread, unit) in rows {
            Spread::write_row(f, name, spread, unit)?;
        }
        write!(f, "  time      {:.1} s on {} threads", self.times.total, self.threads)?;
        for s in self.results.iter().filter(|s| !s.failures.is_empty()) {
            let start = s.start_deg.map(|d| format!("{d:.2}")).join(", ");
            write!(f, "\n  start {} at [{start}] deg: {}", s.index, s.failures.join("; "))?;
        }
        Ok(())
    }
}

/// Swings up from every start.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &ClosedLoopArgs) -> Result<(), Failure> {
    if !(args.seconds >= 2.0 && args.seconds <= 3600.0) {
        return Err(Failure::BadInput(format!("--seconds: expected 2 to 3600, got {}", args.seconds)));
    }
    let stop = shutdown_flag()?;
    let begin = Instant::now();
    let planner = args.sampling.planner(&stop)?;
    let config = planner.config();
    let starts = Starts { config, seed: args.sampling.seed };
    let scratch = || Scratch { solver: planner.solver(), records: Vec::new() };
    let work = |scratch: &mut Scratch, index: u64| -> Result<Sample, NoStart> {
        Ok(sample(&planner, scratch, args.seconds, index, &starts.start(index)?))
    };
    let results = args.sampling.run(&stop, scratch, work)?;
    let complete = results.len() == args.sampling.indices().len();
    let spread =
        |value: fn(&Figures) -> f64| Spread::of(results.iter().filter_map(|s| s.end.as_ref()).map(value));
    let succeeded = results.iter().filter(|s| s.failures.is_empty()).count();
    let samples = results.len();
    args.sampling.common.print(&Answer {
        success: complete && succeeded == samples,
        complete,
        database: config.database.origin.clone(),
        seed: args.sampling.seed,
        samples,
        succeeded,
        tracking_error_arm: spread(|e| e.tracking_error_arm),
        tracking_error_pendulum: spread(|e| e.tracking_error_pendulum),
        peak_position: spread(|e| e.peak_position),
        peak_velocity: spread(|e| e.peak_velocity),
        peak_torque: spread(|e| e.peak_torque),
        final_tilt_deg: spread(|e| e.final_tilt_deg),
        times: AnswerTimes {
            run: Spread::of(results.iter().map(|s| s.time_s)),
            total: begin.elapsed().as_secs_f64(),
        },
        threads: args.sampling.threads(),
        results,
    })?;
    args.sampling.verdict(complete, samples, succeeded)
}
