//! A trajectory: its knots, and the spline between them.

use crate::{KNOTS, Knots, N, largest};
use upswing_model::{ActuatedVector, Model, NX, State, StateParts, Workspace};

/// The trajectory xi = (t_F, x_0..x_N, u_0..u_N) (7), with knots uniform over [0, t_F].
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// t_F, duration, s.
    pub t_f: f64,
    /// x_k = [q, qd], states at the knots, joint frames, rad and rad/s.
    pub x: Knots<State>,
    /// u_k = qdd_A, inputs at the knots, rad/s^2.
    pub u: Knots<ActuatedVector>,
}

impl Trajectory {
    /// Longest duration t_F of a trajectory, s.
    pub const LONGEST: f64 = 60.0;

    /// h = t_F / N, time between two knots, s.
    pub fn h(&self) -> f64 {
        self.t_f / N as f64
    }

    /// (x_k, u_k) of every knot.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = (&State, &ActuatedVector)> {
        self.x.iter().zip(self.u.iter())
    }

    /// f_k = f(x_k, u_k) (5) of every knot, rad/s and rad/s^2.
    pub fn f(&self, model: &Model, work: &mut Workspace) -> Knots<State> {
        Box::new(std::array::from_fn(|k| model.f(&self.x[k], &self.u[k], work)))
    }

    /// The spline (12) through the knots, for `f` = f_k.
    pub fn spline<'a>(&'a self, f: &'a Knots<State>) -> Spline<'a> {
        Spline { t_f: self.t_f, x: &self.x, u: &self.u, f }
    }

    /// Largest component of the defects (6b), rad or rad/s; infinite if a component is NaN.
    pub fn defect(&self, model: &Model, work: &mut Workspace) -> f64 {
        self.spline(&self.f(model, work)).defect()
    }

    /// The trajectory in reversed time: the same angles and inputs in reverse order, velocities with the opposite sign. It
    /// meets (6b), limits and torques as this one does, because the dynamics (5) have no friction.
    pub fn reversed(&self) -> Self {
        let reversed = |x: &State| {
            let mut x = *x;
            x.qd_mut().neg_mut();
            x
        };
        Self {
            t_f: self.t_f,
            x: Box::new(std::array::from_fn(|k| reversed(&self.x[N - k]))),
            u: Box::new(std::array::from_fn(|k| self.u[N - k])),
        }
    }

    /// Cost J (6a), s, for R = `input_weight` I (s^4/rad^2): t_F + h/2 sum u_k' R u_k.
    pub fn cost(&self, input_weight: f64) -> f64 {
        let effort: f64 = self.u.iter().map(|u| u.norm_squared()).sum();
        self.t_f + 0.5 * self.h() * input_weight * effort
    }
}

/// The spline (12) through the knots of a trajectory: x(t) quadratic and u(t) linear in each interval.
#[derive(Clone, Copy, Debug)]
pub struct Spline<'a> {
    /// t_F, duration, s.
    pub t_f: f64,
    /// x_k, rad and rad/s.
    pub x: &'a [State; KNOTS],
    /// u_k, rad/s^2.
    pub u: &'a [ActuatedVector; KNOTS],
    /// f_k = f(x_k, u_k), rad/s and rad/s^2.
    pub f: &'a [State; KNOTS],
}

impl Spline<'_> {
    /// h = t_F / N, time between two knots, s.
    fn h(&self) -> f64 {
        self.t_f / N as f64
    }

    /// The number k < N of the interval that contains the time `t` (s), and the time since its knot k (s). Times outside
    /// [0, t_F] are clamped.
    #[inline]
    pub fn locate(&self, t: f64) -> (usize, f64) {
        let h = self.h();
        // `clamp` would let a NaN through.
        let t = t.max(0.0).min(self.t_f);
        let k = ((t / h) as usize).min(N - 1);
        (k, t - k as f64 * h)
    }

    /// x(t), rad and rad/s (12).
    #[inline]
    pub fn state(&self, t: f64) -> State {
        let (k, dt) = self.locate(t);
        self.x[k] + self.f[k] * dt + (self.f[k + 1] - self.f[k]) * (dt * dt / (2.0 * self.h()))
    }

    /// u(t), rad/s^2 (12).
    #[inline]
    pub fn input(&self, t: f64) -> ActuatedVector {
        let (k, dt) = self.locate(t);
        self.u[k] + (self.u[k + 1] - self.u[k]) * (dt / self.h())
    }

    /// The extrema of the rows of x(t) strictly between the knots k and k + 1, k < N: number of the row, share of the
    /// interval that has passed (0 to 1), value (rad or rad/s).
    pub fn extrema(&self, k: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        (0..NX).filter_map(move |row| {
            let (slope, next) = (self.f[k][row], self.f[k + 1][row]);
            // The slope is linear in the interval: the row has an extremum where the slope changes its sign.
            (slope * next < 0.0).then(|| {
                let share = slope / (slope - next);
                let x = self.x[k]
                    + (self.f[k] + (self.f[k + 1] - self.f[k]) * (0.5 * share)) * (share * self.h());
                (row, share, x[row])
            })
        })
    }

    /// The defects x_{k+1} - x_k - h/2 (f_k + f_{k+1}) (6b) of all intervals, rad and rad/s: by how much the spline jumps
    /// at its knots.
    pub fn defects(&self) -> impl Iterator<Item = State> + '_ {
        let half_h = 0.5 * self.h();
        (0..N).map(move |k| self.x[k + 1] - self.x[k] - (self.f[k] + self.f[k + 1]) * half_h)
    }

    /// Largest component of the defects (6b), rad or rad/s; infinite if a component is NaN.
    pub fn defect(&self) -> f64 {
        self.defects().map(|d| largest(&d)).fold(0.0, f64::max)
    }
}
