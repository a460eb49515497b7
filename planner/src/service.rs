//! The planner process: answers requests for plans and publishes the plans.

use crate::predict;
use crate::replan::{Effort, Method, NoPlan, Planner, Replan};
use crate::request_error::PlannerRequestError;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing::{info, warn};
use upswing_config::{Config, GivenOutsideLimits, Manoeuvre, ReplanSettings};
use upswing_ipc::{
    Clock, Domain, ManoeuvreRequest, Mode, PlanMessage, PlannerKind, PlannerRequest, PlannerResponse,
    PlannerStatus, Subscriber, Telemetry, TelemetryBatch, Text, TopicPayload as _,
};
use upswing_model::thresholds::{HELD_ACCELERATION, REST_SPEED_START, SAME_START, START_SLACK};
use upswing_model::{ActuatedVector, LimitKind, Model, Posture, State, Workspace};
use upswing_ocp::qp::QpSolver;
use upswing_process::notify::Notifier;
use upswing_process::{Failure, ProcessArgs, shutdown_flag};
use upswing_trajectory::Plan;

/// Pause between two polls for requests: short compared with a replan.
const PAUSE: Duration = Duration::from_millis(1);

/// Largest age of telemetry that describes the present state.
const FRESH: Duration = Duration::from_secs(5);

/// Largest age of telemetry from which a moving state is predicted.
const EXTRAPOLATED: Duration = Duration::from_millis(200);

/// Number of further attempts if a plan from a moving state is late; each attempt predicts further ahead.
const LATE: usize = 3;

/// Longest time from a request to the start of its plan.
const LONGEST_LEAD: Duration = Duration::from_secs(1);

/// Longest wait for telemetry that may turn a refusal (`NotReady`) into a plan.
const HANDS_OVER: Duration = Duration::from_millis(200);

/// Runs the planner until SIGINT or SIGTERM.
///
/// # Errors
/// [`Failure::BadInput`] for unusable settings or database, [`Failure::Failed`] if the domain cannot be used.
pub fn run(args: &ProcessArgs) -> Result<(), Failure> {
    let stop = shutdown_flag()?;
    let config = args.load()?;
    let planner = Planner::new(config).map_err(Failure::bad_input)?;
    let domain = Domain::new(&args.domain).map_err(Failure::bad_input)?;
    serve(&planner, &domain, &stop).map_err(Failure::failed)
}

fn serve(planner: &Planner, domain: &Domain, stop: &Arc<AtomicBool>) -> Result<(), upswing_ipc::IpcError> {
    let node = domain.join("planner")?;
    let server = node.server()?;
    let model = &planner.config().model;
    let publisher = node.plan_publisher(model.sizes(), planner.config().planner.offline.intervals)?;
    let telemetry = node.subscriber()?;
    let mut handler = RequestHandler::new(planner);
    info!(entries = planner.entries_of_all(), domain = domain.name(), "planner ready");
    let mut manager = Notifier::new();
    manager.ready();
    manager.status(&format!("{} database entries", planner.entries_of_all()));
    while !stop.load(Ordering::Acquire) {
        if let Some(record) = drain(&telemetry)? {
            handler.observe(record, Instant::now());
        }
        let mut published = Vec::new();
        let answered = server.poll_cancellable(|request, connected| {
            let wanted = &|| connected() && !stop.load(Ordering::Acquire);
            let begin = Instant::now();
            let mut attempts = 0;
            let (response, plan) = loop {
                // Plan from the newest telemetry. An error is dropped here: the next poll of the main loop returns it again.
                if let Ok(Some(record)) = drain(&telemetry) {
                    handler.observe(record, Instant::now());
                }
                let answer = handler.answer(request, wanted);
                attempts += usize::from(handler.late);
                let again = handler.late && attempts <= LATE;
                // A client that enables the daemon and requests a plan at once is faster than the telemetry.
                let early = answer.0.status() == Ok(PlannerStatus::NotReady);
                if !((again || early && begin.elapsed() < HANDS_OVER) && wanted()) {
                    break answer;
                }
                std::thread::sleep(PAUSE);
            };
            if let Ok(status) = response.status()
                && !matches!(status, PlannerStatus::Solved | PlannerStatus::OpenDefect)
            {
                warn!(reason = %response.reason, "request refused: {status}");
            }
            if request.publish == 1 && wanted() {
                published.extend(plan);
            }
            response
        })?;
        for plan in &published {
            publisher.publish(&PlanMessage::new(plan, model.order()))?;
            info!(id = format!("{:016x}", plan.id), t_f = plan.trajectory.t_f, "plan published");
        }
        publisher.deliver_history()?;
        if answered == 0 {
            handler.prepare(&|| !stop.load(Ordering::Acquire));
            std::thread::sleep(PAUSE);
        }
        manager.alive();
    }
    manager.stopping();
    Ok(())
}

/// Receives all waiting telemetry and returns the newest record; `None` if none is waiting.
fn drain(telemetry: &Subscriber<TelemetryBatch>) -> Result<Option<Telemetry>, upswing_ipc::IpcError> {
    let mut newest = None;
    // Bounded: a publisher that never pauses must not block the planner.
    for _ in 0..TelemetryBatch::BUFFER {
        let Some(batch) = telemetry.receive()? else { break };
        newest = batch.used().last().copied().or(newest);
    }
    Ok(newest)
}

/// Handler of requests for plans, with the state that the planner process keeps between requests.
pub struct RequestHandler<'a> {
    planner: &'a Planner,
    solver: QpSolver,
    /// The newest record of the daemon and the time of its arrival.
    newest: Option<(Telemetry, Instant)>,
    /// Number of the manoeuvre that is prepared: the first one from hanging without given values.
    first: Option<usize>,
    /// A state at rest and the prepared plan of that manoeuvre from it; the plan is `None` if the replan failed.
    prepared: Option<(State, Option<Replan>)>,
    /// Time from a request to the start of its plan while the pendulum moves: at least `replan.lead`, more on a slow machine.
    lead: Duration,
    /// Number of QPs on which Clarabel was asked since the start of the process.
    second_opinions: usize,
    /// Whether the last plan was ready only after its start; the next plan will begin later.
    late: bool,
}

/// Start of a plan: state and time.
struct PlanStart {
    /// rad, rad/s.
    x: State,
    /// Time of `x` on the daemon's clock, ns; `None`: the daemon holds the robot in `x`.
    activation_ns: Option<u64>,
    /// The same time on the clock of this process; `None` if `activation_ns` is.
    due: Option<Instant>,
}

impl<'a> RequestHandler<'a> {
    /// Creates a handler without telemetry and without a prepared plan.
    pub fn new(planner: &'a Planner) -> Self {
        let lead = planner.config().planner.replan.lead;
        let hanging = |m: &Manoeuvre| m.start == Posture::Hanging && m.given().next().is_none();
        Self {
            first: planner.config().manoeuvres.iter().position(hanging),
            planner,
            solver: planner.solver(),
            newest: None,
            prepared: None,
            lead,
            second_opinions: 0,
            late: false,
        }
    }

    /// Stores the newest record of the daemon, which arrived at `seen`.
    pub fn observe(&mut self, record: Telemetry, seen: Instant) {
        self.newest = Some((record, seen));
    }

    /// Prepares the first manoeuvre from hanging without given values from the present state while the daemon is in Hold and nothing
    /// moves, so that a request is answered at once; stops as soon as `wanted` returns false.
    pub fn prepare(&mut self, wanted: &dyn Fn() -> bool) {
        let (Some((record, seen)), Some(manoeuvre)) = (&self.newest, self.first) else { return };
        let Ok(vectors) = record.vectors(self.planner.config().model.order()) else { return };
        let start = vectors.x;
        // Not in lockstep: there equal runs have to give equal plans, however long planning takes.
        if stands_still(record)
            || stale(record, *seen)
            || record.mode() != Ok(Mode::Hold)
            || !hangs(&self.planner.config().model, &start)
            || check_start(self.planner, &start).is_err()
        {
            return;
        }
        if self.prepared.as_ref().is_some_and(|(from, _)| near(from, &start)) {
            return;
        }
        let iterations = self.planner.config().planner.replan.iterations;
        let cancelled = || !wanted();
        let effort = Effort { cancelled: Some(&cancelled), ..Effort::iterations(iterations) };
        let replan = self.planner.replan_with(&mut self.solver, manoeuvre, &[], &start, &effort);
        self.second_opinions += log_second_opinions(&replan);
        if !wanted() {
            return;
        }
        if let Err(e) = &replan {
            warn!("no {} from the present pose: {e}", self.planner.config().manoeuvres[manoeuvre].name);
        }
        self.prepared = Some((start, replan.ok()));
    }

    /// Checks and answers one request: the response and the plan, if any; planning stops as soon as `wanted` returns false.
    pub fn answer(
        &mut self,
        request: &PlannerRequest,
        wanted: &dyn Fn() -> bool,
    ) -> (PlannerResponse, Option<Plan>) {
        let begin = Instant::now();
        self.late = false;
        let mut answer = match request.kind() {
            Err(unknown) => Err(PlannerRequestError::UnknownKind(unknown)),
            Ok(PlannerKind::Status) => {
                let mut reason = format!("ready with {} database entries", self.planner.entries_of_all());
                if self.second_opinions > 0 {
                    let count = self.second_opinions;
                    reason += &format!("; Clarabel was asked for a second opinion on {count} QPs");
                }
                let reason = Text::new(&reason);
                let status = PlannerStatus::Solved.code();
                Ok((PlannerResponse { status, reason, ..Default::default() }, None))
            }
            Ok(PlannerKind::Plan) => self.plan(request, begin, wanted),
        }
        .unwrap_or_else(|e| {
            let reason = Text::new(&e.to_string());
            (PlannerResponse { status: e.status().code(), reason, ..Default::default() }, None)
        });
        answer.0.time_total_us = begin.elapsed().as_secs_f64() * 1e6;
        answer
    }

    fn plan(
        &mut self,
        request: &PlannerRequest,
        begin: Instant,
        wanted: &dyn Fn() -> bool,
    ) -> Result<(PlannerResponse, Option<Plan>), PlannerRequestError> {
        /// Largest number of linearisations in a request; further ones change nothing.
        const MOST_ITERATIONS: u64 = 100;
        let config = self.planner.config();
        let name = request.manoeuvre.name.as_str();
        let manoeuvre = config.manoeuvres.iter().position(|m| m.name == name);
        let manoeuvre = manoeuvre.ok_or_else(|| PlannerRequestError::UnknownManoeuvre {
            got: name.to_owned(),
            known: config.manoeuvres.iter().map(|m| format!("`{}`", m.name)).collect::<Vec<_>>().join(", "),
        })?;
        let settings = &config.planner.replan;
        let iterations = match request.iterations {
            0 => settings.iterations,
            n if n <= MOST_ITERATIONS => n as usize,
            got => return Err(PlannerRequestError::Iterations { got, max: MOST_ITERATIONS }),
        };
        let PlanStart { x: start, activation_ns, due } = if request.from_now == 1 {
            self.start_from_now(&config.manoeuvres[manoeuvre], request.known_seq, begin)?
        } else {
            let x = request.start(config.model.order()).map_err(PlannerRequestError::StartOfOtherChain)?;
            PlanStart { x, activation_ns: None, due: None }
        };
        check_start(self.planner, &start)?;
        let given = given_values(config, &config.manoeuvres[manoeuvre], &request.manoeuvre, &start)?;
        let deadline = (request.budget_ms > 0)
            .then(|| begin.checked_add(Duration::from_millis(request.budget_ms)))
            .flatten();
        let prepared = self.prepared.as_ref().filter(|(from, _)| {
            Some(manoeuvre) == self.first
                && request.from_now == 1
                && request.iterations == 0
                && near(from, &start)
        });
        if let Some((_, Some(replan))) = prepared {
            let plan = replan.plan(config);
            let reason = Text::new("ready before it was asked for");
            return Ok((
                PlannerResponse { plan_id: plan.id, reason, ..describe(replan, settings) },
                Some(plan),
            ));
        }
        let cancelled = || !wanted();
        let effort = Effort { deadline, cancelled: Some(&cancelled), ..Effort::iterations(iterations) };
        let mut replan = |effort| {
            let replan = self.planner.replan_with(&mut self.solver, manoeuvre, &given, &start, effort);
            self.second_opinions += log_second_opinions(&replan);
            replan
        };
        // For a moving start, which is due soon, a somewhat longer plan is better than a late plan.
        let replan = if due.is_some() {
            replan(&Effort { optimise: false, ..effort }).or_else(|_| replan(&effort))
        } else {
            replan(&effort)
        };
        let replan = replan?;
        if let Some(due) = due {
            let (lead, took) = (self.lead, begin.elapsed());
            self.lead = (took * 2).clamp(self.planner.config().planner.replan.lead, LONGEST_LEAD);
            if Instant::now() > due {
                self.late = true;
                return Err(PlannerRequestError::TooLate { took, lead });
            }
        }
        let plan = Plan { activation_ns, ..replan.plan(self.planner.config()) };
        let activation_ns = activation_ns.unwrap_or(0);
        Ok((PlannerResponse { plan_id: plan.id, activation_ns, ..describe(&replan, settings) }, Some(plan)))
    }

    /// The start of a plan "from now": the measured state if the daemon holds it (at rest in Hold, or balanced); while the
    /// pendulum moves, the state predicted for the activation of the plan. In lockstep always the measured state, because there
    /// the operator decides how much time passes during planning.
    fn start_from_now(
        &self,
        manoeuvre: &Manoeuvre,
        known_seq: u64,
        begin: Instant,
    ) -> Result<PlanStart, PlannerRequestError> {
        let Some((record, seen)) = &self.newest else {
            return Err(PlannerRequestError::NoTelemetry);
        };
        if stale(record, *seen) {
            return Err(PlannerRequestError::DaemonSilent);
        }
        if record.seq < known_seq {
            return Err(PlannerRequestError::TelemetryBehind { expected: known_seq, got: record.seq });
        }
        let config = self.planner.config();
        let needed = Mode::from_posture(manoeuvre.start);
        match record.mode() {
            Ok(mode) if mode == needed => {}
            Ok(mode) => {
                let next = mode.next_action(|start| config.first_manoeuvre(start)).to_string();
                let manoeuvre = manoeuvre.name.clone();
                return Err(PlannerRequestError::Mode { manoeuvre, needed, mode, next });
            }
            Err(unknown) => return Err(PlannerRequestError::UnknownMode(unknown)),
        }
        let vectors =
            record.vectors(config.model.order()).map_err(PlannerRequestError::TelemetryOfOtherChain)?;
        let x = vectors.x;
        if manoeuvre.start == Posture::Standing || hangs(&config.model, &x) {
            return Ok(PlanStart { x, activation_ns: None, due: None });
        }
        if stands_still(record) || config.planner.replan.lead.is_zero() {
            return Ok(PlanStart { x, activation_ns: None, due: None });
        }
        let age = begin.saturating_duration_since(*seen);
        if age > EXTRAPOLATED {
            return Err(PlannerRequestError::TelemetryTooOld { age, limit: EXTRAPOLATED });
        }
        let q_hold = vectors.x_d.q_a();
        let due = begin + self.lead;
        let ahead = due.saturating_duration_since(*seen);
        let (hold, seconds) = (&config.daemon.hold, ahead.as_secs_f64());
        let x = predict::held(&config.model, hold, &x, &q_hold, seconds, &mut Workspace::default());
        let activation_ns = record.t_ns.saturating_add(u64::try_from(ahead.as_nanos()).unwrap_or(u64::MAX));
        Ok(PlanStart { x, activation_ns: Some(activation_ns), due: Some(due) })
    }
}

/// Whether the clock of the plant stands still while a plan is made.
fn stands_still(record: &Telemetry) -> bool {
    record.clock().is_ok_and(Clock::stands_still)
}

/// Whether a record that arrived at `seen` is too old, so that its daemon may have ended.
fn stale(record: &Telemetry, seen: Instant) -> bool {
    !stands_still(record) && seen.elapsed() > FRESH
}

/// Whether all velocities are within the noise of the velocity filter.
fn at_rest(x: &State) -> bool {
    x.qd().iter().all(|v| v.abs() <= REST_SPEED_START)
}

/// Whether arm and pendulum are at rest and stay there: the pendulum is not at the turning point of a swing.
fn hangs(model: &Model, x: &State) -> bool {
    let qdd_u = model.f(x, &ActuatedVector::zeros(model.sizes()), &mut Workspace::default()).qd_u();
    at_rest(x) && qdd_u.iter().all(|a| a.abs() <= HELD_ACCELERATION)
}

/// Whether a plan from `a` can start in `b`: both are at rest in the same pose.
fn near(a: &State, b: &State) -> bool {
    at_rest(a) && at_rest(b) && (a.q() - b.q()).iter().all(|d| d.abs() <= SAME_START)
}

fn check_start(planner: &Planner, start: &State) -> Result<(), PlannerRequestError> {
    let config = planner.config();
    let (model, limits) = (&config.model, &config.robot.planning);
    for (row, got) in start.iter().copied().enumerate() {
        let (kind, i) = LimitKind::of_row(row, model.sizes());
        let joint = || model.joint_name(i).to_owned();
        if !got.is_finite() {
            return Err(PlannerRequestError::StartNotFinite { kind, joint: joint(), got });
        }
        let (min, max) = limits.range(kind, i);
        let (slack, per) = match kind {
            LimitKind::Velocity => (0.0, "/s"),
            _ => (START_SLACK, ""),
        };
        if !(got >= min - slack && got <= max + slack) {
            let [(min, unit), (max, _), (got, _)] = [min, max, got].map(|v| model.joint_kind(i).shown(v));
            let unit = format!("{unit}{per}");
            return Err(PlannerRequestError::StartOutsideLimits {
                kind,
                joint: joint(),
                min,
                max,
                got,
                unit,
            });
        }
    }
    Ok(())
}

/// The values that a request gives to the target of a manoeuvre, rad or m; a value that it leaves out is that of `start`.
fn given_values(
    config: &Config,
    manoeuvre: &Manoeuvre,
    request: &ManoeuvreRequest,
    start: &State,
) -> Result<Vec<f64>, PlannerRequestError> {
    let (model, joints) = (&config.model, manoeuvre.given().map(|axis| axis.joint).collect::<Vec<_>>());
    if request.number != 0 && request.number != joints.len() as u64 {
        return Err(PlannerRequestError::GivenNumber {
            manoeuvre: manoeuvre.name.clone(),
            joints: match joints.len() {
                0 => "none".to_owned(),
                _ => joints
                    .iter()
                    .map(|i| format!("`{}`", model.joint_name(*i)))
                    .collect::<Vec<_>>()
                    .join(", "),
            },
            got: request.number,
        });
    }
    let value = |(number, joint): (usize, &usize)| match request.given().get(number) {
        Some(got) if !got.is_nan() => {
            GivenOutsideLimits::check(config, *joint, *got)?;
            Ok(*got)
        }
        _ => Ok(start[*joint]),
    };
    joints.iter().enumerate().map(value).collect()
}

/// Logs the QPs of a replan on which Clarabel was asked, and returns their number.
fn log_second_opinions(replan: &Result<Replan, NoPlan>) -> usize {
    let second_opinions = match replan {
        Ok(replan) => &replan.statistics.second_opinions,
        Err(no_plan) => &no_plan.second_opinions,
    };
    second_opinions.iter().for_each(|opinion| warn!("{opinion}"));
    second_opinions.len()
}

/// The response for a plan, without its id and the total time.
pub fn describe(replan: &Replan, settings: &ReplanSettings) -> PlannerResponse {
    let micros = |d: Duration| d.as_secs_f64() * 1e6;
    // Written so that a NaN counts as an open defect.
    let closed = replan.defect <= settings.defect;
    let status = if closed { PlannerStatus::Solved } else { PlannerStatus::OpenDefect };
    let reason = match replan.method {
        _ if !closed => {
            Text::new(&format!("defect {:.1e}, the setting is {:.0e}", replan.defect, settings.defect))
        }
        Method::Quadratic => match replan.solved_by_clarabel() {
            0 => Text::default(),
            n => Text::new(&format!("{n} QPs solved by Clarabel: the structured solver made no progress")),
        },
        Method::Optimisation if replan.entry.is_none() => {
            Text::new("optimised in full: there is no database")
        }
        Method::Optimisation => Text::new("optimised in full: no database entry is near enough"),
    };
    PlannerResponse {
        status: status.code(),
        reason,
        t_f: replan.trajectory.t_f,
        nearest_entry: replan.entry.map_or(0, |entry| entry.index as u64),
        distance: replan.entry.map_or(f64::NAN, |entry| entry.distance),
        iterations: replan.iterations as u64,
        defect: replan.defect,
        margin_q: replan.margins.q.share,
        margin_qd: replan.margins.qd.share,
        margin_tau: replan.margins.tau.share,
        time_nearest_us: micros(replan.statistics.nearest),
        time_qp_us: micros(replan.statistics.qp + replan.statistics.optimisation),
        time_lqr_us: micros(replan.statistics.lqr),
        ..Default::default()
    }
}
