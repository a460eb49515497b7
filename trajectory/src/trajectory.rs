//! A trajectory at its knots and between them.

use crate::{KNOTS, Knots, N, largest};
use upswing_model::{ActuatedVector, Model, NQ, NX, State, Workspace};

/// xi = (t_F, x_0..x_N, u_0..u_N) (7).
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// t_F, s.
    pub t_f: f64,
    /// x_k = [q, qd], rad and rad/s.
    pub x: Knots<State>,
    /// u_k = qdd_A, rad/s^2.
    pub u: Knots<ActuatedVector>,
}

impl Trajectory {
    /// h = t_F / N, s.
    pub fn h(&self) -> f64 {
        self.t_f / N as f64
    }

    /// (x_k, u_k) of every knot.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = (&State, &ActuatedVector)> {
        self.x.iter().zip(self.u.iter())
    }

    /// f_k = f(x_k, u_k) (5) at every knot.
    pub fn f(&self, model: &Model, work: &mut Workspace) -> Knots<State> {
        Box::new(std::array::from_fn(|k| model.f(&self.x[k], &self.u[k], work)))
    }

    /// Longest duration of a trajectory, s.
    pub const LONGEST: f64 = 60.0;

    /// Largest component of x_{k+1} - x_k - h/2 (f_k + f_{k+1}) (6b) over all intervals, rad or rad/s; infinite if one is
    /// not a number.
    pub fn defect(&self, model: &Model, work: &mut Workspace) -> f64 {
        let f = self.f(model, work);
        let half_h = 0.5 * self.h();
        let defects = (0..N).map(|k| self.x[k + 1] - self.x[k] - (f[k] + f[k + 1]) * half_h);
        defects.map(|d| largest(&d)).fold(0.0, f64::max)
    }

    /// The motion run backwards: the same angles in reverse order with opposite velocities and the same inputs. It meets
    /// (6b), limits and torques as the motion itself does, for the dynamics know no friction.
    pub fn reversed(&self) -> Self {
        let backwards = |x: &State| {
            let mut x = *x;
            x.fixed_rows_mut::<NQ>(NQ).neg_mut();
            x
        };
        Self {
            t_f: self.t_f,
            x: Box::new(std::array::from_fn(|k| backwards(&self.x[N - k]))),
            u: Box::new(std::array::from_fn(|k| self.u[N - k])),
        }
    }

    /// J of (6a) for R = `input_weight` I (s^4/rad^2): t_F + h/2 sum u_k' R u_k.
    pub fn cost(&self, input_weight: f64) -> f64 {
        let effort: f64 = self.u.iter().map(|u| u.norm_squared()).sum();
        self.t_f + 0.5 * self.h() * input_weight * effort
    }
}

/// The spline (12) through knots: x(t) quadratic, u(t) linear in each interval. Borrows x_k, u_k and
/// f_k = f(x_k, u_k).
#[derive(Clone, Copy, Debug)]
pub struct Spline<'a> {
    /// t_F, s.
    pub t_f: f64,
    /// x_k, rad and rad/s.
    pub x: &'a [State; KNOTS],
    /// u_k, rad/s^2.
    pub u: &'a [ActuatedVector; KNOTS],
    /// f_k, rad/s and rad/s^2.
    pub f: &'a [State; KNOTS],
}

impl Spline<'_> {
    /// h = t_F / N, s.
    fn h(&self) -> f64 {
        self.t_f / N as f64
    }

    /// The interval k that holds the time `t` (s), and the time since its knot (s). Times outside [0, t_F]
    /// are moved to its ends.
    #[inline]
    pub fn locate(&self, t: f64) -> (usize, f64) {
        let h = self.h();
        // `clamp` would let a NaN through.
        let t = t.max(0.0).min(self.t_f);
        let k = ((t / h) as usize).min(N - 1);
        (k, t - k as f64 * h)
    }

    /// x and u (12) a `share` of the interval after knot k; k < N.
    #[inline]
    pub fn between(&self, k: usize, share: f64) -> (State, ActuatedVector) {
        let h = self.h();
        let x = self.x[k] + (self.f[k] + (self.f[k + 1] - self.f[k]) * (0.5 * share)) * (share * h);
        (x, self.u[k] + (self.u[k + 1] - self.u[k]) * share)
    }

    /// The extrema of the rows of x, quadratics, strictly between the knots k and k + 1: row, share of the interval, value (rad
    /// or rad/s); k < N.
    pub fn extrema(&self, k: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        (0..NX).filter_map(move |row| {
            let (slope, next) = (self.f[k][row], self.f[k + 1][row]);
            // Where the slope, linear from one knot to the other, changes its sign.
            (slope * next < 0.0).then(|| {
                let share = slope / (slope - next);
                (row, share, self.between(k, share).0[row])
            })
        })
    }

    /// x(t), rad and rad/s (12).
    #[inline]
    pub fn state(&self, t: f64) -> State {
        let (k, dt) = self.locate(t);
        let h = self.h();
        self.x[k] + self.f[k] * dt + (self.f[k + 1] - self.f[k]) * (dt * dt / (2.0 * h))
    }

    /// u(t), rad/s^2 (12).
    #[inline]
    pub fn input(&self, t: f64) -> ActuatedVector {
        let (k, dt) = self.locate(t);
        let h = self.h();
        self.u[k] + (self.u[k + 1] - self.u[k]) * (dt / h)
    }
}
