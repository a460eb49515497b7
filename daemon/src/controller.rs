//! One control cycle: a pure function of measurement, time and its own state. The same code runs on every clock,
//! in the daemon and in-process.
//!
//! Nothing here allocates, frees, locks, logs, panics or enters the kernel. What has to be freed is handed back.

use crate::checks::Checks;
use crate::filter::DifferentialFilter;
use crate::law;
use crate::plan::{Ending, rod};
use crate::supervisor::{Event, Refusal, Request, Trip, TripCause, is_braked, transition};
use nalgebra::Vector3;
use upswing_config::{Config, HoldGains};
use upswing_ipc::{Clock, Command, Measurement, Mode, Telemetry};
use upswing_model::{
    ActuatedVector, JointVector, Model, NQ, NU, State, Workspace, position, state, velocity,
};
use upswing_trajectory::Plan;

/// Speed below which a joint counts as at rest, rad/s, and how long it has to stay there, ns.
const REST_SPEED: f64 = 0.01;
const REST_TIME_NS: u64 = 50_000_000;

/// What the controller is told besides the measurement; at most one per cycle.
#[derive(Debug)]
pub enum Order {
    /// Change the mode.
    Do(Request),
    /// Keep a checked plan for the next start.
    Load(Box<Plan>),
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
    /// Why the last mode was given up; kept until the next enable, start or reset.
    pub trip: Option<Trip>,
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

/// A pose of the arm to hold, or on its way to rest.
#[derive(Clone, Copy, Debug)]
struct ArmReference {
    q: ActuatedVector,
    qd: ActuatedVector,
}

/// Filter, supervisor and control law.
#[derive(Clone, Debug)]
pub struct Controller {
    model: Model,
    work: Workspace,
    checks: Checks,
    gains: HoldGains,
    deceleration: [f64; NU],
    tau_max: ActuatedVector,
    max_age: u32,

    mode: Mode,
    shutting_down: bool,
    /// Why the last mode was given up.
    trip: Option<Trip>,
    cycle: u64,

    filter: DifferentialFilter,
    /// x = [q, qd], measured and filtered.
    x: State,
    /// `seq` of the newest measurement, and of the newest that entered the filter.
    seq: u64,
    filtered_seq: u64,
    /// Code of the plant's clock.
    clock: u64,
    /// Cycles without a new measurement.
    age: u32,
    drives_ready: bool,
    /// What speaks against using the newest measurement.
    unfit: Option<Trip>,

    /// Time of this cycle and, while a plan runs, of its start, ns.
    now: u64,
    start: u64,
    loaded: Option<Box<Plan>>,
    running: Option<Box<Plan>>,
    /// The rod at x_N, m.
    rod_at_end: Vector3<f64>,
    arm: ArmReference,
    /// Since when the arm has been at rest, ns.
    rest_since: Option<u64>,
}

impl Controller {
    /// A controller in mode Idle that has measured nothing yet.
    pub fn new(config: &Config) -> Self {
        let cycle = &config.daemon.cycle;
        Self {
            model: config.model.clone(),
            work: Workspace::default(),
            checks: Checks::new(config),
            gains: config.daemon.hold,
            deceleration: config.daemon.stop_deceleration,
            tau_max: config.robot.limits.tau_max,
            max_age: config.daemon.trip.measurement_max_age,
            mode: Mode::Idle,
            shutting_down: false,
            trip: None,
            cycle: 0,
            filter: DifferentialFilter::new(cycle.period.as_secs_f64(), cycle.velocity_filter),
            x: State::zeros(),
            seq: 0,
            filtered_seq: 0,
            clock: 0,
            age: 0,
            drives_ready: false,
            unfit: Some(Trip::plain(TripCause::NoMeasurement)),
            now: 0,
            start: 0,
            loaded: None,
            running: None,
            rod_at_end: Vector3::zeros(),
            arm: ArmReference { q: ActuatedVector::zeros(), qd: ActuatedVector::zeros() },
            rest_since: None,
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

    /// The state x = [q, qd] of the last cycle: measured angles (rad) and filtered velocities (rad/s).
    pub fn state(&self) -> &State {
        &self.x
    }

    /// Whether the brakes hold.
    pub fn is_safe_to_exit(&self) -> bool {
        is_braked(self.mode)
    }

    /// To be called when measurements do not come any more, which on the paced clock only the caller can tell.
    pub fn lose_measurement(&mut self, cycles: u32) {
        let (value, limit) = (f64::from(cycles), f64::from(self.max_age));
        self.distrust(Trip { cause: TripCause::StaleMeasurement, joint: 0, value, limit });
    }

    /// To be called before the first measurement of another plant, or of the same after a restart.
    pub fn restart_measurement(&mut self) {
        self.filter.reset();
        (self.seq, self.filtered_seq, self.age) = (0, 0, 0);
        self.distrust(Trip::plain(TripCause::MeasurementRestarted));
    }

    /// One cycle. `measurement` is the newest one, whether or not it is new; `now_ns` is the planned time of the
    /// cycle on the wall clock, and ignored on the others: they advance one period per measurement.
    pub fn step(&mut self, measurement: &Measurement, now_ns: u64, order: Option<Order>) -> Output {
        let wall = measurement.clock() == Ok(Clock::Wall);
        let now = if wall { now_ns } else { measurement.seq.saturating_mul(measurement.period_ns) };
        let elapsed = now.saturating_sub(self.now) as f64 * 1e-9;
        self.now = now;
        let fresh = self.observe(measurement, wall);
        // Without a new measurement it is a cycle on the wall clock only, on the others an order between cycles.
        self.cycle += u64::from(fresh || wall);

        if let Some(trip) = self.unfit {
            self.give_up(Event::Fault, trip);
        }
        let mut garbage = None;
        let answer = order.map(|order| match order {
            Order::Do(request) => self.obey(request, &mut garbage),
            Order::Load(plan) if is_complete(&plan) => {
                garbage = self.loaded.replace(plan);
                Ok(())
            }
            Order::Load(plan) => {
                garbage = Some(plan);
                Err(Refusal::IncompletePlan)
            }
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
                garbage = self.running.take();
            }
        }

        let brake = u64::from(is_braked(self.mode));
        let t_ns = if wall { now_ns } else { measurement.t_ns };
        let tau = torque.tau.into();
        let fault = self.trip.filter(|_| self.mode == Mode::Fault).map_or(0, |trip| trip.cause.code());
        let flag = |set: bool, bit: u64| if set { bit } else { 0 };
        let telemetry = Telemetry {
            seq: self.cycle,
            t_ns,
            measurement_seq: measurement.seq,
            mode: self.mode.code(),
            fault,
            plan_id: self.running.as_ref().map_or(0, |plan| plan.id),
            flags: flag(!fresh, Telemetry::STALE)
                | flag(torque.limited, Telemetry::LIMITED)
                | flag(brake == 1, Telemetry::BRAKE),
            t_plan: target.t_plan,
            q: measurement.q,
            qd: velocity(&self.x).into(),
            q_d: position(&target.x_d).into(),
            qd_d: velocity(&target.x_d).into(),
            u_d: target.u_d.into(),
            u: target.u.into(),
            tau,
            tau_measured: measurement.tau_measured,
            ..Telemetry::default()
        };
        Output {
            command: Command { seq: self.cycle, t_ns, measurement_seq: measurement.seq, tau, brake },
            record: Record { telemetry, trip: self.trip, overruns: 0 },
            answer,
            garbage,
        }
    }

    /// Takes in a measurement; whether it was new.
    fn observe(&mut self, measurement: &Measurement, wall: bool) -> bool {
        if measurement.seq == self.seq {
            self.age = self.age.saturating_add(1);
            if wall && self.seq > 0 && self.age > self.max_age {
                self.lose_measurement(self.age);
            }
            return false;
        }
        if measurement.seq < self.seq || (self.seq > 0 && measurement.clock != self.clock) {
            self.restart_measurement();
        }
        if measurement.seq == 0 {
            return false;
        }
        (self.seq, self.clock, self.age) = (measurement.seq, measurement.clock, 0);
        self.drives_ready = measurement.status & Measurement::DRIVES_READY != 0;
        self.unfit = self.checks.measurement(measurement);
        if self.checks.finite(measurement).is_some() {
            return true;
        }
        let q = JointVector::from(measurement.q);
        let cycles = self.seq - self.filtered_seq;
        if let Some(trip) = self.filter.last().and_then(|last| self.checks.jump(last, &q, cycles)) {
            self.filter.reset();
            // With closed brakes it is no fault: somebody may have moved the robot by other means.
            if !is_braked(self.mode) {
                self.unfit = self.unfit.or(Some(trip));
            }
        }
        self.x = state(&q, &self.filter.update(&q, cycles));
        self.filtered_seq = self.seq;
        self.unfit = self.unfit.or_else(|| self.checks.arm(&self.x));
        true
    }

    fn distrust(&mut self, trip: Trip) {
        self.unfit = Some(trip);
        self.give_up(Event::Fault, trip);
    }

    /// Leaves the mode because of `trip`, where the table says so; from Fault it does not, so the first cause stays.
    fn give_up(&mut self, event: Event, trip: Trip) {
        if let Ok(to) = transition(self.mode, event) {
            self.trip = Some(trip);
            self.enter(to);
        }
    }

    fn obey(&mut self, request: Request, garbage: &mut Option<Box<Plan>>) -> Result<(), Refusal> {
        if self.shutting_down && request != Request::Shutdown {
            return Err(Refusal::ShuttingDown);
        }
        let to = transition(self.mode, Event::Asked(request))?;
        match request {
            Request::Enable => {
                if let Some(trip) = self.unfit {
                    return Err(Refusal::Unfit(trip));
                }
                if !self.drives_ready {
                    return Err(Refusal::DrivesNotReady);
                }
                self.trip = None;
            }
            Request::Start => {
                let plan = self.loaded.as_ref().ok_or(Refusal::NoPlan)?;
                let (first, last) = (plan.trajectory.x.first(), plan.trajectory.x.last());
                let (Some(x_0), Some(x_n)) = (first, last) else { return Err(Refusal::NoPlan) };
                self.checks.start(&self.x, x_0)?;
                self.rod_at_end = rod(&self.model, x_n);
                self.start = self.now;
                self.trip = None;
                // From Balance another plan ran until now.
                *garbage = self.running.take();
                self.running = self.loaded.take();
            }
            Request::Reset => self.trip = None,
            Request::Shutdown => self.shutting_down = true,
            Request::Hold | Request::Stop => {}
        }
        self.enter(to);
        Ok(())
    }

    fn enter(&mut self, to: Mode) {
        let q: ActuatedVector = self.x.fixed_rows::<NU>(0).into();
        match (self.mode, to) {
            // The pose is there already.
            (Mode::Stop, Mode::Hold | Mode::Stop) => {}
            (Mode::Track, Mode::Hold) => {
                let end = self.running.as_ref().map_or(q, |plan| plan.end().x.fixed_rows::<NU>(0).into());
                self.arm = ArmReference { q: end, qd: ActuatedVector::zeros() };
            }
            (_, Mode::Hold) => self.arm = ArmReference { q, qd: ActuatedVector::zeros() },
            (_, Mode::Stop) => {
                self.arm = ArmReference { q, qd: self.x.fixed_rows::<NU>(NQ).into() };
                self.rest_since = None;
            }
            _ => {}
        }
        self.mode = to;
    }

    /// Track and Balance: u = u_d + K (x - x_d). `None` if the plan ended in Hold or had to be given up.
    fn follow(&mut self) -> Option<Target> {
        let t_plan = self.now.saturating_sub(self.start) as f64 * 1e-9;
        if self.running.as_ref().is_some_and(|plan| t_plan >= plan.trajectory.t_f)
            && let Ok(to) = transition(self.mode, Event::PlanEnded(Ending::of(&self.rod_at_end)))
        {
            self.enter(to);
            if to == Mode::Hold {
                return None;
            }
        }
        let Some(plan) = self.running.as_deref() else {
            // Not reached: a start fills it, and only a start enters Track.
            self.enter(Mode::Stop);
            return None;
        };
        let (reference, lost) = if self.mode == Mode::Track {
            let reference = plan.reference(t_plan);
            (reference, self.checks.tracking(&self.x, &reference.x))
        } else {
            let rod = rod(&self.model, &self.x);
            let tilt = rod.cross(&self.rod_at_end).norm().atan2(rod.dot(&self.rod_at_end));
            (plan.end(), self.checks.balance(tilt))
        };
        if let Some(trip) = self.checks.pendulum(&self.x).or(lost) {
            self.give_up(Event::Lost, trip);
            return None;
        }
        let u = reference.u + reference.gain * (self.x - reference.x);
        Some(Target { x_d: reference.x, u_d: reference.u, u, t_plan })
    }

    /// Hold and Stop: u = u_d + stiffness (q_d - q) + damping (qd_d - qd). In Stop the reference decelerates as set
    /// from the pose and velocity in which it began; in Hold it stands still. `elapsed`: since the last cycle, s.
    fn hold(&mut self, elapsed: f64) -> Target {
        let mut u_d = ActuatedVector::zeros();
        if self.mode == Mode::Stop {
            for i in 0..NU {
                let (v, a) = (self.arm.qd[i], self.deceleration[i]);
                let braking = elapsed.min(v.abs() / a);
                self.arm.qd[i] = if braking < elapsed { 0.0 } else { v - v.signum() * a * braking };
                self.arm.q[i] += 0.5 * (v + self.arm.qd[i]) * braking;
                if self.arm.qd[i] != 0.0 {
                    u_d[i] = -v.signum() * a;
                }
            }
            self.settle();
        }
        // The pendulum has no reference: it is where it is.
        let mut x_d = self.x;
        x_d.fixed_rows_mut::<NU>(0).copy_from(&self.arm.q);
        x_d.fixed_rows_mut::<NU>(NQ).copy_from(&self.arm.qd);
        let u = ActuatedVector::from_fn(|i, _| {
            u_d[i]
                + self.gains.stiffness[i] * (self.arm.q[i] - self.x[i])
                + self.gains.damping[i] * (self.arm.qd[i] - self.x[NQ + i])
        });
        if is_braked(self.mode) { self.rest() } else { Target { x_d, u_d, u, t_plan: 0.0 } }
    }

    /// Leaves Stop once the arm has been at rest for a while.
    fn settle(&mut self) {
        let speed = self.x.fixed_rows::<NU>(NQ).amax();
        if !(self.arm.qd.amax() == 0.0 && speed < REST_SPEED) {
            self.rest_since = None;
            return;
        }
        let since = *self.rest_since.get_or_insert(self.now);
        if self.now.saturating_sub(since) >= REST_TIME_NS {
            let event = if self.shutting_down { Event::AtRestForGood } else { Event::AtRest };
            if let Ok(to) = transition(self.mode, event) {
                self.enter(to);
            }
        }
    }

    /// Idle and Fault: the brakes hold whatever there is.
    fn rest(&self) -> Target {
        Target { x_d: self.x, u_d: ActuatedVector::zeros(), u: ActuatedVector::zeros(), t_plan: 0.0 }
    }

    /// (24) and the limiter; no torque with closed brakes, and Fault if there is no finite one.
    fn torque(&mut self, target: Target) -> (Target, law::Torque) {
        let none = law::Torque { tau: ActuatedVector::zeros(), limited: false };
        if is_braked(self.mode) {
            return (target, none);
        }
        match law::torque(&self.model, &self.x, &target.u, &self.tau_max, &mut self.work) {
            Some(torque) => (target, torque),
            None => {
                self.give_up(Event::Fault, Trip::plain(TripCause::LawNotFinite));
                (self.rest(), none)
            }
        }
    }
}

/// Whether the plan has what its reference at any time is made of.
fn is_complete(plan: &Plan) -> bool {
    let knots = plan.trajectory.x.len();
    knots > 1 && [plan.trajectory.u.len(), plan.f.len(), plan.gains.len()].iter().all(|len| *len == knots)
}
