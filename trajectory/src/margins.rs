//! How far a trajectory stays from its limits, between the knots too.

use crate::{N, Spline, Trajectory};
use upswing_model::{Limits, Model, NQ, NU, Workspace, position, velocity};

/// The smallest distance to one kind of limit, as a share of that limit's range: 1 in the middle, 0 on the limit,
/// negative beyond it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Share of half the range.
    pub share: f64,
    /// The joint that comes closest, 0-based.
    pub joint: usize,
    /// When, s.
    pub time: f64,
}

impl Margin {
    const NONE: Self = Self { share: f64::INFINITY, joint: 0, time: 0.0 };

    fn update(&mut self, value: f64, lower: f64, upper: f64, joint: usize, time: f64) {
        let half = 0.5 * (upper - lower);
        let share = (value - lower).min(upper - value) / half;
        // A NaN is the worst of all.
        let share = if share.is_nan() { f64::NEG_INFINITY } else { share };
        if share < self.share {
            *self = Self { share, joint, time };
        }
    }
}

/// Smallest margins of a trajectory to its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// Of the positions.
    pub q: Margin,
    /// Of the velocities.
    pub qd: Margin,
    /// Of the motor torques (9) that the spline's x and u need.
    pub tau: Margin,
}

impl Margins {
    /// Samples the spline (12) at the knots and at `between` more points in each interval.
    pub fn of(trajectory: &Trajectory, model: &Model, limits: &Limits, between: usize) -> Self {
        let mut work = Workspace::default();
        let f = trajectory.f(model, &mut work);
        let spline = Spline { t_f: trajectory.t_f, x: &trajectory.x, u: &trajectory.u, f: &f };
        let mut margins = Self { q: Margin::NONE, qd: Margin::NONE, tau: Margin::NONE };
        let samples = N * (between + 1);
        for i in 0..=samples {
            let t = trajectory.t_f * i as f64 / samples as f64;
            let (x, u) = (spline.state(t), spline.input(t));
            let (q, qd) = (position(&x), velocity(&x));
            for j in 0..NQ {
                margins.q.update(q[j], limits.q_min[j], limits.q_max[j], j, t);
                margins.qd.update(qd[j], -limits.qd_max[j], limits.qd_max[j], j, t);
            }
            let tau = model.torque(&x, &u, &mut work);
            for j in 0..NU {
                margins.tau.update(tau[j], -limits.tau_max[j], limits.tau_max[j], j, t);
            }
        }
        margins
    }

    /// The smallest of the three shares.
    pub fn smallest(&self) -> f64 {
        self.q.share.min(self.qd.share).min(self.tau.share)
    }
}
