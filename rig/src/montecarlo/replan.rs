//! Monte Carlo study of plans: replans from many random starts, checked as the daemon checks them.

use super::{NoStart, Spread, Study, StudyError, shown_pose};
use crate::course::first_manoeuvre;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use upswing_ipc::PlanMessage;
use upswing_model::State;
use upswing_ocp::qp::QpSolver;
use upswing_planner::replan::{Effort, PlanSummary, Planner};
use upswingd::plan::accept;

/// Largest defect of the nonlinear dynamics that counts as closed, rad or rad/s per interval.
pub const CLOSED_DEFECT: f64 = 1e-6;

/// Result for one start. It depends on settings, seed and index only.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StartResult {
    /// Number of the start.
    pub index: u64,
    /// Positions of the actuated joints at the start, deg or m.
    pub start: Vec<f64>,
    /// The plan, also one that the daemon refuses; `None` if there is none.
    pub plan: Option<PlanFigures>,
    /// Reason for the failure; `None`: success.
    pub failure: Option<String>,
}

/// Figures of a plan.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlanFigures {
    /// Duration t_F, s.
    pub t_f: f64,
    /// Summary of the replan.
    #[serde(flatten)]
    pub plan: PlanSummary,
}

/// Computing times for one start, s; QPs and gains of a start without a plan: 0.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct StartTimes {
    qp: f64,
    lqr: f64,
    total: f64,
}

/// Statistics of all starts. Spreads are over the plans; `None` without any.
#[derive(Clone, Debug, Serialize)]
pub struct PlanStudyResult {
    /// Number of starts.
    pub samples: usize,
    /// Number of starts with a plan that the daemon accepts and that keeps all limits between knots.
    pub succeeded: usize,
    /// Number of starts with a plan.
    pub feasible: usize,
    /// Number of plans whose defect is at most [`CLOSED_DEFECT`].
    pub defect_closed: usize,
    /// Numbers of plans by the number of entries that were tried, from 1.
    pub attempts: Vec<usize>,
    /// Linearisations for the entry used.
    pub iterations: Option<Spread>,
    /// Defects, rad or rad/s per interval.
    pub defect: Option<Spread>,
    /// Smallest margins of the positions, shares of half the range.
    pub margin_q: Option<Spread>,
    /// Smallest margins of the velocities, likewise.
    pub margin_qd: Option<Spread>,
    /// Smallest margins of the torques, likewise.
    pub margin_tau: Option<Spread>,
    /// Durations t_F, s.
    pub t_f: Option<Spread>,
    /// Distances from the entry used, rad.
    pub distance: Option<Spread>,
    /// Computing times.
    pub times: ReplanTimes,
    /// Result of each start, in the order of the starts.
    pub results: Vec<StartResult>,
}

/// Computing times, s; the only part of the result that is not reproducible.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ReplanTimes {
    /// Replans, with and without a plan.
    pub replan: Option<Spread>,
    /// QPs of the replans with a plan.
    pub qp: Option<Spread>,
    /// Gains of the replans with a plan.
    pub lqr: Option<Spread>,
    /// All starts together, on all threads.
    pub total: f64,
}

/// Plans from every start of the study, with the number of linearisations of the planner's settings.
///
/// # Errors
/// [`StudyError`] if there is no start, or threads cannot be started.
pub fn run(study: &Study<'_>) -> Result<PlanStudyResult, StudyError> {
    let begin = Instant::now();
    let work = |solver: &mut QpSolver, index: u64| -> Result<_, NoStart> {
        Ok(sample(study.planner, solver, index, &study.starts.start(index)?))
    };
    let results: Vec<(StartResult, StartTimes)> =
        study.each(0, &study.indices, || study.planner.solver(), work)?;
    let plans = || results.iter().filter_map(|(s, _)| s.plan.as_ref());
    let spread = |value: fn(&PlanFigures) -> f64| Spread::of(plans().map(value));
    let time = |value: fn(&StartTimes) -> f64| Spread::of(results.iter().map(|(_, times)| value(times)));
    // Times of the parts are unknown for starts without a plan.
    let part = |value: fn(&StartTimes) -> f64| {
        Spread::of(results.iter().filter(|(s, _)| s.plan.is_some()).map(|(_, times)| value(times)))
    };
    let most = plans().map(|p| p.plan.attempts).max().unwrap_or(0);
    Ok(PlanStudyResult {
        samples: results.len(),
        succeeded: results.iter().filter(|(s, _)| s.failure.is_none()).count(),
        feasible: plans().count(),
        defect_closed: plans().filter(|p| p.plan.defect <= CLOSED_DEFECT).count(),
        attempts: (1..=most).map(|n| plans().filter(|p| p.plan.attempts == n).count()).collect(),
        iterations: spread(|p| p.plan.iterations as f64),
        defect: spread(|p| p.plan.defect),
        margin_q: spread(|p| p.plan.margins.margin_q),
        margin_qd: spread(|p| p.plan.margins.margin_qd),
        margin_tau: spread(|p| p.plan.margins.margin_tau),
        t_f: spread(|p| p.t_f),
        distance: Spread::of(plans().filter_map(|p| p.plan.distance)),
        times: ReplanTimes {
            replan: time(|t| t.total),
            qp: part(|t| t.qp),
            lqr: part(|t| t.lqr),
            total: begin.elapsed().as_secs_f64(),
        },
        results: results.into_iter().map(|(result, _)| result).collect(),
    })
}

fn sample(planner: &Planner, solver: &mut QpSolver, index: u64, start: &State) -> (StartResult, StartTimes) {
    let config = planner.config();
    let effort = Effort::iterations(config.planner.replan.iterations);
    let begin = Instant::now();
    let result = planner.replan_with(solver, 0, first_manoeuvre(config).given(), start, &effort);
    let total = begin.elapsed().as_secs_f64();
    let (plan, failure, times) = match &result {
        Ok(replan) => {
            let message = PlanMessage::new(&replan.plan(config), config.model.order());
            let refused = accept(&message, config).err();
            let failure = refused.map(|e| format!("the daemon refused the plan: {e}"));
            let figures = PlanFigures { t_f: replan.trajectory.t_f, plan: replan.into() };
            let (qp, lqr) = (replan.statistics.qp.as_secs_f64(), replan.statistics.lqr.as_secs_f64());
            (Some(figures), failure, StartTimes { qp, lqr, total })
        }
        Err(e) => (None, Some(e.to_string()), StartTimes { total, ..StartTimes::default() }),
    };
    (StartResult { index, start: shown_pose(&config.model, start), plan, failure }, times)
}
