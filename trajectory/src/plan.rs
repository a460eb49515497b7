//! A plan: a trajectory with the gains that track it and hold its end.

use crate::{Knots, N, Spline, Trajectory};
use upswing_model::{ActuatedVector, NU, NX, State};

/// Feedback gain K of (22): du = K dx, rad/s^2 per rad and per rad/s; NU x NX.
pub type Gain = nalgebra::SMatrix<f64, NU, NX>;

/// What the controller follows at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Reference {
    /// x^d = [q, qd], rad and rad/s.
    pub x: State,
    /// u^d, rad/s^2.
    pub u: ActuatedVector,
    /// K
    pub gain: Gain,
}

/// A trajectory ready to be tracked: (12) for x^d and u^d, and the gains of (23) at its knots.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Names the plan; never 0.
    pub id: u64,
    /// Fingerprint of the model it was made for.
    pub fingerprint: u64,
    /// Moment of t = 0, for which x_0 was predicted, ns on the daemon's clock. `None`: the plan begins whenever it is
    /// started, because the robot stays at x_0.
    pub activation_ns: Option<u64>,
    /// x_k, u_k, t_F
    pub trajectory: Trajectory,
    /// f_k at the knots.
    pub f: Knots<State>,
    /// K_k at the knots.
    pub gains: Knots<Gain>,
    /// Gain of the balance at x_N (from the DARE).
    pub final_gain: Gain,
}

impl Plan {
    /// The reference at `t` (s) after the plan's start; after t_F the target x_N with the final gain and u = 0.
    /// Does not allocate.
    pub fn reference(&self, t: f64) -> Reference {
        if t >= self.trajectory.t_f {
            return self.end();
        }
        let spline = self.spline();
        let (k, dt) = spline.locate(t);
        let share = dt / self.trajectory.h();
        Reference {
            x: spline.state(t),
            u: spline.input(t),
            gain: self.gains[k] + (self.gains[k + 1] - self.gains[k]) * share,
        }
    }

    /// The target: x_N, u = 0 and the final gain.
    pub fn end(&self) -> Reference {
        Reference { x: self.trajectory.x[N], u: ActuatedVector::zeros(), gain: self.final_gain }
    }

    /// The plan's spline (12).
    pub fn spline(&self) -> Spline<'_> {
        Spline { t_f: self.trajectory.t_f, x: &self.trajectory.x, u: &self.trajectory.u, f: &self.f }
    }
}
