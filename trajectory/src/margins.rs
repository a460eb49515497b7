//! Margins: how far a trajectory stays from its limits, also between the knots.

use crate::{Spline, Trajectory};
use upswing_model::{ActuatedVector, LimitKind, Limits, Model, State, Workspace};

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

/// One point of the spline (12) with the motor torque that it needs.
pub(crate) struct SplinePoint {
    /// s since the start of the trajectory.
    time: f64,
    x: State,
    /// tau_A (9), N m.
    pub(crate) tau: ActuatedVector,
}

impl SplinePoint {
    /// Point number `i` of the `N * parts + 1` points that divide each interval into `parts` equal ones.
    pub(crate) fn new(
        spline: &Spline<'_>,
        i: usize,
        parts: usize,
        model: &Model,
        work: &mut Workspace,
    ) -> Self {
        let time = spline.t_f * i as f64 / (spline.intervals() * parts) as f64;
        let x = spline.state(time);
        let tau = model.torque(&x, &spline.input(time), work);
        Self { time, x, tau }
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
        let mut work = Workspace::default();
        let f = trajectory.f(model, &mut work);
        let spline = trajectory.spline(&f);
        let parts = between + 1;
        let mut margins = Self::NONE;
        for i in 0..=spline.intervals() * parts {
            margins.include(&SplinePoint::new(&spline, i, parts, model, &mut work), limits);
        }
        margins
    }

    pub(crate) fn include(&mut self, sample: &SplinePoint, limits: &Limits) {
        let (q, qd) = (sample.x.q(), sample.x.qd());
        for joint in 0..q.len() {
            self.q.include(q[joint], limits.range(LimitKind::Position, joint), joint, sample.time);
            self.qd.include(qd[joint], limits.range(LimitKind::Velocity, joint), joint, sample.time);
        }
        for joint in 0..sample.tau.len() {
            self.tau.include(sample.tau[joint], limits.range(LimitKind::Torque, joint), joint, sample.time);
        }
    }

    /// The smallest of the three shares.
    pub fn smallest(&self) -> f64 {
        self.q.share.min(self.qd.share).min(self.tau.share)
    }
}
