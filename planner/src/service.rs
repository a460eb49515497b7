//! The planner process: answers requests with plans.

use crate::qp::Solver;
use crate::replan::{Planner, Replan};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing::{info, warn};
use upswing_config::process::{Failure, ProcessArgs, shutdown_flag};
use upswing_ipc::{
    Domain, Mode, PlannerKind, PlannerRequest, PlannerResponse, PlannerStatus, Subscriber, Telemetry,
    TelemetryBatch, Text,
};
use upswing_model::{NQ, NU, NX, State};
use upswing_trajectory::Plan;

/// Options of the planner process.
#[derive(Clone, Debug, clap::Args)]
pub struct PlannerArgs {
    /// Options that all processes have.
    #[command(flatten)]
    pub process: ProcessArgs,
}

/// Pause between two looks for requests: small against a replan.
const PAUSE: Duration = Duration::from_millis(1);

/// How far a measured start may be outside its limits, rad: the noise of an arm that stands on its limit.
const START_SLACK: f64 = 1e-3;

/// Runs the planner until SIGINT or SIGTERM.
///
/// # Errors
/// [`Failure::BadInput`] for unusable settings or database, [`Failure::Failed`] if the domain cannot be used.
pub fn run(args: &PlannerArgs) -> Result<(), Failure> {
    let stop = shutdown_flag()?;
    let config = args.process.load()?;
    let origin = config.database.origin.clone();
    let planner = Planner::new(config).map_err(|e| Failure::BadInput(format!("{origin}: {e}")))?;
    let domain = Domain::new(&args.process.domain).map_err(|e| Failure::BadInput(e.to_string()))?;
    serve(&planner, &domain, &stop).map_err(|e| Failure::Failed(e.to_string()))
}

fn serve(planner: &Planner, domain: &Domain, stop: &Arc<AtomicBool>) -> Result<(), upswing_ipc::IpcError> {
    let node = domain.connect("planner")?;
    let server = node.planner_server()?;
    let publisher = node.plan_publisher()?;
    let telemetry = node.telemetry_subscriber()?;
    let mut solver = planner.solver();
    let mut newest = None;
    info!(entries = planner.entries().len(), domain = domain.name(), "planner ready");
    while !stop.load(Ordering::Acquire) {
        newest = drain(&telemetry)?.or(newest);
        let mut published = Vec::new();
        server.poll(|request| {
            let (response, plan) = answer(planner, &mut solver, request, newest.as_ref());
            if request.publish == 1 {
                published.extend(plan);
            }
            response
        })?;
        for plan in &published {
            publisher.publish(&payload(plan))?;
            info!(id = format!("{:016x}", plan.id), t_f = plan.trajectory.t_f, "plan published");
        }
        publisher.greet()?;
        std::thread::sleep(PAUSE);
    }
    Ok(())
}

/// The newest record waiting.
fn drain(telemetry: &Subscriber<TelemetryBatch>) -> Result<Option<Telemetry>, upswing_ipc::IpcError> {
    let mut newest = None;
    while let Some(batch) = telemetry.receive()? {
        newest = batch.used().last().copied().or(newest);
    }
    Ok(newest)
}

/// Answers one request; nothing in it is trusted.
pub fn answer(
    planner: &Planner,
    solver: &mut Solver,
    request: &PlannerRequest,
    newest: Option<&Telemetry>,
) -> (PlannerResponse, Option<Plan>) {
    let begin = Instant::now();
    let refuse = |status: PlannerStatus, reason: &str| {
        warn!(reason, "request refused: {status}");
        let response =
            PlannerResponse { status: status.code(), reason: Text::new(reason), ..Default::default() };
        (response, None)
    };
    match request.kind() {
        Err(e) => return refuse(PlannerStatus::BadRequest, &e.to_string()),
        Ok(PlannerKind::Status) => {
            let entries = planner.entries().len();
            let reason = Text::new(&format!("ready with {entries} database entries"));
            return (
                PlannerResponse { status: PlannerStatus::Solved.code(), reason, ..Default::default() },
                None,
            );
        }
        Ok(PlannerKind::SwingDown) => {
            return refuse(PlannerStatus::BadRequest, "swing-down is not supported by this version");
        }
        Ok(PlannerKind::SwingUp) => {}
    }
    let start = if request.from_now == 1 {
        let Some(record) = newest else {
            return refuse(PlannerStatus::NotReady, "no telemetry from the daemon yet: is upswingd running?");
        };
        if record.mode() != Ok(Mode::Hold) {
            let mode = record.mode().map_or_else(|e| e.to_string(), |m| m.to_string());
            let reason = format!(
                "a swing-up from now needs the daemon in mode hold, it is in {mode}: enable it first"
            );
            return refuse(PlannerStatus::NotReady, &reason);
        }
        State::from_fn(|i, _| if i < NQ { record.q[i] } else { record.qd[i - NQ] })
    } else {
        State::from(request.start)
    };
    if let Some(i) = start.iter().position(|v| !v.is_finite()) {
        let reason = format!("start state: expected numbers, entry {i} is {}", start[i]);
        return refuse(PlannerStatus::BadRequest, &reason);
    }
    let limits = &planner.config().robot.planning;
    for i in 0..NQ {
        if !(start[i] >= limits.q_min[i] - START_SLACK && start[i] <= limits.q_max[i] + START_SLACK) {
            let reason = format!(
                "start of joint {}: expected {:.1} to {:.1} deg, got {:.2} deg",
                i + 1,
                limits.q_min[i].to_degrees(),
                limits.q_max[i].to_degrees(),
                start[i].to_degrees()
            );
            return refuse(PlannerStatus::StartOutsideLimits, &reason);
        }
        if !(start[NQ + i].abs() <= limits.qd_max[i]) {
            let reason = format!(
                "start velocity of joint {}: expected at most {:.1} deg/s, got {:.2} deg/s",
                i + 1,
                limits.qd_max[i].to_degrees(),
                start[NQ + i].to_degrees()
            );
            return refuse(PlannerStatus::StartOutsideLimits, &reason);
        }
    }
    let default = planner.config().planner.replan.iterations;
    /// More linearisations than this change nothing any more.
    const MOST_ITERATIONS: u64 = 100;
    let iterations = match request.iterations {
        0 => default,
        n if n <= MOST_ITERATIONS => n as usize,
        n => {
            let reason = format!("iterations: expected 0 (the setting) to {MOST_ITERATIONS}, got {n}");
            return refuse(PlannerStatus::BadRequest, &reason);
        }
    };
    let deadline = (request.budget_ms > 0)
        .then(|| begin.checked_add(Duration::from_millis(request.budget_ms)))
        .flatten();
    match planner.replan_with(solver, &start, iterations, deadline) {
        Ok(replan) => {
            let plan = replan.plan(planner.config());
            let mut response = describe(&replan);
            response.plan_id = plan.id;
            response.time_total_us = begin.elapsed().as_secs_f64() * 1e6;
            (response, Some(plan))
        }
        Err(e) => {
            let status = if e.out_of_time() { PlannerStatus::Deadline } else { PlannerStatus::Infeasible };
            refuse(status, &e.to_string())
        }
    }
}

fn describe(replan: &Replan) -> PlannerResponse {
    let micros = |d: Duration| d.as_secs_f64() * 1e6;
    let used = replan.attempts.last().map(|a| a.entry);
    PlannerResponse {
        status: PlannerStatus::Solved.code(),
        t_f: replan.trajectory.t_f,
        nearest_entry: used.map_or(0, |e| e.index as u64),
        distance: used.map_or(0.0, |e| e.distance),
        iterations: replan.iterations as u64,
        defect: replan.defect,
        margin_q: replan.margins.q.share,
        margin_qd: replan.margins.qd.share,
        margin_tau: replan.margins.tau.share,
        time_nearest_us: micros(replan.times.nearest),
        time_qp_us: micros(replan.times.qp),
        time_lqr_us: micros(replan.times.lqr),
        ..Default::default()
    }
}

/// The plan as it goes over shared memory.
pub fn payload(plan: &Plan) -> Box<upswing_ipc::Plan> {
    let mut p = upswing_ipc::Plan::boxed_zeroed();
    (p.id, p.fingerprint, p.t_f) = (plan.id, plan.fingerprint, plan.trajectory.t_f);
    let gain = |g: &upswing_trajectory::Gain| -> [[f64; NX]; NU] {
        std::array::from_fn(|i| std::array::from_fn(|j| g[(i, j)]))
    };
    for k in 0..plan.trajectory.x.len() {
        p.x[k] = plan.trajectory.x[k].into();
        p.u[k] = plan.trajectory.u[k].into();
        p.f[k] = plan.f[k].into();
        p.k[k] = gain(&plan.gains[k]);
    }
    p.k_final = gain(&plan.final_gain);
    p.seal();
    p
}
