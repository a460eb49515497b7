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
use crate::step::{CycleRecord, Output, Request, StepInput};
use crate::supervisor::{Event, Refusal, is_braked, transition};
use crate::trip::{Trip, TripCause};
use nalgebra::Vector3;
use upswing_config::{Config, JointFriction, PlanWhileTracking};
use upswing_ipc::{Clock, Command, Measurement, Mode, Step, Telemetry};
use upswing_model::{
    ActuatedMatrix, ActuatedVector, JointVector, Model, NQ, NU, State, StateParts, Workspace,
};
use upswing_trajectory::Plan;

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
    /// Number of the last step, counts from 1.
    step: u64,

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
            step: 0,
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

    /// Computes one cycle.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    pub fn step(&mut self, input: StepInput) -> Output {
        self.step += 1;
        let recorded = input.to_payload(self.step, 0);
        let StepInput { measurement, now_ns, late_cycles, lost_cycles, restarted, request } = input;
        let measurement = &measurement;
        if restarted {
            let trip = self.observer.restart();
            self.senses = false;
            self.give_up(Event::TripToFault, trip);
        }
        if lost_cycles > 0 {
            let trip = self.checks.lost(lost_cycles);
            self.observer.unfit = Some(trip);
            self.give_up(Event::TripToFault, trip);
        }
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
            let q = self.observer.x.q();
            let tau = measurement.tau_measured.into();
            let frozen = if self.senses { self.standstill.observe_all(&q, &tau, elapsed) } else { None };
            self.standstill.observe(&q, elapsed).or(frozen)
        } else {
            None
        };
        // Without a new measurement it is a cycle on the wall clock only, on the others an order between cycles.
        self.cycle += u64::from(fresh || wall);

        if let Some(trip) = restarted.or(self.observer.unfit).or(stuck).or(collision) {
            self.give_up(Event::TripToFault, trip);
        }
        if let Some(trip) = self.checks.late(late_cycles, &mut self.warnings) {
            self.give_up(Event::TripToStop, trip);
        }
        // The age of a plan matters where it could be started; what is too old is refused there.
        if let Some(kept) = &self.loaded
            && transition(self.mode, Event::Start).is_ok()
            && self.start_time(kept).is_ok()
        {
            let _ = self.checks.plan_age(age(kept, self.now), &mut self.warnings);
        }
        let mut garbage = None;
        let answer = request.map(|request| self.obey(request, &mut garbage));

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
            record: CycleRecord {
                telemetry,
                step: Step { cycle: self.cycle, ..recorded },
                trip: self.trip,
                unready: self.unready(),
                overruns: 0,
            },
            answer,
            retired: [garbage, None],
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
            qd: self.observer.x.qd().into(),
            q_d: target.x_d.q().into(),
            qd_d: target.x_d.qd().into(),
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
        let request = match request {
            Request::Load(plan) => return self.load(plan, garbage),
            request => request,
        };
        if self.shutting_down && request != Request::Shutdown {
            return Err(Refusal::ShuttingDown);
        }
        let to = request.event().map_or(Ok(self.mode), |event| transition(self.mode, event))?;
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
                self.rod_at_end = self.model.rod(&kept.plan.end().x.q());
                self.start = begin;
                self.trip = None;
                // From Balance another plan ran until now.
                *garbage = self.running.take().map(|kept| kept.plan);
                self.running = self.loaded.take();
            }
            Request::Reset => self.trip = None,
            Request::Shutdown => self.shutting_down = true,
            Request::Hold | Request::Stop | Request::Load(_) => {}
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
            let rod = self.model.rod(&x.q());
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
            self.give_up(Event::TripToStop, trip);
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
                let event = if self.shutting_down { Event::AtRestAtShutdown } else { Event::AtRest };
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
            self.give_up(Event::TripToFault, trip);
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
                        Some(trip) => self.give_up(Event::TripToFault, trip),
                        None => {
                            self.inertia = self.model.reduced_inertia(&self.work);
                            self.expected = (!torque.limited).then_some(torque.qdd);
                            self.last = torque.tau;
                            self.expect_motion(&target.u, &torque);
                            return (target, torque);
                        }
                    }
                }
                None => self.give_up(Event::TripToFault, Trip::plain(TripCause::LawNotFinite)),
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
