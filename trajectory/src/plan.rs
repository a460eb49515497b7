//! A plan: a trajectory with the feedback gains that track it and hold its end.

use crate::{Knots, N, Spline, Trajectory};
use upswing_model::{ActuatedVector, NU, NX, State};

/// Feedback gain K (22), NU x NX: du = K dx, 1/s^2 for positions and 1/s for velocities.
pub type Gain = nalgebra::SMatrix<f64, NU, NX>;

/// Feedback gains of a trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    /// K_k (23) at the knots.
    pub knots: Knots<Gain>,
    /// The gain that holds x_N after t_F, from the algebraic Riccati equation (21).
    pub end: Gain,
}

/// The reference of the controller at one moment: u = u_d + K (x - x_d).
#[derive(Clone, Copy, Debug)]
pub struct Reference {
    /// x_d = [q, qd], rad and rad/s.
    pub x: State,
    /// u_d, rad/s^2.
    pub u: ActuatedVector,
    /// K, 1/s^2 and 1/s.
    pub gain: Gain,
}

/// A trajectory with its gains and its spline: what the daemon tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Identity of the plan, above 0.
    pub id: u64,
    /// Fingerprint of the model that the plan was made for.
    pub fingerprint: u64,
    /// Moment of t = 0, for which x_0 was predicted, ns on the daemon's clock. `None`: the plan begins whenever it is
    /// started, because the robot stays at x_0.
    pub activation_ns: Option<u64>,
    /// t_F, x_k and u_k.
    pub trajectory: Trajectory,
    /// f_k = f(x_k, u_k), rad/s and rad/s^2.
    pub f: Knots<State>,
    /// K_k and the gain that holds x_N.
    pub gains: Gains,
}

impl Plan {
    /// The reference at the time `t` (s) since the start of the plan, K interpolated linearly between the knots; after
    /// t_F that of [`Self::end`]. Does not allocate.
    pub fn reference(&self, t: f64) -> Reference {
        if t >= self.trajectory.t_f {
            return self.end();
        }
        let spline = self.spline();
        let (k, dt) = spline.locate(t);
        let share = dt / self.trajectory.h();
        let gains = &self.gains.knots;
        Reference {
            x: spline.state(t),
            u: spline.input(t),
            gain: gains[k] + (gains[k + 1] - gains[k]) * share,
        }
    }

    /// The reference after t_F: x_N, u = 0 and the gain that holds x_N.
    pub fn end(&self) -> Reference {
        Reference { x: self.trajectory.x[N], u: ActuatedVector::zeros(), gain: self.gains.end }
    }

    /// The spline (12) of the trajectory.
    pub fn spline(&self) -> Spline<'_> {
        self.trajectory.spline(&self.f)
    }
}
