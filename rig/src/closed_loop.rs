//! Controller and simulated plant in one process, stepped alternately cycle by cycle, without shared memory.

use crate::course::{self, Course, first_manoeuvre};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use upswing_config::{Config, Push};
use upswing_ipc::{ManoeuvreRequest, Mode, PlanMessage, PlannerResponse, PlannerStatus, Telemetry};
use upswing_model::{ActuatedVector, JointVector};
use upswing_ocp::qp::QpSolver;
use upswing_planner::continuous::{ContinuousReplanning, TrackedMotion};
use upswing_planner::replan::{Effort, NoPlan, Planner};
use upswing_planner::service::describe;
use upswing_plant::{Plant, SetEventError, StateError};
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_trajectory::{Margins, Plan};
use upswingd::controller::Controller;
use upswingd::plan::{PlanRefusal, accept};
use upswingd::step::{StepInput, StepOutput, StepRequest};
use upswingd::trip::TripCause;

/// Consecutive cycles without a new measurement after which a run is aborted; one second at 8 kHz.
const MOST_SILENT: u32 = 8000;

/// Cycles between two looks whether a run is to end: some milliseconds.
const LOOK: usize = 1000;

/// Error of a swing-up that ended early.
#[derive(Debug, thiserror::Error)]
pub enum Aborted {
    /// The plant cannot take the start state.
    #[error(transparent)]
    Start(#[from] StateError),
    /// The planner found no plan.
    #[error(transparent)]
    NoPlan(#[from] NoPlan),
    /// A planner that takes the place of ours gave no plan.
    #[error("no plan: {0}")]
    NoPlanGiven(String),
    /// The daemon did not accept the plan.
    #[error("the daemon refused the plan: {0}")]
    Plan(#[from] PlanRefusal),
    /// The controller refused a request.
    #[error("{request} was refused: {refusal}")]
    Refused {
        /// Name of the request.
        request: &'static str,
        /// Reason of the refusal.
        refusal: String,
    },
    /// The plant refused a push.
    #[error("push: {0}")]
    Push(#[from] SetEventError),
    /// A controller that takes the place of the daemon's gave no torque.
    #[error("the controller failed: {0}")]
    Controller(String),
    /// The run was ended from outside.
    #[error("interrupted")]
    Interrupted,
    /// No new measurement arrives, because a fault of the plant suppresses them.
    #[error("no new measurement in {MOST_SILENT} cycles")]
    Silent,
    /// The controller tripped.
    #[error(
        "{mode} tripped {time:.3} s after the plan's start: {reason}; q {:.3?}, qd {:.3?}",
        .record.of_joints(&.record.q), .record.of_joints(&.record.qd)
    )]
    Tripped {
        /// Mode before the trip.
        mode: Mode,
        /// Time since the start of the plan, s; 0 before the start.
        time: f64,
        /// Limit that was exceeded.
        cause: TripCause,
        /// Name of the joint that exceeded it; the first one for a limit of no joint.
        joint: String,
        /// Limit, joint and value in words.
        reason: String,
        /// Record of the cycle of the trip.
        record: Box<Telemetry>,
    },
}

impl Aborted {
    /// Kind of the failure, without numbers, so that failures of one kind can be counted.
    pub fn kind(&self) -> String {
        match self {
            Self::Start(_) => "the plant cannot start there".into(),
            Self::NoPlan(_) | Self::NoPlanGiven(_) => "no plan".into(),
            Self::Plan(_) => "the daemon refused the plan".into(),
            Self::Refused { request, .. } => format!("{request} was refused"),
            Self::Push(_) => "the push cannot be".into(),
            Self::Controller(_) => "the controller failed".into(),
            Self::Interrupted => "interrupted".into(),
            Self::Silent => "no measurements".into(),
            Self::Tripped { mode, cause, joint, .. } => {
                format!("{mode} tripped: {}, joint `{joint}`", cause.text())
            }
        }
    }
}

/// Consecutive cycles in which the controller does not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissedCycles {
    /// First missed cycle, counted from the start of the plan.
    pub from: u64,
    /// Number of missed cycles.
    pub cycles: u64,
}

/// Disturbances of a swing-up after the start of its plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Disturbances {
    /// Pushes on the rod, their cycles counted from the start of the plan.
    pub pushes: Vec<Push>,
    /// Missed cycles, in the order of time.
    pub missed: Vec<MissedCycles>,
}

/// A controller in place of that of the daemon: the torques of the actuated joints (N m or N) for the record of a cycle, which has the
/// measured positions, the estimated velocities, the reference, and what the controller of the daemon would do.
pub type OtherController<'a> = dyn FnMut(&Telemetry) -> Result<ActuatedVector, String> + 'a;

/// What may be different in a run: another planner or controller, to compare them with those of the daemon, and its end from outside.
#[derive(Default)]
pub struct RunOptions<'a> {
    /// The plan to follow; `None`: the planner makes one.
    pub plan: Option<Plan>,
    /// The controller in Track and Balance, within the torque limits of the robot; the one of the daemon estimates velocities and monitors all
    /// limits. `None`: the one of the daemon.
    pub controller: Option<Box<OtherController<'a>>>,
    /// Asked once in a thousand cycles whether to end the run.
    pub interrupted: Option<&'a dyn Fn() -> bool>,
    /// Is set to what continuous replanning did in the run.
    pub replans: Option<&'a mut ReplanCounts>,
}

/// Numbers of the steps of continuous replanning in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplanCounts {
    /// Plans that replaced the running one.
    pub active: u64,
    /// Steps without a plan.
    pub failed: u64,
    /// Plans that the daemon refused, or dropped at their activation.
    pub dropped: u64,
}

impl std::ops::AddAssign for ReplanCounts {
    fn add_assign(&mut self, other: Self) {
        self.active += other.active;
        self.failed += other.failed;
        self.dropped += other.dropped;
    }
}

/// Continuous replanning in lockstep: a plan follows from the record of a cycle, and the controller gets it at its activation, however long the
/// computation took.
struct LockstepReplanning<'a> {
    replanning: ContinuousReplanning<'a>,
    config: &'a Config,
    running: Plan,
    /// The plan on its way to the controller.
    waiting: Option<Plan>,
    /// Earliest time of the next step, ns on the plant's clock.
    next_ns: u64,
    counts: ReplanCounts,
}

impl LockstepReplanning<'_> {
    /// The request that brings the waiting plan to the controller, if the cycle at `t_ns` is the one of its activation or a later one.
    fn request(&mut self, t_ns: u64) -> Option<StepRequest> {
        let activation_ns = self.waiting.as_ref()?.activation_ns?;
        if activation_ns > t_ns {
            return None;
        }
        let message = PlanMessage::new(self.waiting.as_ref()?, self.config.model.order());
        match accept(&message, self.config) {
            Ok(plan) => Some(StepRequest::Load(plan)),
            Err(_) => {
                self.waiting = None;
                self.counts.dropped += 1;
                None
            }
        }
    }

    /// Notes whether the waiting plan is running after a cycle in which the controller got it (`sent`), and plans the rest of the motion again if it is
    /// time.
    fn observe(&mut self, record: &Telemetry, sent: bool) {
        if sent && let Some(plan) = self.waiting.take() {
            if plan.id == record.plan_id {
                self.running = plan;
                self.counts.active += 1;
            } else {
                self.counts.dropped += 1;
            }
        }
        if self.waiting.is_some()
            || record.mode() != Ok(Mode::Track)
            || record.plan_id != self.running.id
            || record.t_ns < self.next_ns
        {
            return;
        }
        let Ok(vectors) = record.vectors(self.config.model.order()) else { return };
        let settings = &self.config.planner.continuous;
        let period = self.config.daemon.cycle.period;
        let cycles = |time: Duration| period.nanos_of(period.nearest_cycles(time.as_secs_f64()).max(1));
        let motion = TrackedMotion { plan: &self.running, t: record.t_plan, x: vectors.x, t_ns: record.t_ns };
        self.next_ns = record.t_ns + cycles(settings.period);
        match self.replanning.step(&motion, cycles(settings.lead)) {
            Ok(plan) => self.waiting = plan,
            Err(_) => self.counts.failed += 1,
        }
    }
}

/// Controller and plant in lockstep: one control step per plant step, as on the clock `lockstep`.
#[derive(Clone, Debug)]
pub struct ClosedLoop {
    /// The controller of the daemon.
    pub controller: Controller,
    /// The simulated plant.
    pub plant: Plant,
    /// `seq` of the newest measurement.
    measured: u64,
}

impl ClosedLoop {
    /// A closed loop before its first cycle; `config` are the settings of the controller.
    pub fn new(config: &Config, plant: Plant) -> Self {
        Self { controller: Controller::new(config), plant, measured: 0 }
    }

    /// Steps controller and plant by one cycle and returns the output of the controller. Without a new measurement (a fault of the plant)
    /// the controller does not run, as in the daemon: the output is `None` and the request stays pending.
    pub fn cycle(&mut self, request: &mut Option<StepRequest>) -> Option<StepOutput> {
        self.cycle_with(request, |_| ())
    }

    /// As [`Self::cycle`]; `change` may replace the command before the plant gets it.
    pub fn cycle_with(
        &mut self,
        request: &mut Option<StepRequest>,
        change: impl FnOnce(&mut StepOutput),
    ) -> Option<StepOutput> {
        let measurement = self.plant.measure();
        let new = measurement.seq != self.measured;
        self.measured = measurement.seq;
        let mut output = new.then(|| self.controller.step(StepInput::new(measurement, 0, request.take())));
        if let Some(output) = &mut output {
            change(output);
        }
        self.plant.step(output.as_ref().map(|output| &output.command));
        output
    }
}

/// A swing-up that ends at the first refusal or trip.
struct SwingUpRun<'a, D> {
    system: ClosedLoop,
    config: &'a Config,
    planner: &'a Planner,
    solver: &'a mut QpSolver,
    disturbances: Option<D>,
    options: RunOptions<'a>,
    /// Cycles that the controller misses after the start of the plan.
    missed: Vec<MissedCycles>,
    /// Duration t_F of the plan that was started, s.
    first_t_f: f64,
    /// From the start of the plan on, if the settings of the planner ask for it.
    replanning: Option<LockstepReplanning<'a>>,
    records: &'a mut Vec<Telemetry>,
    /// Largest true speed of each joint in Track and Balance so far, rad/s.
    fastest: JointVector,
}

impl<D> SwingUpRun<'_, D> {
    fn cycle(&mut self, request: Option<StepRequest>) -> Result<(), Aborted> {
        let look = self.records.len().is_multiple_of(LOOK);
        if look && self.options.interrupted.is_some_and(|interrupted| interrupted()) {
            return Err(Aborted::Interrupted);
        }
        let before = self.system.controller.mode();
        let t_ns = self.records.last().map_or(0, |last| last.t_ns) + self.config.daemon.cycle.period.nanos();
        let replacement = match (&request, &mut self.replanning) {
            (None, Some(replanning)) => replanning.request(t_ns),
            _ => None,
        };
        let replaces = replacement.is_some();
        let request = request.or(replacement);
        let (name, mut request) = request.map(|request| (request.name(), request)).unzip();
        let (config, other) = (self.config, &mut self.options.controller);
        let mut failed = None;
        let mut replace = |output: &mut StepOutput| {
            if let Some(other) = other
                && matches!(output.record.telemetry.mode(), Ok(Mode::Track | Mode::Balance))
            {
                failed = replace_torque(config, &mut **other, output).err();
            }
        };
        let output = (0..MOST_SILENT).find_map(|_| self.system.cycle_with(&mut request, &mut replace));
        let output = output.ok_or(Aborted::Silent)?;
        if let Some(e) = failed {
            return Err(Aborted::Controller(e));
        }
        let record = output.record.telemetry;
        self.records.push(record);
        if matches!(record.mode(), Ok(Mode::Track | Mode::Balance)) {
            self.fastest = self.fastest.sup(&self.system.plant.velocity().abs());
        }
        let model = &self.config.model;
        if let Some(replanning) = &mut self.replanning {
            replanning.observe(&record, replaces);
        }
        if let (Some(request), Some(Err(refusal)), false) = (name, output.answer, replaces) {
            return Err(Aborted::Refused { request, refusal: refusal.text(model) });
        }
        match output.record.trip {
            Some(trip) => {
                let start =
                    self.records.iter().find(|r| r.mode() == Ok(Mode::Track)).map_or(record.t_ns, |r| r.t_ns);
                let time = record.t_ns.saturating_sub(start) as f64 * 1e-9;
                Err(Aborted::Tripped {
                    mode: before,
                    time,
                    cause: trip.cause,
                    joint: model.joint_name(trip.joint).to_owned(),
                    reason: trip.text(model),
                    record: Box::new(record),
                })
            }
            None => Ok(()),
        }
    }

    fn cycles(&mut self, count: u64) -> Result<(), Aborted> {
        (0..count).try_for_each(|_| self.cycle(None))
    }

    /// Runs `count` cycles; in the missed ones the plant steps without a command.
    fn cycles_without_missed(&mut self, count: u64) -> Result<(), Aborted> {
        let mut passed = 0;
        for miss in std::mem::take(&mut self.missed) {
            self.cycles(miss.from.min(count).saturating_sub(passed))?;
            passed = passed.max(miss.from.min(count));
            let end = miss.from.saturating_add(miss.cycles).min(count);
            while passed < end {
                self.system.plant.step(None);
                passed += 1;
            }
        }
        self.cycles(count - passed)?;
        // A motion that was planned again may end later.
        let late = if self.replanning.is_some() { self.late_cycles() } else { 0 };
        self.cycles(late)
    }

    /// Number of cycles by which the motion ended later than its first plan.
    fn late_cycles(&self) -> u64 {
        let tracked = || self.records.iter().filter(|record| record.mode() == Ok(Mode::Track));
        let (Some(first), Some(last)) = (tracked().next(), tracked().next_back()) else { return 0 };
        let took = (last.t_ns - first.t_ns) as f64 * 1e-9;
        self.config.daemon.cycle.period.cycles_in(took - self.first_t_f)
    }
}

impl<D> SwingUpRun<'_, D> {
    /// The answer to a request for a plan that the run was given.
    fn describe_given(&self, plan: &Plan) -> PlannerResponse {
        let Config { model, robot, .. } = self.config;
        let margins = Margins::of(&plan.trajectory, model, &robot.planning, 0);
        PlannerResponse {
            status: PlannerStatus::Solved.code(),
            t_f: plan.trajectory.t_f,
            distance: f64::NAN,
            defect: plan.spline().defect(),
            margin_q: margins.q.share,
            margin_qd: margins.qd.share,
            margin_tau: margins.tau.share,
            ..PlannerResponse::default()
        }
    }
}

/// Replaces the torque of a command, and of its record, by that of another controller, cut to the limits of the robot.
fn replace_torque(
    config: &Config,
    other: &mut OtherController<'_>,
    output: &mut StepOutput,
) -> Result<(), String> {
    let asked = other(&output.record.telemetry)?;
    if let Some(i) = asked.iter().position(|tau| !tau.is_finite()) {
        return Err(format!(
            "torque of joint `{}`: expected a finite number, got {}",
            config.model.joint_name(i),
            asked[i]
        ));
    }
    let most = &config.robot.limits.tau_max;
    let tau = asked.inf(most).sup(&-most);
    output.command.tau = *tau.padded();
    let record = &mut output.record.telemetry;
    record.tau = *tau.padded();
    record.flags &= !Telemetry::LIMITED;
    if tau != asked {
        record.flags |= Telemetry::LIMITED;
    }
    Ok(())
}

impl<D: FnOnce(f64) -> Disturbances> Course for SwingUpRun<'_, D> {
    type Error = Aborted;

    fn advance(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycles(cycles)
    }

    fn hold(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycle(Some(StepRequest::Enable))?;
        self.cycles(cycles - 1)
    }

    /// Plans, loads and starts; the plant does not step while the plan is computed.
    fn start(&mut self, manoeuvre: &ManoeuvreRequest) -> Result<PlannerResponse, Aborted> {
        let start = *self.system.controller.state();
        let settings = &self.config.planner.replan;
        let effort = Effort::iterations(settings.iterations);
        let name = manoeuvre.name.as_str();
        let number = self.config.manoeuvres.iter().position(|m| m.name == name);
        let number = number.ok_or_else(|| Aborted::Refused {
            request: "plan",
            refusal: format!("unknown manoeuvre `{name}`"),
        })?;
        // A plan of others is followed as it is.
        let ours = self.options.plan.is_none();
        let (plan, response) = match self.options.plan.take() {
            Some(plan) => {
                let response = self.describe_given(&plan);
                (plan, response)
            }
            None => {
                let replan =
                    self.planner.replan_with(self.solver, number, manoeuvre.given(), &start, &effort)?;
                let time_total_us = replan.statistics.total.as_secs_f64() * 1e6;
                let response = PlannerResponse { time_total_us, ..describe(&replan, settings) };
                (replan.plan(self.config), response)
            }
        };
        let replanning = (ours && self.planner.config().planner.continuous.enabled).then(|| {
            let replanning = ContinuousReplanning::new(self.planner, number, manoeuvre.given(), &plan);
            replanning.map(|replanning| LockstepReplanning {
                replanning,
                config: self.config,
                running: plan.clone(),
                waiting: None,
                next_ns: 0,
                counts: ReplanCounts::default(),
            })
        });
        let plan = accept(&PlanMessage::new(&plan, self.config.model.order()), self.config)?;
        self.first_t_f = plan.trajectory.t_f;
        let id = plan.id;
        self.cycle(Some(StepRequest::Load(plan)))?;
        // The target that a plan was made for is one.
        self.replanning = replanning.and_then(Result::ok);
        self.cycle(Some(StepRequest::Start(id)))?;
        if let Some(disturbances) = self.disturbances.take() {
            let Disturbances { pushes, missed } = disturbances(response.t_f);
            let now = self.system.plant.seq();
            for push in pushes {
                self.system.plant.push(&Push { from: now + push.from, ..push })?;
            }
            self.missed = missed;
        }
        Ok(response)
    }

    fn watch(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycles_without_missed(cycles)
    }
}

/// Runs the first manoeuvre of the settings, a swing-up, balances for `seconds` (s) and evaluates the run. `config` are the settings of the
/// controller; the plant may have others. `disturbances` maps the duration t_F (s) of the plan to the disturbances; `options` may replace
/// planner and controller, and end the run. `records` is cleared and then filled with one record per control cycle.
///
/// # Errors
/// [`Aborted`] if the run ended early; the evaluation of a finished run contains its success or its failures.
pub fn swing_up(
    planner: &Planner,
    solver: &mut QpSolver,
    config: &Config,
    plant: Plant,
    seconds: f64,
    disturbances: impl FnOnce(f64) -> Disturbances,
    options: RunOptions<'_>,
    records: &mut Vec<Telemetry>,
) -> Result<SwingUpEvaluation, Aborted> {
    records.clear();
    let mut run = SwingUpRun {
        system: ClosedLoop::new(config, plant),
        config,
        planner,
        solver,
        disturbances: Some(disturbances),
        options,
        missed: Vec::new(),
        first_t_f: 0.0,
        replanning: None,
        records,
        fastest: JointVector::zeros(config.model.sizes()),
    };
    let period = config.daemon.cycle.period.seconds();
    let executed = course::execute_from_idle(&mut run, &first_manoeuvre(config), period, seconds);
    if let (Some(counts), Some(replanning)) = (run.options.replans.take(), &run.replanning) {
        *counts = replanning.counts;
    }
    let response = executed?;
    Ok(SwingUpEvaluation::new(config, &response, run.records, 0, seconds, Some(&run.fastest)))
}
