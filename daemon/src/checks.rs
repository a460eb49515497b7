//! Checks of the limits in every cycle and at the start of a plan. Each check collects a warning if a value exceeds its
//! warning level, and returns a trip for the first value that exceeds its trip level.

use crate::supervisor::RequestRefusal;
use crate::trip::{Trip, TripCause, Warnings};
use std::ops::Range;
use upswing_config::{Config, Level, Levels, StartTolerance};
use upswing_ipc::Measurement;
use upswing_model::{ActuatedVector, JointVector, NQ, NU, NX, Period, State, StateParts};

/// Indices of the arm's joints, q_A.
const ARM: Range<usize> = 0..NU;
const PENDULUM: Range<usize> = NU..NQ;

/// Largest speed that an encoder of the pendulum may report, rad/s; no pendulum reaches it.
const PENDULUM_SPEED: f64 = 30.0;
/// Largest speed that an encoder of the arm may report, as a multiple of the 100 % speed.
const SPEED_FACTOR: f64 = 2.0;
/// Time until a stop decelerates an accelerating arm, s.
const STOP_DELAY: f64 = 8e-3;
/// Largest angle that an encoder may report, rad: 16 turns.
const ENCODER_RANGE: f64 = 100.0;

/// Levels of all limits, in SI units, and the warnings of the current cycle.
#[derive(Clone, Debug)]
pub struct Checks {
    warnings: Warnings,
    levels: Levels,
    q_min: JointVector,
    q_max: JointVector,
    /// 100 % speeds, rad/s.
    qd_max: JointVector,
    tau_max: ActuatedVector,
    /// Largest speeds that the encoders may report, rad/s.
    encoder_speed: JointVector,
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
            encoder_speed: JointVector::from_fn(|i, _| {
                if i < NU { SPEED_FACTOR * limits.qd_max[i] } else { PENDULUM_SPEED }
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

    /// Checks that a measurement can be used: clock, period, drives, angles, torques. `not_finite`: the result of
    /// [`Self::finite`] for the same measurement.
    pub fn measurement(&mut self, measurement: &Measurement, not_finite: Option<Trip>) -> Option<Trip> {
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
            beyond(TripCause::TorqueLimit, ARM, |i| measurement.tau_measured[i], level, &mut self.warnings)
        })
    }

    /// Checks that every angle is finite and within the range of an encoder.
    pub fn finite(&self, measurement: &Measurement) -> Option<Trip> {
        let joint = measurement.q.iter().position(|q| exceeds(*q, ENCODER_RANGE))?;
        let value = measurement.q[joint];
        Some(Trip { cause: TripCause::NotFinite, joint, value, limit: ENCODER_RANGE })
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

    /// Checks that the angles can have changed from `last` to `q` (rad) in `cycles` cycles.
    pub fn jump(&mut self, last: &JointVector, q: &JointVector, cycles: u64) -> Option<Trip> {
        let elapsed = self.period.seconds_of(cycles);
        let level = |i: usize| {
            let moved = self.encoder_speed[i] * elapsed;
            let Level { warn, trip } = self.levels.encoder_jump;
            Level { warn: moved + warn, trip: moved + trip }
        };
        beyond(TripCause::EncoderJump, 0..NQ, |i| q[i] - last[i], level, &mut self.warnings)
    }

    /// Checks positions (rad) and velocities (rad/s) of the arm. The pendulum is not checked: it may fall.
    pub fn arm(&mut self, x: &State) -> Option<Trip> {
        let level = scaled(self.levels.velocity_fraction, |i| self.qd_max[i]);
        let qd = x.qd_a();
        let fast = beyond(TripCause::VelocityLimit, ARM, |i| qd[i], level, &mut self.warnings);
        self.range(TripCause::PositionLimit, ARM, x).or(fast)
    }

    /// Checks the angles of the pendulum, rad; to be called while the pendulum is controlled.
    pub fn pendulum(&mut self, x: &State) -> Option<Trip> {
        self.range(TripCause::PendulumRange, PENDULUM, x)
    }

    /// Checks the distance of every angle from the reference `x_d`, rad.
    pub fn tracking(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        let level = |_| self.levels.tracking_error;
        beyond(TripCause::TrackingError, 0..NQ, |i| x[i] - x_d[i], level, &mut self.warnings)
    }

    /// Checks the distance of the arm from the pose of `x_d`, which it holds or moves to, rad.
    pub fn hold(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        self.error_of_arm(self.levels.hold_error, x, x_d)
    }

    /// Checks the distance of the arm from `x_d`, the end of a plan at which it balances, rad.
    pub fn balance_error(&mut self, x: &State, x_d: &State) -> Option<Trip> {
        self.error_of_arm(self.levels.balance_error, x, x_d)
    }

    fn error_of_arm(&mut self, level: Level, x: &State, x_d: &State) -> Option<Trip> {
        beyond(TripCause::TrackingError, ARM, |i| x[i] - x_d[i], |_| level, &mut self.warnings)
    }

    /// Checks the unexplained `torque` on the arm, N m.
    pub fn unexplained(&mut self, torque: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.collision_torque, |i| self.tau_max[i]);
        beyond(TripCause::Collision, ARM, |i| torque[i], level, &mut self.warnings)
    }

    /// Duration from which an unexplained torque counts as a collision, s.
    pub fn collision_time(&self) -> f64 {
        self.levels.collision_time
    }

    /// Checks the `tilt` of the rod from its direction at the end of the plan, rad.
    pub fn balance(&mut self, tilt: f64) -> Option<Trip> {
        let level = |_| self.levels.balance_tilt;
        beyond(TripCause::BalanceLost, PENDULUM.start..NQ, |_| tilt, level, &mut self.warnings)
    }

    /// Predicts the speeds of the arm from the filtered speeds `v` (rad/s) and the input `u` (rad/s^2) of the balance controller,
    /// and checks them.
    pub fn balance_speed(&mut self, v: &ActuatedVector, u: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.balance_speed, |i| self.qd_max[i]);
        let ahead = self.velocity_filter + STOP_DELAY;
        beyond(TripCause::BalanceSpeed, ARM, |i| v[i] + ahead * u[i], level, &mut self.warnings)
    }

    /// Checks the change of the commanded torque from `last` to `tau` (N m) in one cycle.
    pub fn torque_rate(&mut self, last: &ActuatedVector, tau: &ActuatedVector) -> Option<Trip> {
        let level = scaled(self.levels.torque_rate, |i| self.tau_max[i]);
        beyond(
            TripCause::TorqueRate,
            ARM,
            |i| (tau[i] - last[i]) / self.period.seconds(),
            level,
            &mut self.warnings,
        )
    }

    /// Largest change of the commanded torque in one cycle while a mode begins, N m: the warning level of the torque rate.
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
        for i in 0..NX {
            let velocity = i >= NQ;
            let tolerance = if velocity { self.start.velocity } else { self.start.position };
            if exceeds(x[i] - x_d[i], tolerance) {
                let (joint, measured, expected) = (i % NQ, x[i], x_d[i]);
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

    /// Checks the positions of `joints` against the range open to plans, rad.
    fn range(&mut self, cause: TripCause, joints: Range<usize>, x: &State) -> Option<Trip> {
        let Level { warn, trip } = self.levels.position_margin;
        let mut first = None;
        for joint in joints {
            let (value, lowest, highest) = (x[joint], self.q_min[joint], self.q_max[joint]);
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

/// Checks the magnitude of the value of each of `joints`; returns a trip for the first beyond its trip level.
fn beyond(
    cause: TripCause,
    joints: Range<usize>,
    value: impl Fn(usize) -> f64,
    level: impl Fn(usize) -> Level,
    warnings: &mut Warnings,
) -> Option<Trip> {
    let mut first = None;
    for joint in joints {
        let (value, Level { warn, trip }) = (value(joint), level(joint));
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
    beyond(cause, 0..1, |_| value, |_| level, warnings)
}

/// Whether the magnitude of a value exceeds its limit; true for NaN.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value.abs() > limit
}

#[cfg(test)]
mod tests;
