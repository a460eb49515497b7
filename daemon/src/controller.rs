//! One control cycle: a pure function of measurement, time and its own state. The same code runs on every clock,
//! in the daemon and in-process.
//!
//! Nothing here allocates, frees, locks, logs, panics or enters the kernel. What has to be freed is handed back.

use crate::arm::ArmReference;
use crate::checks::Checks;
use crate::disturbance::Disturbance;
use crate::law;
use crate::observer::Observer;
use crate::plan::Ending;
use crate::standstill::Standstill;
use crate::supervisor::{Event, Refusal, Request, is_braked, transition};
use crate::trip::{Trip, TripCause};
use nalgebra::Vector3;
use upswing_config::{Config, JointFriction, PlanWhileTracking};
use upswing_ipc::{Clock, Command, Measurement, Mode, Step, Telemetry};
use upswing_model::{
    ActuatedMatrix, ActuatedVector, JointVector, Model, NQ, NU, State, Workspace, position, velocity,
};
use upswing_trajectory::Plan;

/// What the controller is told besides the measurement; at most one per cycle.
#[derive(Debug)]
pub enum Order {
    /// Change the mode.
    Do(Request),
    /// Keep a checked plan for the next start.
    Load(Box<Plan>),
}

impl Order {
    /// The number that stands for the order in a [`Step`]; above 0.
    pub fn code(&self) -> u64 {
        match self {
            Self::Load(_) => 1,
            Self::Do(request) => 2 + request.index(),
        }
    }

    /// Id of the plan that the order loads or starts, 0: none.
    pub fn plan_id(&self) -> u64 {
        match self {
            Self::Load(plan) => plan.id,
            Self::Do(Request::Start(id)) => *id,
            Self::Do(_) => 0,
        }
    }

    /// The order of a code and a plan's id; `plan` is for the one that loads a plan. `None` if there is no such order, or
    /// no plan for it.
    pub fn of(code: u64, plan_id: u64, plan: impl FnOnce() -> Option<Box<Plan>>) -> Option<Self> {
        match code.checked_sub(2) {
            None if code == 1 => plan().map(Self::Load),
            None => None,
            Some(index) => {
                let request = usize::try_from(index).ok().and_then(|index| Request::ALL.get(index));
                request.map(|request| match request {
                    Request::Start(_) => Self::Do(Request::Start(plan_id)),
                    request => Self::Do(*request),
                })
            }
        }
    }
}

/// What one cycle gives.
#[derive(Debug)]
pub struct Output {
    /// For the drives.
    pub command: Command,
    /// For those who watch.
    pub record: Record,
    /// To the order of this cycle, if there was one.
    pub answer: Option<Result<(), Refusal>>,
    /// A plan that is no longer needed, to be freed elsewhere.
    pub garbage: Option<Box<Plan>>,
}

/// What there is to know about one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// The published part.
    pub telemetry: Telemetry,
    /// What led to it.
    pub step: Step,
    /// Why the last mode was given up; kept until the next enable, start or reset.
    pub trip: Option<Trip>,
    /// Why an enable would be refused; `None` where it would not, and outside Idle.
    pub unready: Option<Refusal>,
    /// Cycles that ended too late since the start of the daemon; 0 from the controller, which knows no clock.
    pub overruns: u64,
}

/// x_d, u_d and the input u after feedback.
struct Target {
    x_d: State,
    u_d: ActuatedVector,
    u: ActuatedVector,
    t_plan: f64,
}

/// A plan that has been here since `since`, ns.
#[derive(Clone, Debug)]
struct Kept {
    plan: Box<Plan>,
    since: u64,
}

/// Filter, supervisor and control law.
#[derive(Clone, Debug)]
pub struct Controller {
    model: Model,
    work: Workspace,
    checks: Checks,
    tau_max: ActuatedVector,
    friction: JointFriction,
    while_tracking: PlanWhileTracking,

    mode: Mode,
    shutting_down: bool,
    /// Why the last mode was given up.
    trip: Option<Trip>,
    /// What exceeded its warning level in this cycle, [`TripCause::bit`].
    warnings: u64,
    cycle: u64,
    /// What it was told since the last step, and the number of that step.
    told: Step,

    observer: Observer,
    disturbance: Disturbance,
    standstill: Standstill,
    arm: ArmReference,
    /// Time of this cycle and, while a plan runs, of its start, ns.
    now: u64,
    start: u64,
    loaded: Option<Kept>,
    running: Option<Kept>,
    /// The rod at x_N, m.
    rod_at_end: Vector3<f64>,
    /// Torque of the last cycle, N m.
    last: ActuatedVector,
    /// For how many cycles the torque may still be on its way from the mode before to that of this mode.
    begins: u64,
    /// qdd that the torque of the last cycle is meant for, unless the limiter cut it.
    expected: Option<JointVector>,
    /// M~ of the last command, kg m^2.
    inertia: ActuatedMatrix,
    /// For how long a torque has acted on the arm that is enough for a collision, s.
    pressed: f64,
    /// Whether the robot measures the torque of its loads.
    senses: bool,
}

impl Controller {
    /// A controller in mode Idle that has measured nothing yet.
    pub fn new(config: &Config) -> Self {
        Self {
            model: config.model.clone(),
            work: Workspace::default(),
            checks: Checks::new(config),
            tau_max: config.robot.limits.tau_max,
            friction: config.robot.friction,
            while_tracking: config.daemon.plans.while_tracking,
            mode: Mode::Idle,
            shutting_down: false,
            trip: None,
            warnings: 0,
            cycle: 0,
            told: Step::default(),
            observer: Observer::new(&config.daemon.cycle),
            disturbance: Disturbance::new(
                &config.daemon.disturbance,
                config.robot.limits.tau_max * config.daemon.disturbance.most,
                config.daemon.cycle.velocity_filter,
            ),
            standstill: Standstill::new(
                &config.daemon.standstill,
                &config.robot.planning.q_max,
                &config.robot.limits.tau_max,
            ),
            arm: ArmReference::new(&config.daemon),
            now: 0,
            start: 0,
            loaded: None,
            running: None,
            rod_at_end: Vector3::zeros(),
            last: ActuatedVector::zeros(),
            begins: 0,
            expected: None,
            inertia: ActuatedMatrix::zeros(),
            pressed: 0.0,
            senses: false,
        }
    }

    /// The mode after the last cycle.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Why the last mode was given up; kept until the next enable, start or reset.
    pub fn trip(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    /// The state x = [q, qd] of the last cycle: measured angles (rad) and estimated velocities (rad/s).
    pub fn state(&self) -> &State {
        &self.observer.x
    }

    /// To be called when measurements do not come any more, which on the paced clock only the caller can tell.
    pub fn lose_measurement(&mut self, cycles: u64) {
        self.told.lost = cycles;
        let trip = self.checks.lost(cycles);
        self.observer.unfit = Some(trip);
        self.give_up(Event::Fault, trip);
    }

    /// To be called before the first measurement of another plant, or of the same after a restart.
    pub fn restart_measurement(&mut self) {
        self.told.restarted = 1;
        let trip = self.observer.restart();
        self.senses = false;
        self.give_up(Event::Fault, trip);
    }

    /// How many cycles in a row ended late before the next one; only the caller knows a clock.
    pub fn report_late(&mut self, cycles: u64) {
        self.told.late = cycles;
    }

    /// One cycle. `measurement` is the newest one, whether or not it is new; `now_ns` is the planned time of the
    /// cycle on the wall clock, and ignored on the others: they advance one period per measurement.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    pub fn step(&mut self, measurement: &Measurement, now_ns: u64, order: Option<Order>) -> Output {
        let told = Step {
            number: self.told.number + 1,
            now_ns,
            order: order.as_ref().map_or(0, Order::code),
            plan_id: order.as_ref().map_or(0, Order::plan_id),
            measurement: *measurement,
            ..self.told
        };
        self.told = Step { number: told.number, late: told.late, ..Step::default() };
        // Before a plant shows its clock no time passes: that of a paced one will begin at 0.
        let wall = measurement.period_ns > 0 && measurement.clock() == Ok(Clock::Wall);
        let first = self.observer.is_new();
        let now = if wall { now_ns } else { measurement.seq.saturating_mul(measurement.period_ns) };
        let elapsed = now.saturating_sub(self.now) as f64 * 1e-9;
        self.now = now;
        self.warnings = 0;
        let braked = is_braked(self.mode);
        let expected = self.expected.as_ref();
        let (fresh, restarted) =
            self.observer.observe(measurement, now_ns, &self.checks, expected, braked, &mut self.warnings);
        if fresh && (first || restarted.is_some()) {
            // Another plant, another time: plans age by its clock from here.
            for kept in [&mut self.loaded, &mut self.running].into_iter().flatten() {
                kept.since = now;
            }
        }
        if matches!(self.mode, Mode::Idle | Mode::Hold) {
            self.observer.drop_turns();
        }
        if restarted.is_some() {
            self.senses = false;
        }
        let mut collision = None;
        if braked {
            self.weigh(measurement, fresh);
            self.pressed = 0.0;
        } else {
            let v: ActuatedVector = self.observer.filtered.fixed_rows::<NU>(0).into();
            let u: Option<ActuatedVector> = expected.map(|qdd| qdd.fixed_rows::<NU>(0).into());
            self.disturbance.update(&v, u.as_ref(), elapsed, &self.inertia);
            let unexplained = self.checks.unexplained(self.disturbance.unexplained(), &mut self.warnings);
            // Drives that do not act leave all of the command unexplained; that has a limit of its own.
            let pressed = unexplained.is_some() && self.observer.drives_act();
            self.pressed = if pressed { self.pressed + elapsed } else { 0.0 };
            collision = unexplained.filter(|_| self.pressed >= self.checks.collision_time());
        }
        if self.warnings & TripCause::EncoderJump.bit() != 0 {
            self.standstill.jumped();
        }
        // What the brakes hold stands for good, and what was not measured says nothing.
        let stuck = if braked || !self.observer.drives_act() {
            self.standstill.reset();
            None
        } else if fresh {
            let elapsed = self.checks.period().seconds_of(self.observer.cycles());
            let q = position(&self.observer.x);
            let tau = measurement.tau_measured.into();
            let frozen = if self.senses { self.standstill.observe_all(&q, &tau, elapsed) } else { None };
            self.standstill.observe(&q, elapsed).or(frozen)
        } else {
            None
        };
        // Without a new measurement it is a cycle on the wall clock only, on the others an order between cycles.
        self.cycle += u64::from(fresh || wall);

        if let Some(trip) = restarted.or(self.observer.unfit).or(stuck).or(collision) {
            self.give_up(Event::Fault, trip);
        }
        if let Some(trip) = self.checks.late(told.late, &mut self.warnings) {
            self.give_up(Event::Lost, trip);
        }
        // The age of a plan matters where it could be started; what is too old is refused there.
        if let Some(kept) = &self.loaded
            && transition(self.mode, Event::Asked(Request::Start(kept.plan.id))).is_ok()
            && self.start_time(kept).is_ok()
        {
            let _ = self.checks.plan_age(age(kept, self.now), &mut self.warnings);
        }
        let mut garbage = None;
        let answer = order.map(|order| match order {
            Order::Do(request) => self.obey(request, &mut garbage),
            Order::Load(plan) => self.load(plan, &mut garbage),
        });

        let followed = if matches!(self.mode, Mode::Track | Mode::Balance) { self.follow() } else { None };
        let target = followed.unwrap_or_else(|| match self.mode {
            Mode::Hold | Mode::Stop => self.hold(elapsed),
            _ => self.rest(),
        });
        let (target, torque) = self.torque(target);
        // Nothing runs any more: what ran is loaded again, unless something newer is.
        if !matches!(self.mode, Mode::Track | Mode::Balance) {
            if self.loaded.is_none() {
                self.loaded = self.running.take();
            } else if garbage.is_none() {
                garbage = self.running.take().map(|kept| kept.plan);
            }
        }

        let t_ns = if wall { now_ns } else { measurement.t_ns };
        let telemetry = self.telemetry(measurement, t_ns, fresh, &target, &torque);
        Output {
            command: Command {
                seq: self.cycle,
                t_ns,
                measurement_seq: measurement.seq,
                tau: telemetry.tau,
                brake: is_braked(self.mode).into(),
            },
            record: Record {
                telemetry,
                step: Step { cycle: self.cycle, ..told },
                trip: self.trip,
                unready: self.unready(),
                overruns: 0,
            },
            answer,
            garbage,
        }
    }

    /// Closed brakes: where the robot measures the load that they hold, what gravity does not explain of it is the
    /// disturbance that Hold begins with. `fresh`: the measurement is new.
    fn weigh(&mut self, measurement: &Measurement, fresh: bool) {
        const HELD: u64 = Measurement::BRAKES_CLOSED | Measurement::LOAD_SENSED;
        self.senses |= measurement.status & Measurement::LOAD_SENSED != 0;
        if measurement.status & HELD != HELD || self.observer.unfit.is_some() {
            self.disturbance.reset();
        } else if fresh {
            // The arm is at rest, whatever the encoders' noise is; the pendulum may swing.
            let mut x = self.observer.x;
            x.fixed_rows_mut::<NU>(NQ).fill(0.0);
            let explained = self.model.torque(&x, &ActuatedVector::zeros(), &mut self.work);
            let elapsed = self.checks.period().seconds_of(self.observer.cycles());
            self.disturbance.weigh(&(explained - ActuatedVector::from(measurement.tau_measured)), elapsed);
        }
    }

    /// What this cycle was; `fresh`: its measurement is new.
    fn telemetry(
        &self,
        measurement: &Measurement,
        t_ns: u64,
        fresh: bool,
        target: &Target,
        torque: &law::Torque,
    ) -> Telemetry {
        let fault = self.trip.filter(|_| self.mode == Mode::Fault).map_or(0, |trip| trip.cause.code());
        let flag = |set: bool, bit: u64| if set { bit } else { 0 };
        Telemetry {
            seq: self.cycle,
            t_ns,
            measurement_seq: measurement.seq,
            mode: self.mode.code(),
            fault,
            warnings: self.warnings,
            plan_id: self.running.as_ref().map_or(0, |kept| kept.plan.id),
            flags: flag(!fresh, Telemetry::STALE)
                | flag(torque.limited, Telemetry::LIMITED)
                | flag(is_braked(self.mode), Telemetry::BRAKE),
            t_plan: target.t_plan,
            q: self.observer.position(measurement).into(),
            qd: velocity(&self.observer.x).into(),
            q_d: position(&target.x_d).into(),
            qd_d: velocity(&target.x_d).into(),
            u_d: target.u_d.into(),
            u: target.u.into(),
            tau: torque.tau.into(),
            tau_measured: measurement.tau_measured,
            clock: measurement.clock,
            ..Telemetry::default()
        }
    }

    /// Leaves the mode because of `trip`, where the table says so; from Fault it does not, so the first cause stays.
    fn give_up(&mut self, event: Event, trip: Trip) {
        if let Ok(to) = transition(self.mode, event) {
            self.trip = Some(trip);
            self.enter(to);
        }
    }

    /// Why the robot cannot be enabled now.
    fn unready(&self) -> Option<Refusal> {
        if self.mode != Mode::Idle {
            return None;
        }
        let unfit = self.observer.unfit.map(Refusal::Unfit);
        unfit.or((!self.observer.drives_ready).then_some(Refusal::DrivesNotReady))
    }

    fn load(&mut self, plan: Box<Plan>, garbage: &mut Option<Box<Plan>>) -> Result<(), Refusal> {
        let refusal = match &self.running {
            Some(kept) if self.mode == Mode::Track && self.while_tracking == PlanWhileTracking::Refuse => {
                Refusal::Tracking { running: kept.plan.id }
            }
            _ => {
                *garbage = self.loaded.replace(Kept { plan, since: self.now }).map(|kept| kept.plan);
                return Ok(());
            }
        };
        *garbage = Some(plan);
        Err(refusal)
    }

    fn obey(&mut self, request: Request, garbage: &mut Option<Box<Plan>>) -> Result<(), Refusal> {
        if self.shutting_down && request != Request::Shutdown {
            return Err(Refusal::ShuttingDown);
        }
        let to = transition(self.mode, Event::Asked(request))?;
        match request {
            Request::Enable => {
                if let Some(refusal) = self.unready() {
                    return Err(refusal);
                }
                self.trip = None;
            }
            Request::Start(id) => {
                let kept = self.loaded.as_ref().ok_or(Refusal::NoPlan)?;
                if kept.plan.id != id {
                    return Err(Refusal::OtherPlan { asked: id, loaded: kept.plan.id });
                }
                let begin = self.start_time(kept)?;
                self.checks.plan_age(age(kept, self.now), &mut self.warnings)?;
                self.rod_at_end = self.model.rod(&position(&kept.plan.end().x));
                self.start = begin;
                self.trip = None;
                // From Balance another plan ran until now.
                *garbage = self.running.take().map(|kept| kept.plan);
                self.running = self.loaded.take();
            }
            Request::Reset => self.trip = None,
            Request::Shutdown => self.shutting_down = true,
            Request::Hold | Request::Stop => {}
        }
        self.enter(to);
        Ok(())
    }

    /// The time of a loaded plan's t = 0 (ns) if it is started now: its activation, otherwise this moment.
    fn start_time(&self, kept: &Kept) -> Result<u64, Refusal> {
        let begin = kept.plan.activation_ns.unwrap_or(self.now);
        if begin > self.now {
            return Err(Refusal::BeforeActivation { wait: (begin - self.now) as f64 * 1e-9 });
        }
        let t_plan = (self.now - begin) as f64 * 1e-9;
        self.checks.start(&self.observer.x, &kept.plan.reference(t_plan).x, t_plan)?;
        Ok(begin)
    }

    fn enter(&mut self, to: Mode) {
        match (self.mode, to) {
            // The pose is there already.
            (Mode::Stop, Mode::Hold | Mode::Stop) => {}
            (Mode::Track, Mode::Hold) => {
                let end = self.running.as_ref().map_or(self.observer.x, |kept| kept.plan.end().x);
                self.arm.hold(&end);
            }
            (_, Mode::Hold) => self.arm.hold(&self.observer.x),
            (_, Mode::Stop) => self.arm.stop(&self.observer.x),
            _ => {}
        }
        self.mode = to;
        self.begins = self.checks.torque_steps();
        if to == Mode::Track {
            // How long a joint has stood in Hold says nothing of a motion that only begins.
            self.standstill.reset();
        }
    }

    /// Track and Balance: u = u_d + K (x - x_d). `None` if the plan ended in Hold or had to be given up.
    fn follow(&mut self) -> Option<Target> {
        let t_plan = self.now.saturating_sub(self.start) as f64 * 1e-9;
        if self.running.as_ref().is_some_and(|kept| t_plan >= kept.plan.trajectory.t_f)
            && let Ok(to) = transition(self.mode, Event::PlanEnded(Ending::of(&self.rod_at_end)))
        {
            self.enter(to);
            if to == Mode::Hold {
                return None;
            }
        }
        let Some(Kept { plan, .. }) = &self.running else {
            // Not reached: a start fills it, and only a start enters Track.
            self.enter(Mode::Stop);
            return None;
        };
        let (x, warnings) = (&self.observer.x, &mut self.warnings);
        let (reference, mut lost) = if self.mode == Mode::Track {
            let reference = plan.reference(t_plan);
            (reference, self.checks.tracking(x, &reference.x, warnings))
        } else {
            let rod = self.model.rod(&position(x));
            let tilt = rod.cross(&self.rod_at_end).norm().atan2(rod.dot(&self.rod_at_end));
            (plan.end(), self.checks.balance(tilt, warnings))
        };
        let u = reference.u + reference.gain * (x - reference.x);
        if self.mode == Mode::Balance {
            lost = lost.or(self.checks.balance_error(x, &reference.x, warnings));
            let v = self.observer.filtered.fixed_rows::<NU>(0).into();
            lost = lost.or(self.checks.balance_speed(&v, &u, warnings));
        }
        if let Some(trip) = self.checks.pendulum(x, warnings).or(lost) {
            self.give_up(Event::Lost, trip);
            return None;
        }
        Some(Target { x_d: reference.x, u_d: reference.u, u, t_plan })
    }

    /// Hold and Stop: the arm keeps to its reference. `elapsed`: since the last cycle, s.
    fn hold(&mut self, elapsed: f64) -> Target {
        let mut u_d = ActuatedVector::zeros();
        if self.mode == Mode::Stop {
            u_d = self.arm.decelerate(elapsed);
            if self.arm.is_settled(&self.observer.x, self.now) {
                let event = if self.shutting_down { Event::AtRestForGood } else { Event::AtRest };
                if let Ok(to) = transition(self.mode, event) {
                    self.enter(to);
                }
            }
        }
        if is_braked(self.mode) {
            return self.rest();
        }
        let x = &self.observer.x;
        let target = Target { x_d: self.arm.state(x), u_d, u: self.arm.input(x, &u_d), t_plan: 0.0 };
        if let Some(trip) = self.checks.hold(x, &target.x_d, &mut self.warnings) {
            self.give_up(Event::Fault, trip);
            return self.rest();
        }
        target
    }

    /// Idle and Fault: the brakes hold whatever there is.
    fn rest(&self) -> Target {
        let none = ActuatedVector::zeros();
        Target { x_d: self.observer.x, u_d: none, u: none, t_plan: 0.0 }
    }

    /// (24) and the limiter; no torque with closed brakes, and Fault if there is no finite one or one that no drive
    /// should follow.
    fn torque(&mut self, target: Target) -> (Target, law::Torque) {
        if !is_braked(self.mode) {
            let x = &self.observer.x;
            let friction = self.friction.torque(&target.x_d.fixed_rows::<NU>(NQ).into());
            let besides = self.disturbance.estimate() - friction;
            match law::torque(&self.model, x, &target.u, &besides, &self.tau_max, &mut self.work) {
                Some(torque) => {
                    let (torque, rate) = self.begin(torque);
                    match rate {
                        Some(trip) => self.give_up(Event::Fault, trip),
                        None => {
                            self.inertia = self.model.reduced_inertia(&self.work);
                            self.expected = (!torque.limited).then_some(torque.qdd);
                            self.last = torque.tau;
                            self.expect_motion(&target.u, &torque);
                            return (target, torque);
                        }
                    }
                }
                None => self.give_up(Event::Fault, Trip::plain(TripCause::LawNotFinite)),
            }
        }
        let none = ActuatedVector::zeros();
        self.last = none;
        self.expected = None;
        (self.rest(), law::Torque { tau: none, cut: none, limited: false, qdd: JointVector::zeros() })
    }

    /// What the torque of this cycle must do to joints that seem to stand. While a mode begins it is not the one of `u`, and
    /// the brakes may still be on their way.
    fn expect_motion(&mut self, u: &ActuatedVector, torque: &law::Torque) {
        if self.begins > 0 {
            self.standstill.reset();
            return;
        }
        let columns = self.work.unactuated_columns();
        let qd = self.observer.filtered.fixed_rows::<NU>(0).into();
        self.standstill.command(u, torque, self.disturbance.estimate(), (&self.inertia, &columns), &qd);
    }

    /// A mode begins with the torque of the last one (none, where the brakes held) and approaches its own without a step;
    /// from then on a step is a trip.
    fn begin(&mut self, torque: law::Torque) -> (law::Torque, Option<Trip>) {
        if self.begins > 0 {
            let near = torque.near(&self.last, &self.checks.torque_step());
            self.begins = if near.tau == torque.tau { 0 } else { self.begins - 1 };
            return (near, None);
        }
        let rate = self.checks.torque_rate(&self.last, &torque.tau, &mut self.warnings);
        (torque, rate)
    }
}

/// How long a plan has been here at the time `now` (ns), s.
fn age(kept: &Kept, now: u64) -> f64 {
    now.saturating_sub(kept.since) as f64 * 1e-9
}
