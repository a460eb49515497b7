//! A trajectory at its knots.

use crate::N;
use upswing_model::{ActuatedVector, Model, State, Workspace};

/// xi = (t_F, x_0..x_N, u_0..u_N) (7).
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// t_F, s.
    pub t_f: f64,
    /// x_k = [q, qd], rad and rad/s; KNOTS of them.
    pub x: Vec<State>,
    /// u_k = qdd_A, rad/s^2; KNOTS of them.
    pub u: Vec<ActuatedVector>,
}

impl Trajectory {
    /// h = t_F / N, s.
    pub fn h(&self) -> f64 {
        self.t_f / N as f64
    }

    /// f_k = f(x_k, u_k) (5) at every knot.
    pub fn f(&self, model: &Model, work: &mut Workspace) -> Vec<State> {
        self.x.iter().zip(&self.u).map(|(x, u)| model.f(x, u, work)).collect()
    }

    /// Largest component of x_{k+1} - x_k - h/2 (f_k + f_{k+1}) (6b) over all intervals, rad or rad/s.
    pub fn defect(&self, model: &Model, work: &mut Workspace) -> f64 {
        let f = self.f(model, work);
        let half_h = 0.5 * self.h();
        (0..N)
            .map(|k| (self.x[k + 1] - self.x[k] - (f[k] + f[k + 1]) * half_h).amax())
            .fold(0.0, f64::max)
    }
}
