//! Checks of the limits in every cycle and at the start of a plan. Each check collects a warning if a value exceeds its
//! warning level, and returns a trip for the first value that exceeds its trip level.

use crate::supervisor::RequestRefusal;
use crate::trip::{Trip, TripCause, Warnings};
use upswing_config::{Config, Level, Levels, StartTolerance};
use upswing_ipc::{Measurement, OtherChain};
use upswing_model::{ActuatedVector, JointKind, JointVector, MOST_JOINTS, Period, State, UnactuatedVector};

/// Speed that an encoder of the pendulum may always report, rad/s or m/s: one that falls may exceed its limit many times.
const PENDULUM_SPEED: f64 = 30.0;
/// Largest speed that an encoder may report, as a multiple of the 100 % speed.
const SPEED_FACTOR: f64 = 2.0;
/// Time until a stop decelerates an accelerating arm, s.
const STOP_DELAY: f64 = 8e-3;
/// Largest position that an encoder may report, rad or m: 16 turns.
const ENCODER_RANGE: f64 = 100.0;

/// Levels of all limits, in SI units, and the warnings of the current cycle.
#[derive(Clone, Debug)]
pub struct Checks {
    warnings: Warnings,
    levels: Levels,
    q_min: JointVector,
    q_max: JointVector,
    /// 100 % speeds.
    qd_max: JointVector,
    tau_max: ActuatedVector,
    /// Largest speeds that the encoders may report.
    encoder_speed: JointVector,
    /// Whether each joint is prismatic.
    prismatic: [bool; MOST_JOINTS],
    start: StartTolerance,
    period: Period,
    /// Time constant T_1 of the velocity filter, s: the lag of the filtered velocities.
    velocity_filter: f64,
}

impl Checks {
    /// Takes the levels from the settings.
    pub fn new(config: &Config) -> Self {
        let (limits, planning) = (&config.robot.limits, &config.robot.planning);
        Self {
            warnings: Warnings::default(),
            levels: config.daemon.limits,
            q_min: planning.q_min,
            q_max: planning.q_max,
            qd_max: limits.qd_max,
            tau_max: limits.tau_max,
            encoder_speed: JointVector::joined(
                &(limits.qd_max.actuated() * SPEED_FACTOR),
                &(limits.qd_max.unactuated() * SPEED_FACTOR)
                    .sup(&UnactuatedVector::repeat(limits.qd_max.sizes(), PENDULUM_SPEED)),
            ),
            prismatic: std::array::from_fn(|i| {
                i < limits.qd_max.len() && config.model.joint_kind(i) == JointKind::Prismatic
            }),
            start: config.daemon.start,
            period: config.daemon.cycle.period,
            velocity_filter: config.daemon.cycle.velocity_filter,
        }
    }

    /// Control period T_s.
    pub fn period(&self) -> Period {
        self.period
    }

    /// Begins a cycle: clears the warnings.
    pub fn begin_cycle(&mut self) {
        self.warnings = Warnings::default();
    }

    /// Adds a warning of this cycle.
    pub fn warn(&mut self, cause: TripCause) {
        self.warnings.insert(cause);
    }

    /// Limits whose warning levels were exceeded in this cycle.
    pub fn warnings(&self) -> Warnings {
        self.warnings
    }

    /// Returns the trip for a measurement of another chain.
    pub fn other_chain(&self, OtherChain { joints, actuated, expected, .. }: &OtherChain) -> Trip {
        // At least one of both numbers differs.
        let (got, expected) = match expected.joints() as u64 {
            n if n == *joints => (*actuated, expected.actuated() as u64),
            n => (*joints, n),
        };
        Trip { cause: TripCause::OtherChain, joint: 0, value: got as f64, limit: expected as f64 }
    }

    /// Checks that a measurement can be used: clock, period, drives, positions, torques `tau`. `not_finite`: the result of
    /// [`Self::finite`] for the same measurement.
    pub fn measurement(
        &mut self,
        measurement: &Measurement,
        tau: &ActuatedVector,
        not_finite: Option<Trip>,
    ) -> Option<Trip> {
        if let Err(unknown) = measurement.clock() {
            let (value, limit) = (unknown.got as f64, unknown.max as f64);
            return Some(Trip { cause: TripCause::UnknownClock, joint: 0, value, limit });
        }
        if measurement.period_ns != self.period.nanos() {
            let (value, limit) = (measurement.period_ns as f64, self.period.nanos() as f64);
            return Some(Trip { cause: TripCause::PeriodMismatch, joint: 0, value, limit });
        }
        if measurement.status & Measurement::DRIVE_FAULT != 0 {
            return Some(Trip::plain(TripCause::DriveFault));
        }
        not_finite.or_else(|| {
            let level = scaled(self.levels.torque_fraction, |i| self.tau_max[i]);
            beyond(TripCause::TorqueLimit, tau, level, &mut self.warnings)
        })
    }

    /// Checks that every measured position is finite and within the range of an encoder.
    pub fn finite(&self, q: &JointVector) -> Option<Trip> {
        let joint = q.iter().position(|q| exceeds(*q, ENCODER_RANGE))?;
        Some(Trip { cause: TripCause::NotFinite, joint, value: q[joint], limit: ENCODER_RANGE })
    }

    /// Checks the age of the newest measurement, cycles.
    pub fn age(&mut self, cycles: u64) -> Option<Trip> {
        count(TripCause::StaleMeasurement, cycles as f64, self.levels.measurement_age, &mut self.warnings)
    }

    /// Returns the trip for a plant without a measurement for `cycles` cycles.
    pub fn lost(&self, cycles: u64) -> Trip {
        let (value, limit) = (cycles as f64, self.levels.measurement_age.trip);
        Trip { cause: TripCause::StaleMeasurement, joint: 0, value, limit }
    }

    /// Checks the number of `cycles` in which the drives have not acted although the brakes were commanded open.
    pub fn drives(&mut self, cycles: u64) -> Option<Trip> {
        count(TripCause::DrivesStopped, cycles as f64, self.levels.drives_stopped, &mut self.warnings)
    }

    /// Checks the number of measurements that were `missed` since the previous one.
    pub fn gap(&mut self, missed: u64) -> Option<Trip> {
        count(TripCause::MeasurementGap, missed as f64, self.levels.measurement_gap, &mut self.warnings)
    }

    /// Checks the number of consecutive overruns.
    pub fn late(&mut self, cycles: u64) -> Option<Trip> {
        count(TripCause::LateCycles, cycles as f64, self.levels.late_cycles, &mut self.warnings)
    }

    /// Checks that the positions can have changed from `last` to `q` in `cycles` cycles.
    pub fn jump(&mut self, last: &JointVector, q: &JointVector, cycles: u64) -> Option<Trip> {
        let elapsed = self.period.seconds_of(cycles);
        let allowed = by_kind(&self.prismatic, self.levels.encoder_jump, self.levels.encoder_jump_m);
        let level = |i: usize| {
            let moved = self.encoder_speed[i] * elapsed;
            let Level { warn, trip } = allowed(i);
            Level { warn: moved + warn, trip: moved + trip }
        };
        beyond(TripCause::EncoderJump, &(q - last), level, &mut self.warnings)
    }

    /// Checks positions `q` and velocities `qd` of the arm. The pendulum is not checked: it may fall.
    pub fn arm(&mut self, q: &JointVector, qd: &JointVector) -> Option<Trip> {
        let actuated = q.sizes().actuated();
        let level = scaled(self.levels.velocity_fraction, |i| self.qd_max[i]);
        let fast = beyond(TripCause::VelocityLimit, &qd[..actuated], level, &mut self.warnings);
        self.range(TripCause::PositionLimit, 0, &q[..actuated]).or(fast)
    }

    /// Checks the positions of the pendulum; to be called while the pendulum is controlled.
    pub fn pendulum(&mut self, x: &State) -> Option<Trip> {
        self.range(TripCause::PendulumRange, x.sizes().actuated(), &x.q_u())
    }

    /// Checks the distance of every position from the reference `x_d`.
    pub fn tracking(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        let level = by_kind(&self.prismatic, self.levels.tracking_error, self.levels.tracking_error_m);
        beyond(TripCause::TrackingError, &(x.q() - x_d.q()), level, &mut self.warnings)
    }

    /// Checks the distance of the arm from the pose of `x_d`, which it holds or moves to.
    pub fn hold(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        self.error_of_arm((self.levels.hold_error, self.levels.hold_error_m), x, x_d)
    }

    /// Checks the distance of the arm from `x_d`, the end of a plan at which it balances.
    pub fn balance_error(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        self.error_of_arm((self.levels.balance_error, self.levels.balance_error_m), x, x_d)
    }

    fn error_of_arm(&mut self, (rad, m): (Level, Level), x: &State, x_d: &State) -> Option<Trip> {
        let level = by_kind(&self.prismatic, rad, m);
        beyond(TripCause::TrackingError, &(x.q_a() - x_d.q_a()), level, &mut self.warnings)
    }

    /// Checks the unexplained `torque` on the arm.
    pub fn unexplained(&mut self, torque: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.collision_torque, |i| self.tau_max[i]);
        beyond(TripCause::Collision, torque, level, &mut self.warnings)
    }

    /// Duration from which an unexplained torque counts as a collision, s.
    pub fn collision_time(&self) -> f64 {
        self.levels.collision_time
    }

    /// Checks the distance |q_U - q_U,N| of the pendulum from `x_d`, the end of a plan at which it balances.
    pub fn balance(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        let distance = (x.q_u() - x_d.q_u()).norm();
        let lost = count(TripCause::BalanceLost, distance, self.levels.balance_distance, &mut self.warnings);
        // The first unactuated joint names the unit.
        lost.map(|trip| Trip { joint: x.sizes().actuated(), ..trip })
    }

    /// Predicts the speeds of the arm from the filtered speeds `v` and the input `u` of the balance controller, and checks them.
    pub fn balance_speed(&mut self, v: &ActuatedVector, u: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.balance_speed, |i| self.qd_max[i]);
        let ahead = self.velocity_filter + STOP_DELAY;
        beyond(TripCause::BalanceSpeed, &(v + *u * ahead), level, &mut self.warnings)
    }

    /// Checks the change of the commanded torque from `last` to `tau` in one cycle.
    pub fn torque_rate(&mut self, last: &ActuatedVector, tau: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.torque_rate, |i| self.tau_max[i]);
        let rate = (tau - last) / self.period.seconds();
        beyond(TripCause::TorqueRate, &rate, level, &mut self.warnings)
    }

    /// Largest change of the commanded torque in one cycle while a mode begins: the warning level of the torque rate.
    pub fn torque_step(&self) -> ActuatedVector {
        self.tau_max * (self.levels.torque_rate.warn * self.period.seconds())
    }

    /// Number of cycles in which changes of at most [`Self::torque_step`] lead from any torque to any other.
    pub fn torque_steps(&self) -> u64 {
        (2.0 / (self.levels.torque_rate.warn * self.period.seconds())).ceil() as u64
    }

    /// Whether the `age` (s) of a loaded plan exceeds the warning level.
    pub fn is_plan_old(&self, age: f64) -> bool {
        exceeds(age, self.levels.plan_age.warn)
    }

    /// Checks the age of a loaded plan at its start, s.
    ///
    /// # Errors
    /// [`RequestRefusal::PlanExpired`] if the plan is too old to be started.
    pub fn plan_age(&mut self, age: f64) -> Result<(), RequestRefusal> {
        let level = self.levels.plan_age;
        match count(TripCause::PlanAge, age, level, &mut self.warnings) {
            Some(_) => Err(RequestRefusal::PlanExpired { age, limit: level.trip }),
            None => Ok(()),
        }
    }

    /// Checks that the state `x` is close enough to the state `x_d` at time `t_plan` (s) of a plan, at which it is to start.
    ///
    /// # Errors
    /// [`RequestRefusal::StartMismatch`] for the first joint that is too far away.
    pub fn start(&self, x: &State, x_d: &State, t_plan: f64) -> Result<(), RequestRefusal> {
        let StartTolerance { position, velocity } = self.start;
        for (velocity, x, x_d, tolerance) in
            [(false, x.q(), x_d.q(), position), (true, x.qd(), x_d.qd(), velocity)]
        {
            if let Some(joint) = (0..x.len()).find(|i| exceeds(x[*i] - x_d[*i], tolerance[*i])) {
                let (measured, expected, tolerance) = (x[joint], x_d[joint], tolerance[joint]);
                return Err(RequestRefusal::StartMismatch {
                    joint,
                    velocity,
                    measured,
                    expected,
                    t_plan,
                    tolerance,
                });
            }
        }
        Ok(())
    }

    /// Checks the positions `q` of the joints with the indices from `begin` on in sorted vectors against the range open to plans.
    fn range(&mut self, cause: TripCause, begin: usize, q: &[f64]) -> Option<Trip> {
        let level = by_kind(&self.prismatic, self.levels.position_margin, self.levels.position_margin_m);
        let mut first = None;
        for (joint, value) in (begin..).zip(q.iter().copied()) {
            let Level { warn, trip } = level(joint);
            let (lowest, highest) = (self.q_min[joint], self.q_max[joint]);
            // The comparison is false for a NaN, which thus exceeds its limit.
            if !(lowest - warn..=highest + warn).contains(&value) {
                self.warnings.insert(cause);
            }
            if first.is_none() && !(lowest - trip..=highest + trip).contains(&value) {
                let limit = if value < lowest { lowest - trip } else { highest + trip };
                first = Some(Trip { cause, joint, value, limit });
            }
        }
        first
    }
}

/// Scales a level, a share, by the `full` value of each joint.
fn scaled(level: Level, full: impl Fn(usize) -> f64) -> impl Fn(usize) -> Level {
    move |i| Level { warn: level.warn * full(i), trip: level.trip * full(i) }
}

/// The level in rad of joints that turn, and the one in m of those that are `prismatic`.
fn by_kind(prismatic: &[bool; MOST_JOINTS], rad: Level, m: Level) -> impl Fn(usize) -> Level + use<'_> {
    move |i| if prismatic[i] { m } else { rad }
}

/// Checks the magnitude of each of `values`, one per joint; returns a trip for the first beyond its trip level.
fn beyond(
    cause: TripCause,
    values: &[f64],
    level: impl Fn(usize) -> Level,
    warnings: &mut Warnings,
) -> Option<Trip> {
    let mut first = None;
    for (joint, value) in values.iter().copied().enumerate() {
        let Level { warn, trip } = level(joint);
        if exceeds(value, warn) {
            warnings.insert(cause);
        }
        if first.is_none() && exceeds(value, trip) {
            first = Some(Trip { cause, joint, value, limit: trip });
        }
    }
    first
}

/// Checks a count or a time that belongs to no joint.
fn count(cause: TripCause, value: f64, level: Level, warnings: &mut Warnings) -> Option<Trip> {
    beyond(cause, &[value], |_| level, warnings)
}

/// Whether the magnitude of a value exceeds its limit; true for NaN.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value.abs() > limit
}

#[cfg(test)]
mod tests;
