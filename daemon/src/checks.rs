//! What is checked every cycle, and at the start of a plan.

use crate::supervisor::{Refusal, Trip, TripCause};
use std::ops::Range;
use upswing_config::{Config, StartTolerance};
use upswing_ipc::Measurement;
use upswing_model::{JointVector, NQ, NU, NX, State};

/// The joints of the arm, q_A, and those of the pendulum, q_U.
const ARM: Range<usize> = 0..NU;
const PENDULUM: Range<usize> = NU..NQ;

/// Speed that no pendulum reaches, rad/s: what an encoder may report at most.
const PENDULUM_SPEED: f64 = 30.0;
/// How many times the 100 % speed an encoder of the arm may report.
const SPEED_FACTOR: f64 = 2.0;
/// What the steps of an encoder may add to the change of an angle, rad.
const RESOLUTION: f64 = 1e-3;

/// The trip levels, in SI units.
#[derive(Clone, Debug)]
pub struct Checks {
    q_min: JointVector,
    q_max: JointVector,
    /// Trip level of the arm's velocities, rad/s.
    qd_max: JointVector,
    /// Largest speed that an encoder can report, rad/s.
    encoder_speed: JointVector,
    tracking_error: f64,
    balance_lost: f64,
    start: StartTolerance,
    period_ns: u64,
}

impl Checks {
    /// The trip levels that the settings ask for.
    pub fn new(config: &Config) -> Self {
        let (trip, limits, planning) = (&config.daemon.trip, &config.robot.limits, &config.robot.planning);
        Self {
            q_min: planning.q_min.add_scalar(-trip.position_margin),
            q_max: planning.q_max.add_scalar(trip.position_margin),
            qd_max: limits.qd_max * trip.velocity_fraction,
            encoder_speed: JointVector::from_fn(|i, _| {
                if i < NU { SPEED_FACTOR * limits.qd_max[i] } else { PENDULUM_SPEED }
            }),
            tracking_error: trip.tracking_error,
            balance_lost: config.daemon.balance_lost,
            start: config.daemon.start,
            period_ns: u64::try_from(config.daemon.cycle.period.as_nanos()).unwrap_or(u64::MAX),
        }
    }

    /// Whether a measurement can be used at all: clock, period, drives, finite angles.
    pub fn measurement(&self, measurement: &Measurement) -> Option<Trip> {
        if let Err(unknown) = measurement.clock() {
            let (value, limit) = (unknown.got as f64, unknown.max as f64);
            return Some(Trip { cause: TripCause::UnknownClock, joint: 0, value, limit });
        }
        if measurement.period_ns != self.period_ns {
            let (value, limit) = (measurement.period_ns as f64, self.period_ns as f64);
            return Some(Trip { cause: TripCause::PeriodMismatch, joint: 0, value, limit });
        }
        if measurement.status & Measurement::DRIVE_FAULT != 0 {
            return Some(Trip::plain(TripCause::DriveFault));
        }
        self.finite(measurement)
    }

    /// Whether all angles are finite.
    pub fn finite(&self, measurement: &Measurement) -> Option<Trip> {
        let joint = measurement.q.iter().position(|q| !q.is_finite())?;
        Some(Trip { cause: TripCause::NotFinite, joint, value: measurement.q[joint], limit: 0.0 })
    }

    /// Whether the angles can have changed from `last` to `q` (rad) in `cycles` cycles.
    pub fn jump(&self, last: &JointVector, q: &JointVector, cycles: u64) -> Option<Trip> {
        let elapsed = cycles as f64 * self.period_ns as f64 * 1e-9;
        let limit = |i: usize| self.encoder_speed[i] * elapsed + RESOLUTION;
        beyond(TripCause::EncoderJump, 0..NQ, |i| q[i] - last[i], limit)
    }

    /// Positions and velocities of the arm. Those of a falling pendulum are nobody's fault.
    pub fn arm(&self, x: &State) -> Option<Trip> {
        let fast = || beyond(TripCause::VelocityLimit, ARM, |i| x[NQ + i], |i| self.qd_max[i]);
        self.range(TripCause::PositionLimit, ARM, x).or_else(fast)
    }

    /// Angles of the pendulum; they matter while it is being controlled.
    pub fn pendulum(&self, x: &State) -> Option<Trip> {
        self.range(TripCause::PendulumRange, PENDULUM, x)
    }

    /// Distance of every angle from the reference `x_d`.
    pub fn tracking(&self, x: &State, x_d: &State) -> Option<Trip> {
        beyond(TripCause::TrackingError, 0..NQ, |i| x[i] - x_d[i], |_| self.tracking_error)
    }

    /// `tilt` of the rod from where the plan ends, rad.
    pub fn balance(&self, tilt: f64) -> Option<Trip> {
        beyond(TripCause::BalanceLost, PENDULUM.start..NQ, |_| tilt, |_| self.balance_lost)
    }

    /// Whether the state `x` is the start `x_0` of a plan.
    ///
    /// # Errors
    /// [`Refusal::StartMismatch`] with the first joint that is too far away.
    pub fn start(&self, x: &State, x_0: &State) -> Result<(), Refusal> {
        for i in 0..NX {
            let velocity = i >= NQ;
            let tolerance = if velocity { self.start.velocity } else { self.start.position };
            if exceeds(x[i] - x_0[i], tolerance) {
                let (joint, measured, expected) = (i % NQ, x[i], x_0[i]);
                return Err(Refusal::StartMismatch { joint, velocity, measured, expected, tolerance });
            }
        }
        Ok(())
    }

    fn range(&self, cause: TripCause, joints: Range<usize>, x: &State) -> Option<Trip> {
        for joint in joints {
            let (value, lowest, highest) = (x[joint], self.q_min[joint], self.q_max[joint]);
            // A NaN is in no range.
            if !(lowest..=highest).contains(&value) {
                let limit = if value < lowest { lowest } else { highest };
                return Some(Trip { cause, joint, value, limit });
            }
        }
        None
    }
}

/// The first of `joints` whose value exceeds its limit in magnitude.
fn beyond(
    cause: TripCause,
    joints: Range<usize>,
    value: impl Fn(usize) -> f64,
    limit: impl Fn(usize) -> f64,
) -> Option<Trip> {
    let mut trips = joints.map(|joint| Trip { cause, joint, value: value(joint), limit: limit(joint) });
    trips.find(|trip| exceeds(trip.value, trip.limit))
}

/// Whether a value is beyond its limit in magnitude; a NaN is.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value.abs() > limit
}
