//! A trajectory: its knots, and the spline between them.

use crate::largest;
use upswing_model::{ActuatedVector, Dims, Model, Sizes, State, with_dims};

/// The trajectory xi = (t_F, x_0..x_N, u_0..u_N) (7), with knots uniform over [0, t_F].
///
/// `x` and `u` have the same length N + 1, at least 2.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// t_F, duration, s.
    pub t_f: f64,
    /// x_k = [q, qd], states at the knots, joint frames.
    pub x: Vec<State>,
    /// u_k = qdd_A, inputs at the knots.
    pub u: Vec<ActuatedVector>,
}

impl Trajectory {
    /// Longest duration t_F of a trajectory, s.
    pub const LONGEST: f64 = 60.0;

    /// N, the number of collocation intervals.
    pub fn intervals(&self) -> usize {
        self.x.len() - 1
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.x[0].sizes()
    }

    /// x_0, the state at t = 0.
    pub fn start(&self) -> &State {
        &self.x[0]
    }

    /// x_N, the state at t_F.
    pub fn end(&self) -> &State {
        &self.x[self.x.len() - 1]
    }

    /// h = t_F / N, time between two knots, s.
    pub fn h(&self) -> f64 {
        self.t_f / self.intervals() as f64
    }

    /// (x_k, u_k) of every knot.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = (&State, &ActuatedVector)> {
        self.x.iter().zip(self.u.iter())
    }

    /// f_k = f(x_k, u_k) (5) of every knot.
    pub fn f(&self, model: &Model) -> Vec<State> {
        model.f_of_all(&self.x, &self.u)
    }

    /// The spline (12) through the knots, for `f` = f_k.
    pub fn spline<'a>(&'a self, f: &'a [State]) -> Spline<'a> {
        Spline { t_f: self.t_f, x: &self.x, u: &self.u, f }
    }

    /// Largest component of the defects (6b); infinite if a component is NaN.
    pub fn defect(&self, model: &Model) -> f64 {
        self.spline(&self.f(model)).defect()
    }

    /// The trajectory in reversed time: the same positions and inputs in reverse order, velocities with the opposite sign. It
    /// meets (6b), limits and torques as this one does, because the dynamics (5) have no friction.
    pub fn reversed(&self) -> Self {
        let reversed = |x: &State| State::new(&x.q(), &-x.qd());
        Self {
            t_f: self.t_f,
            x: self.x.iter().rev().map(reversed).collect(),
            u: self.u.iter().rev().copied().collect(),
        }
    }

    /// Cost J (6a), s, for R = `input_weight` I (s^4/rad^2): t_F + h/2 sum u_k' R u_k.
    pub fn cost(&self, input_weight: f64) -> f64 {
        let effort: f64 = self.u.iter().map(|u| u.norm_squared()).sum();
        self.t_f + 0.5 * self.h() * input_weight * effort
    }
}

/// The spline (12) through the knots of a trajectory: x(t) quadratic and u(t) linear in each interval.
///
/// `x`, `u` and `f` have the same length N + 1, at least 2.
#[derive(Clone, Copy, Debug)]
pub struct Spline<'a> {
    /// t_F, duration, s.
    pub t_f: f64,
    /// x_k.
    pub x: &'a [State],
    /// u_k.
    pub u: &'a [ActuatedVector],
    /// f_k = f(x_k, u_k).
    pub f: &'a [State],
}

impl Spline<'_> {
    /// N, the number of collocation intervals.
    #[inline]
    pub fn intervals(&self) -> usize {
        self.x.len() - 1
    }

    /// h = t_F / N, time between two knots, s.
    #[inline]
    fn h(&self) -> f64 {
        self.t_f / self.intervals() as f64
    }

    /// The number k < N of the interval that contains the time `t` (s), and the time since its knot k (s). Times outside
    /// [0, t_F] are clamped.
    #[inline]
    pub fn locate(&self, t: f64) -> (usize, f64) {
        let h = self.h();
        // `clamp` would let a NaN through.
        let t = t.max(0.0).min(self.t_f);
        let k = ((t / h) as usize).min(self.intervals() - 1);
        (k, t - k as f64 * h)
    }

    /// x(t) (12).
    #[inline]
    pub fn state(&self, t: f64) -> State {
        let (k, dt) = self.locate(t);
        self.state_in(k, dt)
    }

    /// x(t) (12) in the interval `k`, `dt` s after its knot.
    #[inline]
    pub(crate) fn state_in(&self, k: usize, dt: f64) -> State {
        let (x, f, next) = (&self.x[k], &self.f[k], &self.f[k + 1]);
        let half = dt * dt / (2.0 * self.h());
        with_dims!(x.sizes(), |d| {
            let mut out = State::zeros(x.sizes());
            let n = d.state();
            for (out, ((x, f), next)) in out[..n].iter_mut().zip(x[..n].iter().zip(&f[..n]).zip(&next[..n])) {
                *out = x + f * dt + (next - f) * half;
            }
            out
        })
    }

    /// dx/dt of x(t) (12): f_k linear between the knots.
    #[inline]
    pub fn derivative(&self, t: f64) -> State {
        let (k, dt) = self.locate(t);
        self.f[k] + (self.f[k + 1] - self.f[k]) * (dt / self.h())
    }

    /// u(t) (12).
    #[inline]
    pub fn input(&self, t: f64) -> ActuatedVector {
        let (k, dt) = self.locate(t);
        self.input_in(k, dt)
    }

    /// u(t) (12) in the interval `k`, `dt` s after its knot.
    #[inline]
    pub(crate) fn input_in(&self, k: usize, dt: f64) -> ActuatedVector {
        self.u[k] + (self.u[k + 1] - self.u[k]) * (dt / self.h())
    }

    /// The extrema of the rows of x(t) strictly between the knots k and k + 1, k < N: number of the row, share of the
    /// interval that has passed (0 to 1), value.
    pub fn extrema(&self, k: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        (0..self.x[k].len()).filter_map(move |row| {
            let (slope, next) = (self.f[k][row], self.f[k + 1][row]);
            // The slope is linear in the interval: the row has an extremum where the slope changes its sign.
            (slope * next < 0.0).then(|| {
                let share = slope / (slope - next);
                let mean = slope + (next - slope) * (0.5 * share);
                (row, share, self.x[k][row] + mean * (share * self.h()))
            })
        })
    }

    /// The defects x_{k+1} - x_k - h/2 (f_k + f_{k+1}) (6b) of all intervals: by how much the spline jumps at its knots.
    pub fn defects(&self) -> impl Iterator<Item = State> + '_ {
        let half_h = 0.5 * self.h();
        (0..self.intervals()).map(move |k| self.x[k + 1] - self.x[k] - (self.f[k] + self.f[k + 1]) * half_h)
    }

    /// Largest component of the defects (6b); infinite if a component is NaN.
    pub fn defect(&self) -> f64 {
        self.defects().map(|d| largest(&d)).fold(0.0, f64::max)
    }
}
