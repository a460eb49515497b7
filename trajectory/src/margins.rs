//! Margins: how far a trajectory stays from its limits, also between the knots.

use crate::{Spline, Trajectory};
use std::convert::Infallible;
use upswing_model::{ActuatedVector, LimitKind, Limits, Model, State};

/// The smallest distance to the limits of one kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Distance as a share of half the range: 1 in the middle, 0 on the limit, negative beyond it.
    pub share: f64,
    /// The joint that comes closest to its limit, from 0.
    pub joint: usize,
    /// Time of the smallest distance since the start of the trajectory, s.
    pub time: f64,
}

impl Margin {
    const NONE: Self = Self { share: f64::INFINITY, joint: 0, time: 0.0 };

    fn include(&mut self, value: f64, (lower, upper): (f64, f64), joint: usize, time: f64) {
        let half = 0.5 * (upper - lower);
        let share = (value - lower).min(upper - value) / half;
        // A NaN counts as the smallest margin.
        let share = if share.is_nan() { f64::NEG_INFINITY } else { share };
        if share < self.share {
            *self = Self { share, joint, time };
        }
    }
}

/// The smallest margins of a trajectory to its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// Of the positions.
    pub q: Margin,
    /// Of the velocities.
    pub qd: Margin,
    /// Of the motor torques (9).
    pub tau: Margin,
}

impl Margins {
    pub(crate) const NONE: Self = Self { q: Margin::NONE, qd: Margin::NONE, tau: Margin::NONE };

    /// The margins of the spline (12) at its knots and at `between` more points in each interval.
    pub fn of(trajectory: &Trajectory, model: &Model, limits: &Limits, between: usize) -> Self {
        let f = trajectory.f(model);
        let mut margins = Self::NONE;
        let all = visit_points(&trajectory.spline(&f), between + 1, model, |_, time, x, tau| {
            margins.include(time, x, tau, limits);
            Ok::<_, Infallible>(())
        });
        all.unwrap_or_else(|never| match never {});
        margins
    }

    /// The margins of the state `x` and the motor torque `tau` at `time`.
    pub(crate) fn include(&mut self, time: f64, x: &State, tau: &ActuatedVector, limits: &Limits) {
        let n = x.len() / 2;
        for joint in 0..n {
            self.q.include(x[joint], limits.range(LimitKind::Position, joint), joint, time);
            self.qd.include(x[n + joint], limits.range(LimitKind::Velocity, joint), joint, time);
        }
        for joint in 0..tau.len() {
            self.tau.include(tau[joint], limits.range(LimitKind::Torque, joint), joint, time);
        }
    }

    /// The smallest of the three shares.
    pub fn smallest(&self) -> f64 {
        self.q.share.min(self.qd.share).min(self.tau.share)
    }
}

/// Calls `visit` with the number, the time since the start (s), the state and the motor torque (9) of each of the `N * parts + 1` points of
/// the spline (12) that divide its intervals into `parts` equal ones, in order, until it returns an error.
pub(crate) fn visit_points<E>(
    spline: &Spline<'_>,
    parts: usize,
    model: &Model,
    mut visit: impl FnMut(usize, f64, &State, &ActuatedVector) -> Result<(), E>,
) -> Result<(), E> {
    let last = spline.intervals() * parts;
    let time = |i: usize| spline.t_f * i as f64 / last as f64;
    let point = |i: usize, x: &mut State, u: &mut ActuatedVector| {
        let (k, dt) = spline.locate(time(i));
        (*x, *u) = (spline.state_in(k, dt), spline.input_in(k, dt));
    };
    model.try_hybrid_dynamics(last + 1, point, |i, x, dynamics| visit(i, time(i), x, &dynamics.tau))
}
