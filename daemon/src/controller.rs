//! Controller: one control cycle as a pure function of its input and its own state. The same code runs on every clock, in the
//! daemon, in replays and in simulations in one process.
//!
//! ```text
//! encoders -> velocity estimate -> x -> supervisor (limits, requests, mode) -> setpoint (x_d, u_d, u)
//!          -> torque law (24) -> limiter -> command
//! ```
//!
//! `mode_changes.rs` holds the supervisor. Nothing here allocates, frees, locks, logs, panics or enters the kernel. Plans to be freed are returned to the caller.

mod mode_changes;

use crate::arm::ArmReference;
use crate::checks::Checks;
use crate::disturbance::{CommandedMotion, DisturbanceEstimate};
use crate::law::{self, JointSpaceInertia, Torque};
use crate::modes::{ActiveMode, LoadedPlan, Setpoint};
use crate::observer::{Observation, Observer};
use crate::standstill::Standstill;
use crate::step::{CycleRecord, DroppedPlan, MOST_RETIRED, StepInput, StepOutput};
use crate::supervisor::ModeEvent;
use crate::trip::{Trip, TripCause};
use upswing_config::{Config, HoldGains, PlanWhileTracking};
use upswing_ipc::{Clock, Command, CycleVectors, Measurement, Mode, Telemetry};
use upswing_model::{
    ActuatedVector, JointFriction, JointVector, Linearization, Model, Posture, Sizes, State, Workspace,
};
use upswing_trajectory::Plan;

/// Command of the last cycle; zero while the brakes were closed.
#[derive(Clone, Debug)]
struct LastCommand {
    /// Torques.
    tau: ActuatedVector,
    /// qdd for which the command was computed; `None` if the limiter cut it.
    qdd: Option<JointVector>,
}

impl LastCommand {
    fn none(sizes: Sizes) -> Self {
        Self { tau: ActuatedVector::zeros(sizes), qdd: None }
    }
}

/// Controller of the robot: observer, supervisor and control law.
#[derive(Clone, Debug)]
pub struct Controller {
    model: Model,
    work: Workspace,
    derivatives: Linearization,
    tau_max: ActuatedVector,
    friction: JointFriction,
    hold: HoldGains,
    stop_deceleration: ActuatedVector,
    while_tracking: PlanWhileTracking,

    /// Numbers of the last step and of the last cycle; both count from 1.
    step: u64,
    cycle: u64,
    /// Time of the last step on the plant's clock, ns.
    now_ns: u64,
    last: LastCommand,
    /// Inertia in the state for which the last torque was computed.
    inertia: JointSpaceInertia,

    observer: Observer,
    disturbance: DisturbanceEstimate,
    standstill: Standstill,
    checks: Checks,
    /// Time for which the unexplained torque on the arm has been large enough for a collision, s.
    pressed: f64,
    /// Whether the plant measures the load behind closed brakes.
    load_sensed: bool,

    mode: ActiveMode,
    /// Trip that led to the last Fault or Stop; kept until the next enable, start or reset.
    trip: Option<Trip>,
    shutting_down: bool,
    /// By how much the estimated velocities lag, s: T_1 of the differential filter, 0 where its lag is compensated.
    velocity_lag: f64,
    /// Largest number of cycles for which the torque may still approach that of the mode.
    blend_cycles: u64,
    loaded: Option<LoadedPlan>,
    /// A plan that waits for the moment at which it replaces the running one.
    replacement: Option<Box<Plan>>,
    dropped: Option<DroppedPlan>,
    /// Plans that this step no longer needs, to be freed by the caller.
    retired: [Option<Box<Plan>>; MOST_RETIRED],
}

impl Controller {
    /// Creates a controller in mode Idle without a measurement.
    pub fn new(config: &Config) -> Self {
        let (robot, daemon) = (&config.robot, &config.daemon);
        let (sizes, tau_max) = (config.model.sizes(), robot.limits.tau_max);
        Self {
            model: config.model.clone(),
            work: Workspace::default(),
            derivatives: Linearization::new(sizes),
            tau_max,
            friction: robot.friction,
            hold: daemon.hold,
            stop_deceleration: daemon.stop.deceleration,
            while_tracking: daemon.plans.while_tracking,
            step: 0,
            cycle: 0,
            now_ns: 0,
            last: LastCommand::none(sizes),
            inertia: JointSpaceInertia::zeros(sizes),
            observer: Observer::new(&daemon.cycle, &config.model),
            disturbance: DisturbanceEstimate::new(
                &daemon.disturbance,
                tau_max * daemon.disturbance.most,
                daemon.cycle.velocity_filter,
            ),
            standstill: Standstill::new(&daemon.standstill, &robot.planning.q_max, &tau_max),
            checks: Checks::new(config),
            pressed: 0.0,
            load_sensed: false,
            mode: ActiveMode::Idle,
            trip: None,
            shutting_down: false,
            velocity_lag: config.plan_criteria().delays.velocity_filter.unwrap_or(0.0),
            blend_cycles: 0,
            loaded: None,
            replacement: None,
            dropped: None,
            retired: [const { None }; MOST_RETIRED],
        }
    }

    /// Mode after the last cycle.
    pub fn mode(&self) -> Mode {
        self.mode.mode()
    }

    /// Trip that led to the last Fault or Stop; kept until the next enable, start or reset.
    pub fn trip(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    /// State x = [q, qd] of the last cycle: measured positions and estimated velocities.
    pub fn state(&self) -> &State {
        &self.observer.x
    }

    /// Computes one cycle.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    pub fn step(&mut self, input: StepInput) -> StepOutput {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has AVX2.
            return unsafe { self.step_avx2(input) };
        }
        self.step_baseline(input)
    }

    /// [`Self::step`] with registers of 256 bits, which shortens the many sums and copies of vectors. The functions of the daemon that do
    /// most of them are inlined always, so that they are compiled for these registers, too.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn step_avx2(&mut self, input: StepInput) -> StepOutput {
        self.step_baseline(input)
    }

    /// [`Self::step`] with the registers that every CPU has, and the same bits: nothing is contracted to fused operations.
    #[inline(always)]
    pub fn step_baseline(&mut self, input: StepInput) -> StepOutput {
        self.step += 1;
        let mut recorded = input.to_payload(self.step, 0);
        let StepInput { measurement, now_ns, late_cycles, lost_cycles, restarted, request } = input;
        self.checks.begin_cycle();
        self.lose_plant(restarted, lost_cycles);
        // No time passes before the plant states its clock: the time of a paced clock will begin at 0.
        let wall = measurement.shown_clock().is_some_and(Clock::is_real_time);
        let plant_ns = if wall { now_ns } else { measurement.seq.saturating_mul(measurement.period_ns) };
        let elapsed = plant_ns.saturating_sub(self.now_ns) as f64 * 1e-9;
        self.now_ns = plant_ns;

        let is_new = self.observe(&measurement, now_ns, elapsed);
        // A step without a new measurement is a cycle on the wall clock only; on other clocks it answers a request between cycles.
        self.cycle += u64::from(is_new || wall);
        recorded.cycle = self.cycle;
        if let Some(trip) = self.checks.late(late_cycles) {
            self.trip_to_stop(trip);
        }
        self.warn_of_plan_age();
        let answer = request.map(|request| self.obey(request));
        self.dropped = None;
        self.replace_plan();

        // Written in place: a setpoint is half a kilobyte.
        let mut setpoint = self.no_motion();
        if !self.follow_plan(&mut setpoint) {
            self.keep_arm(elapsed, &mut setpoint);
        }
        let torque = self.torque(&setpoint).unwrap_or_else(|trip| {
            self.trip_to_fault(trip);
            setpoint = self.no_motion();
            Torque::none(self.model.sizes())
        });
        if self.mode.is_braked() {
            self.last = LastCommand::none(self.model.sizes());
        }

        let t_ns = if wall { now_ns } else { measurement.t_ns };
        StepOutput {
            command: Command {
                seq: self.cycle,
                t_ns,
                measurement_seq: measurement.seq,
                brake: self.mode.is_braked().into(),
                ..Command::new(&torque.tau)
            },
            record: CycleRecord {
                telemetry: self.telemetry(&measurement, t_ns, is_new, &setpoint, &torque),
                step: recorded,
                trip: self.trip,
                dropped: self.dropped,
                unready: self.unready(),
                overruns: 0,
            },
            answer,
            retired: std::mem::take(&mut self.retired),
        }
    }

    // From encoders to x, and to the trips that follow from a measurement.

    /// Trips to Fault if the plant has `restarted` or no measurement has come for `lost_cycles` cycles.
    fn lose_plant(&mut self, restarted: bool, lost_cycles: u64) {
        if restarted {
            let trip = self.observer.restart();
            self.load_sensed = false;
            self.trip_to_fault(trip);
        }
        if lost_cycles > 0 {
            let trip = self.checks.lost(lost_cycles);
            self.observer.unfit = Some(trip);
            self.trip_to_fault(trip);
        }
    }

    /// Takes the measurement, `elapsed` s after the last step, and trips to Fault if the measurement, the drives or the motion of
    /// the arm cannot be trusted. Returns whether the measurement is new.
    #[inline(always)]
    fn observe(&mut self, measurement: &Measurement, now_ns: u64, elapsed: f64) -> bool {
        let first = self.observer.is_new();
        let braked = self.mode.is_braked();
        let Observation { is_new, restarted } =
            self.observer.observe(measurement, now_ns, &mut self.checks, self.last.qdd.as_ref(), braked);
        if matches!(self.mode, ActiveMode::Idle | ActiveMode::Hold(_)) {
            self.observer.drop_turns();
        }
        if restarted.is_some() {
            self.load_sensed = false;
        }
        let collision = if braked {
            self.weigh_load(measurement, is_new);
            None
        } else {
            self.collision(elapsed)
        };
        let stuck = self.stuck_encoder(is_new, braked);
        if let Some(trip) = restarted.or(self.observer.unfit).or(stuck).or(collision) {
            self.trip_to_fault(trip);
        }
        // Another plant has another time: from here, the age of a plan counts on its clock.
        if is_new
            && (first || restarted.is_some())
            && let Some(loaded) = &mut self.loaded
        {
            loaded.since_ns = self.now_ns;
        }
        is_new
    }

    /// Closed brakes: if the plant measures the load that they hold, its part that gravity does not explain becomes the
    /// disturbance estimate with which Hold begins.
    #[inline(always)]
    fn weigh_load(&mut self, measurement: &Measurement, is_new: bool) {
        const HELD: u64 = Measurement::BRAKES_CLOSED | Measurement::LOAD_SENSED;
        self.pressed = 0.0;
        self.load_sensed |= measurement.status & Measurement::LOAD_SENSED != 0;
        if measurement.status & HELD != HELD || self.observer.unfit.is_some() {
            self.disturbance.reset();
        } else if is_new {
            // The arm is at rest, so that the noise of its velocities is left out; the pendulum may swing.
            let mut x = self.observer.x;
            x.qd_a_mut().fill(0.0);
            let explained = self.model.torque(&x, &ActuatedVector::zeros(x.sizes()), &mut self.work);
            let elapsed = self.checks.period().seconds_of(self.observer.cycles());
            self.disturbance.weigh(&(explained - self.observer.tau), elapsed);
        }
    }

    /// Open brakes: updates the disturbance estimate, `elapsed` s after the last step. Returns the trip for a large unexplained torque
    /// that has lasted too long.
    #[inline(always)]
    fn collision(&mut self, elapsed: f64) -> Option<Trip> {
        let v = self.observer.filtered.actuated();
        let reduced_inertia = &self.inertia.reduced;
        let motion = self.last.qdd.as_ref().map(|qdd| CommandedMotion { qdd, reduced_inertia });
        self.disturbance.update(&v, motion, elapsed);
        let unexplained = self.checks.unexplained(self.disturbance.unexplained());
        // Drives that do not act leave the whole command unexplained; a limit of their own covers them.
        let pressed = unexplained.is_some() && self.observer.drives_act();
        self.pressed = if pressed { self.pressed + elapsed } else { 0.0 };
        unexplained.filter(|_| self.pressed >= self.checks.collision_time())
    }

    /// Returns the trip for a position, or a whole measurement, that does not change although the command must have changed it.
    #[inline(always)]
    fn stuck_encoder(&mut self, is_new: bool, braked: bool) -> Option<Trip> {
        if self.checks.warnings().contains(TripCause::EncoderJump) {
            self.standstill.jumped();
        }
        // Joints that the brakes hold do not move.
        if braked || !self.observer.drives_act() {
            self.standstill.reset();
            return None;
        }
        if !is_new {
            return None;
        }
        let elapsed = self.checks.period().seconds_of(self.observer.cycles());
        let q = self.observer.x.q();
        let tau = &self.observer.tau;
        let frozen = if self.load_sensed { self.standstill.observe_all(&q, tau, elapsed) } else { None };
        self.standstill.observe(&q, elapsed).or(frozen)
    }

    // Setpoint of the mode.

    /// Track and Balance: u = u_d + K (x - x_d). Returns whether there is a setpoint: none in other modes, and if the plan ends in Hold
    /// or trips to Stop.
    #[inline(always)]
    fn follow_plan(&mut self, setpoint: &mut Setpoint) -> bool {
        self.finish_plan();
        let (observer, checks) = (&self.observer, &mut self.checks);
        let followed = match &self.mode {
            ActiveMode::Track(plan) => plan.track(self.now_ns, &observer.x, checks, setpoint),
            ActiveMode::Balance(plan) => plan.balance(self.now_ns, observer, checks, setpoint),
            _ => return false,
        };
        followed.map_err(|trip| self.trip_to_stop(trip)).is_ok()
    }

    /// Track, once t >= t_F: a plan that ends upright leads to Balance, one that ends hanging to Hold.
    fn finish_plan(&mut self) {
        let ActiveMode::Track(plan) = &self.mode else { return };
        match plan.ending(self.now_ns) {
            Some(Posture::Hanging) => {
                let hold = ActiveMode::Hold(ArmReference::at_rest(&plan.end().x));
                self.enter(ModeEvent::PlanEnded(Posture::Hanging), hold);
            }
            Some(Posture::Standing) => {
                self.mode.balance();
                self.blend_cycles = self.checks.torque_steps();
            }
            None => {}
        }
    }

    /// Hold and Stop: the arm follows its reference, `elapsed` s after the last step. No setpoint in other modes, and when the arm is at
    /// rest for a shutdown or trips to Fault.
    #[inline(always)]
    fn keep_arm(&mut self, elapsed: f64, setpoint: &mut Setpoint) {
        let x = self.observer.x;
        let mut u_d = ActuatedVector::zeros(x.sizes());
        if let ActiveMode::Stop(reference) = &mut self.mode {
            u_d = reference.decelerate(&self.stop_deceleration, elapsed);
            if reference.is_settled(&x, self.now_ns) {
                let (event, next) = if self.shutting_down {
                    (ModeEvent::AtRestAtShutdown, ActiveMode::Idle)
                } else {
                    (ModeEvent::AtRest, ActiveMode::Hold(*reference))
                };
                self.enter(event, next);
            }
        }
        let (ActiveMode::Hold(reference) | ActiveMode::Stop(reference)) = &self.mode else { return };
        let x_d = reference.state(&x);
        let u = reference.input(&self.hold, &x, &u_d);
        match self.checks.hold(&x, &x_d) {
            Some(trip) => self.trip_to_fault(trip),
            None => *setpoint = Setpoint { x_d, u_d, u, t_plan: 0.0 },
        }
    }

    /// Idle and Fault: the brakes hold the arm in place.
    #[inline(always)]
    fn no_motion(&self) -> Setpoint {
        let none = ActuatedVector::zeros(self.model.sizes());
        Setpoint { x_d: self.observer.x, u_d: none, u: none, t_plan: 0.0 }
    }

    // From the setpoint to the command.

    /// Torque law (24) and limiter; no torque with closed brakes.
    ///
    /// # Errors
    /// The [`Trip`] for a torque that is not finite, or that changes too fast.
    #[inline(always)]
    fn torque(&mut self, setpoint: &Setpoint) -> Result<Torque, Trip> {
        if self.mode.is_braked() {
            return Ok(Torque::none(self.model.sizes()));
        }
        let friction = self.friction.torque(&setpoint.x_d.qd_a());
        let besides = self.disturbance.estimate() - friction;
        let (x, u) = (&self.observer.x, &setpoint.u);
        let law = law::torque(&self.model, x, u, &besides, &self.tau_max, &mut self.work, &mut self.inertia);
        let mut torque = law.ok_or(Trip::plain(TripCause::LawNotFinite))?;
        self.blend(&mut torque)?;
        self.last = LastCommand { tau: torque.tau, qdd: (!torque.limited).then_some(torque.qdd) };
        if self.blend_cycles > 0 {
            // The torque does not belong to u yet, and the brakes may still be opening.
            self.standstill.reset();
        } else {
            let qd = self.observer.filtered.actuated();
            self.standstill.command(u, &torque, self.disturbance.estimate(), &self.inertia, &qd);
        }
        Ok(torque)
    }

    /// Blends the torque at the begin of a mode, from the last torque (none after closed brakes) to that of the mode without a
    /// step; from then on a step is a trip.
    #[inline(always)]
    fn blend(&mut self, torque: &mut Torque) -> Result<(), Trip> {
        if self.blend_cycles > 0 {
            let near = torque.near(&self.last.tau, &self.checks.torque_step());
            self.blend_cycles = if near.tau == torque.tau { 0 } else { self.blend_cycles - 1 };
            *torque = near;
            return Ok(());
        }
        self.checks.torque_rate(&self.last.tau, &torque.tau).map_or(Ok(()), Err)
    }

    /// Assembles the telemetry of this cycle.
    #[inline(always)]
    fn telemetry(
        &self,
        measurement: &Measurement,
        t_ns: u64,
        is_new: bool,
        setpoint: &Setpoint,
        torque: &Torque,
    ) -> Telemetry {
        let fault = self.trip.filter(|_| self.mode() == Mode::Fault).map_or(0, |trip| trip.cause.code());
        let flag = |set: bool, bit: u64| if set { bit } else { 0 };
        let vectors = CycleVectors {
            x: State::new(&self.observer.position(), &self.observer.x.qd()),
            x_d: setpoint.x_d,
            u_d: setpoint.u_d,
            u: setpoint.u,
            tau: torque.tau,
            tau_measured: self.observer.tau,
        };
        let mut telemetry = Telemetry::new(self.model.order(), &vectors);
        telemetry.seq = self.cycle;
        telemetry.t_ns = t_ns;
        telemetry.measurement_seq = measurement.seq;
        telemetry.mode = self.mode().code();
        telemetry.fault = fault;
        telemetry.warnings = self.checks.warnings().bits();
        telemetry.plan_id = self.mode.plan_id();
        telemetry.flags = flag(!is_new, Telemetry::STALE)
            | flag(torque.limited, Telemetry::LIMITED)
            | flag(self.mode.is_braked(), Telemetry::BRAKE);
        telemetry.t_plan = setpoint.t_plan;
        telemetry.clock = measurement.clock;
        telemetry
    }
}
