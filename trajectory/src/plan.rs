//! A plan: a trajectory with the feedback gains that track it and hold its end.

use crate::{Gains, InterpolatedGain, Spline, Trajectory};
use upswing_model::{ActuatedVector, Model, State};

/// The reference of the controller at one moment: u = u_d + K (x - x_d).
#[derive(Clone, Copy, Debug)]
pub struct Reference<'a> {
    /// x_d = [q, qd].
    pub x: State,
    /// u_d.
    pub u: ActuatedVector,
    /// K, 1/s^2 and 1/s.
    pub gain: InterpolatedGain<'a>,
}

impl Reference<'_> {
    /// The input u = u_d + K (x - x_d) in the state `x`. Does not allocate.
    #[inline]
    pub fn input(&self, x: &State) -> ActuatedVector {
        self.u + self.gain.times(&(x - self.x))
    }
}

/// A trajectory with its gains and its spline: what the daemon tracks.
///
/// Trajectory, `f` and gains have the same number of intervals and are for the same chain;
/// [`PlanCriteria::check`](crate::PlanCriteria::check) refuses others.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Identity of the plan, above 0.
    pub id: u64,
    /// Fingerprint of the model that the plan was made for.
    pub fingerprint: u64,
    /// Moment of t = 0, for which x_0 was predicted, ns on the daemon's clock. `None`: the plan begins whenever it is
    /// started, because the robot stays at x_0.
    pub activation_ns: Option<u64>,
    /// Id of the running plan that this plan replaces at its activation. `None`: the plan is started by a request.
    pub replaces: Option<u64>,
    /// t_F, x_k and u_k.
    pub trajectory: Trajectory,
    /// f_k = f(x_k, u_k), time derivative of the state at the knots.
    pub f: Vec<State>,
    /// K_k and the gain that holds x_N.
    pub gains: Gains,
}

impl Plan {
    /// The plan of a trajectory of `model` with its gains, without activation time. Its id is the XXH3 hash of both, at least 1: equal plans
    /// have equal ids, and different plans almost never.
    pub fn new(model: &Model, trajectory: Trajectory, gains: Gains) -> Self {
        let mut hash = xxhash_rust::xxh3::Xxh3::new();
        let t = &trajectory;
        let numbers = t.x.iter().flat_map(|x| x.iter()).chain(t.u.iter().flat_map(|u| u.iter()));
        numbers.chain([&t.t_f]).chain(gains.as_slice()).for_each(|v| hash.update(&v.to_le_bytes()));
        Self {
            id: hash.digest().max(1),
            fingerprint: model.fingerprint(),
            activation_ns: None,
            replaces: None,
            f: trajectory.f(model),
            trajectory,
            gains,
        }
    }

    /// The reference at the time `t` (s) since the start of the plan, K interpolated linearly between the knots; after
    /// t_F that of [`Self::end`]. Does not allocate.
    pub fn reference(&self, t: f64) -> Reference<'_> {
        if t >= self.trajectory.t_f {
            return self.end();
        }
        let spline = self.spline();
        let (k, dt) = spline.locate(t);
        let gain = self.gains.between(k, dt / self.trajectory.h());
        Reference { x: spline.state_in(k, dt), u: spline.input_in(k, dt), gain }
    }

    /// The reference after t_F: x_N, u = 0 and the gain that holds x_N.
    pub fn end(&self) -> Reference<'_> {
        let x = *self.trajectory.end();
        Reference { x, u: ActuatedVector::zeros(x.sizes()), gain: self.gains.end().into() }
    }

    /// The spline (12) of the trajectory.
    pub fn spline(&self) -> Spline<'_> {
        self.trajectory.spline(&self.f)
    }
}
