//! `upswing montecarlo replan`: plans from many random starts.

use super::{SamplingArgs, failed, list_failures, study_failure, writable, write_spreads};
use crate::commands::PlanSummary;
use serde::Serialize;
use std::time::Instant;
use upswing_ipc::PlanMessage;
use upswing_ipc::operator::Manoeuvre;
use upswing_model::{NU, State};
use upswing_ocp::qp::QpSolver;
use upswing_planner::replan::{Effort, Planner};
use upswing_process::number::whole;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::montecarlo::{NoStart, Spread, arm_degrees};
use upswing_view::picture::map;

/// Options of `montecarlo replan`.
#[derive(Clone, Debug, clap::Args)]
pub struct ReplanArgs {
    /// Starts and database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Largest number of linearisations per entry; 1 is the paper's mode [default: the setting]
    #[arg(long, value_parser = whole(1_u32, 100))]
    pub iterations: Option<u32>,
    /// Draw the smallest margins over the ranges of the starts (SVG)
    #[arg(long, value_name = "FILE")]
    pub svg: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

/// Largest defect of the nonlinear dynamics that counts as closed, rad or rad/s per interval.
const CLOSED_DEFECT: f64 = 1e-6;

/// Result for one start. All fields but the times depend on settings, seed and index only.
#[derive(Clone, Debug, Serialize)]
struct StartResult {
    index: u64,
    start_deg: [f64; NU],
    plan: Option<PlanStatistics>,
    /// Reason for the failure; `None`: success.
    failure: Option<String>,
    #[serde(skip)]
    times: StartTimes,
}

/// Duration t_F of a plan, s, and the summary of its replan.
#[derive(Clone, Debug, Serialize)]
struct PlanStatistics {
    t_f: f64,
    #[serde(flatten)]
    plan: PlanSummary,
}

/// Computing times for one start, s; QPs and gains of a start without a plan: 0.
#[derive(Clone, Copy, Debug, Default)]
struct StartTimes {
    qp: f64,
    lqr: f64,
    total: f64,
}

fn sample(
    planner: &Planner,
    solver: &mut QpSolver,
    iterations: usize,
    index: u64,
    start: &State,
) -> StartResult {
    let begin = Instant::now();
    let result = planner.replan_with(solver, Manoeuvre::SwingUp, start, &Effort::iterations(iterations));
    let total = begin.elapsed().as_secs_f64();
    let (plan, failure, times) = match &result {
        Ok(replan) => {
            let config = planner.config();
            let message = Box::<PlanMessage>::from(&replan.plan(config));
            let refused = upswingd::plan::accept(&message, config).err();
            let failure = refused.map(|e| format!("the daemon refused the plan: {e}"));
            let figures = PlanStatistics { t_f: replan.trajectory.t_f, plan: PlanSummary::new(replan) };
            let (qp, lqr) = (replan.statistics.qp.as_secs_f64(), replan.statistics.lqr.as_secs_f64());
            (Some(figures), failure, StartTimes { qp, lqr, total })
        }
        Err(e) => (None, Some(e.to_string()), StartTimes { total, ..StartTimes::default() }),
    };
    StartResult { index, start_deg: arm_degrees(start), plan, failure, times }
}

#[derive(Serialize)]
struct ReplanResult {
    success: bool,
    complete: bool,
    database: String,
    entries: usize,
    seed: u64,
    samples: usize,
    /// Number of starts with a plan that the daemon accepts and that keeps all limits between knots.
    succeeded: usize,
    /// Number of starts with a plan.
    feasible: usize,
    /// Number of plans whose defect is at most 1e-6.
    defect_closed: usize,
    /// Numbers of plans by the number of entries that were tried, from 1.
    attempts: Vec<usize>,
    /// Linearisations for the entry used.
    iterations: Option<Spread>,
    defect: Option<Spread>,
    margin_q: Option<Spread>,
    margin_qd: Option<Spread>,
    margin_tau: Option<Spread>,
    t_f: Option<Spread>,
    distance: Option<Spread>,
    times: ReplanTimes,
    results: Vec<StartResult>,
    #[serde(skip)]
    threads: usize,
}

/// Computing times, s; the only part that differs from run to run.
#[derive(Serialize)]
struct ReplanTimes {
    replan: Option<Spread>,
    qp: Option<Spread>,
    lqr: Option<Spread>,
    total: f64,
}

impl std::fmt::Display for ReplanResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        let (n, seed) = (self.samples, self.seed);
        writeln!(f, "{} of {n} starts planned within all limits{part}, seed {seed}", self.succeeded)?;
        writeln!(f, "  database  {}, {} entries", self.database, self.entries)?;
        let attempts: Vec<_> = self.attempts.iter().map(usize::to_string).collect();
        writeln!(
            f,
            "  feasible  {} (from the nearest entry, the next, ...: {})",
            self.feasible,
            attempts.join(", ")
        )?;
        writeln!(f, "  defect    at most {CLOSED_DEFECT:.0e} in {} plans", self.defect_closed)?;
        let rows = [
            ("linearisations", self.iterations, 1.0),
            ("defect, rad or rad/s", self.defect, 1.0),
            ("margin of position", self.margin_q, 1.0),
            ("margin of velocity", self.margin_qd, 1.0),
            ("margin of torque", self.margin_tau, 1.0),
            ("t_F, s", self.t_f, 1.0),
            ("distance, rad", self.distance, 1.0),
            ("replan, ms", self.times.replan, 1e3),
            ("  its QPs, ms", self.times.qp, 1e3),
            ("  its gains, ms", self.times.lqr, 1e3),
        ];
        write_spreads(f, &rows)?;
        write!(f, "  time      {:.1} s on {} threads", self.times.total, self.threads)?;
        let failures = self.results.iter().filter_map(|s| Some((s.index, &s.start_deg, s.failure.clone()?)));
        list_failures(f, failures)
    }
}

/// Plans from every start.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &ReplanArgs) -> Result<(), Failure> {
    let svg = writable("--svg", args.svg.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let begin = Instant::now();
    let planner = args.sampling.planner(args.iterations, &stop)?;
    let config = planner.config();
    let iterations = config.planner.replan.iterations;
    let results = args.sampling.study(&planner, args.sampling.indices().len(), &stop, |study| {
        let work = |solver: &mut QpSolver, index: u64| -> Result<StartResult, NoStart> {
            Ok(sample(&planner, solver, iterations, index, &study.starts.start(index)?))
        };
        study.each(&study.indices, || planner.solver(), work).map_err(study_failure)
    })?;
    let complete = results.len() == args.sampling.indices().len();
    let plans = || results.iter().filter_map(|s| s.plan.as_ref());
    let spread = |value: fn(&PlanStatistics) -> f64| Spread::of(plans().map(value));
    let time = |value: fn(&StartTimes) -> f64| Spread::of(results.iter().map(|s| value(&s.times)));
    // Times of the parts are unknown for starts without a plan.
    let part = |value: fn(&StartTimes) -> f64| {
        Spread::of(results.iter().filter(|s| s.plan.is_some()).map(|s| value(&s.times)))
    };
    let most = plans().map(|p| p.plan.attempts).max().unwrap_or(0);
    let succeeded = results.iter().filter(|s| s.failure.is_none()).count();
    let success = complete && succeeded == results.len();
    if let Some(output) = &svg {
        let margins = |p: &PlanStatistics| {
            [p.plan.margins.margin_q, p.plan.margins.margin_qd, p.plan.margins.margin_tau]
        };
        let points: Vec<_> = results
            .iter()
            .map(|s| map::MapPoint { q_deg: s.start_deg, margins: s.plan.as_ref().map(margins) })
            .collect();
        map::draw(output, &config.grid.axes, &points).map_err(failed)?;
    }
    let samples = results.len();
    args.sampling.common.print(&ReplanResult {
        success,
        complete,
        database: planner.origin().to_owned(),
        entries: planner.entries().len(),
        seed: args.sampling.seed,
        samples,
        succeeded,
        feasible: plans().count(),
        defect_closed: plans().filter(|p| p.plan.defect <= CLOSED_DEFECT).count(),
        attempts: (1..=most).map(|n| plans().filter(|p| p.plan.attempts == n).count()).collect(),
        iterations: spread(|p| p.plan.iterations as f64),
        defect: spread(|p| p.plan.defect),
        margin_q: spread(|p| p.plan.margins.margin_q),
        margin_qd: spread(|p| p.plan.margins.margin_qd),
        margin_tau: spread(|p| p.plan.margins.margin_tau),
        t_f: spread(|p| p.t_f),
        distance: spread(|p| p.plan.distance),
        times: ReplanTimes {
            replan: time(|t| t.total),
            qp: part(|t| t.qp),
            lqr: part(|t| t.lqr),
            total: begin.elapsed().as_secs_f64(),
        },
        threads: args.sampling.threads(),
        results,
    })?;
    args.sampling.verdict(complete, samples, succeeded)
}
