//! Factorisation of the linear systems of trajectory optimisation.
//!
//! Both the offline problem (6) and the replanning QP (16) lead to
//!
//! min 1/2 sum_k dz_k' H_k dz_k + g_k' dz_k + dt sum_k c_k' dz_k + 1/2 w dt^2 + g_t dt
//! s.t. dx_{k+1} - dx_k - h/2 (A_k dx_k + B_k du_k + A_{k+1} dx_{k+1} + B_{k+1} du_{k+1})
//!      - dt (f_k + f_{k+1}) / (2 N) + r_k = 0,  dx_0 = r_0,  T dx_N + r_N = 0
//!
//! over dz_k = (dx_k, du_k) and the scalar dt. Between two knots stands the vector
//!
//! s_k = dx_k + h/2 (A_k dx_k + B_k du_k) + dt (f_k + f_{k+1}) / (2 N) - r_k
//!     = dx_{k+1} - h/2 (A_{k+1} dx_{k+1} + B_{k+1} du_{k+1}),
//!
//! the state that leaves knot k and enters knot k+1. A backward sweep takes the value function of stages k+1..N, a
//! quadratic in dz_{k+1} and dt, writes it in (s_k, du_{k+1}), eliminates du_{k+1}, and writes what is left in dz_k:
//! a Riccati recursion whose gradient with respect to s_k is the multiplier of interval k. Both changes of variables
//! are those of a double integrator but for the two rows of qdd_U, so that they cost a few row operations instead of
//! products of full matrices. The reduced Hessian is positive definite exactly if every pivot block is; that is the
//! inertia test, for free. The target rows T enter as a stiff penalty, whose error iterative refinement removes.

mod sweep;
mod variables;

use crate::kkt::Dynamics;
use crate::kkt::TargetRow;
pub use sweep::Factor;

use crate::fixed::{ActuatedVector, N_UNACTUATED, NQ, NU, NX, NZ, State, vector};
use crate::rows::{STATE_ROW, StateRow};
use nalgebra::{Const, SMatrix, SVector, U1, VectorView, VectorViewMut};

/// z_k = (x_k, u_k) or a derivative with respect to it.
pub type KnotVector = SVector<f64, NZ>;
/// `R` consecutive components of a [`KnotVector`].
pub type KnotPart<'a, const R: usize> = VectorView<'a, f64, Const<R>, U1, Const<NZ>>;
/// The same, to be written.
pub type KnotPartMut<'a, const R: usize> = VectorViewMut<'a, f64, Const<R>, U1, Const<NZ>>;

/// The parts of z_k = (x_k, u_k), or of a derivative with respect to it.
pub trait KnotParts {
    /// The part of x_k.
    fn x(&self) -> KnotPart<'_, NX>;
    /// The part of u_k.
    fn u(&self) -> KnotPart<'_, NU>;
    /// The part of x_k, to be written.
    fn x_mut(&mut self) -> KnotPartMut<'_, NX>;
    /// The part of u_k, to be written.
    fn u_mut(&mut self) -> KnotPartMut<'_, NU>;
}

impl KnotParts for KnotVector {
    #[inline(always)]
    fn x(&self) -> KnotPart<'_, NX> {
        self.fixed_rows::<NX>(0)
    }

    #[inline(always)]
    fn u(&self) -> KnotPart<'_, NU> {
        self.fixed_rows::<NU>(NX)
    }

    #[inline(always)]
    fn x_mut(&mut self) -> KnotPartMut<'_, NX> {
        self.fixed_rows_mut::<NX>(0)
    }

    #[inline(always)]
    fn u_mut(&mut self) -> KnotPartMut<'_, NU> {
        self.fixed_rows_mut::<NU>(NX)
    }
}

/// Second derivatives with respect to z_k.
pub type KnotMatrix = SMatrix<f64, NZ, NZ>;

/// Linearised dynamics of one knot.
#[derive(Clone, Debug)]
pub struct KnotDynamics {
    /// d qdd_U / dx and d qdd_U / du: the rows of A_k and B_k that are not those of double integrators.
    pub qdd_u_x: SMatrix<f64, N_UNACTUATED, NX>,
    /// See `qdd_u_x`.
    pub qdd_u_u: SMatrix<f64, N_UNACTUATED, NU>,
    /// f(x_k, u_k)
    pub f: State,
}

impl KnotDynamics {
    /// Of a knot that is not linearised yet.
    pub(crate) fn zeros() -> Self {
        Self { qdd_u_x: SMatrix::zeros(), qdd_u_u: SMatrix::zeros(), f: State::zeros() }
    }

    /// Of knot `k`.
    pub(crate) fn of(dynamics: &Dynamics, k: usize) -> Self {
        let mut out = Self::zeros();
        for c in 0..N_UNACTUATED {
            let row = dynamics.rows.row(k, c);
            (0..NX).for_each(|j| out.qdd_u_x[(c, j)] = row[j]);
            (0..NU).for_each(|j| out.qdd_u_u[(c, j)] = row[NX + j]);
        }
        out.f = vector(dynamics.f.vector(k));
        out
    }

    /// A dx + B du
    pub fn apply(&self, dz: &KnotVector) -> State {
        let (dx, du) = (dz.x(), dz.u());
        let mut out = State::zeros();
        out.fixed_rows_mut::<NQ>(0).copy_from(&dz.fixed_rows::<NQ>(NQ));
        out.fixed_rows_mut::<NU>(NQ).copy_from(&du);
        let unactuated = self.qdd_u_x * dx + self.qdd_u_u * du;
        out.fixed_rows_mut::<N_UNACTUATED>(NQ + NU).copy_from(&unactuated);
        out
    }

    /// [A, B]' w
    pub fn apply_transposed(&self, w: &State) -> KnotVector {
        let w_u = w.fixed_rows::<N_UNACTUATED>(NX - N_UNACTUATED);
        let mut out = KnotVector::zeros();
        out.x_mut().copy_from(&(self.qdd_u_x.transpose() * w_u));
        for i in 0..NQ {
            out[NQ + i] += w[i];
        }
        let on_u = self.qdd_u_u.transpose() * w_u + w.fixed_rows::<NU>(NQ);
        out.u_mut().copy_from(&on_u);
        out
    }
}

/// Right-hand side of the system: gradients and residuals.
#[derive(Clone, Debug)]
pub struct Rhs {
    /// g_k
    pub g: Vec<KnotVector>,
    /// g_t
    pub g_t: f64,
    /// r_k: defects, the residuals of the dynamics (6b), N of them.
    pub defects: Vec<State>,
    /// r_0: what dx_0 shall be.
    pub start: State,
    /// r_N: residual of each target row.
    pub target: Vec<f64>,
}

impl Rhs {
    fn zeros(n: usize, targets: usize) -> Self {
        Self {
            g: vec![KnotVector::zeros(); n + 1],
            g_t: 0.0,
            defects: vec![State::zeros(); n],
            start: State::zeros(),
            target: vec![0.0; targets],
        }
    }

    /// Overwrites this with `other`, which has the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.g.copy_from_slice(&other.g);
        self.g_t = other.g_t;
        self.defects.copy_from_slice(&other.defects);
        self.start = other.start;
        self.target.copy_from_slice(&other.target);
    }

    /// Largest entry.
    fn norm(&self) -> f64 {
        let g = self.g.iter().map(|g| g.amax()).fold(self.g_t.abs(), f64::max);
        let d = self.defects.iter().map(|d| d.amax()).fold(self.start.amax(), f64::max);
        self.target.iter().map(|t| t.abs()).fold(g.max(d), f64::max)
    }
}

/// Newton step that solves the system, and the multipliers of its constraints.
#[derive(Clone, Debug)]
pub struct NewtonStep {
    /// dz_k
    pub z: Vec<KnotVector>,
    /// dt
    pub t: f64,
    /// lambda_k: multipliers of the defects, N of them.
    pub lambda: Vec<State>,
    /// Multipliers of the target rows.
    pub lambda_target: Vec<f64>,
}

impl NewtonStep {
    /// A step of the right size, all zero.
    pub fn zeros(n: usize, targets: usize) -> Self {
        Self {
            z: vec![KnotVector::zeros(); n + 1],
            t: 0.0,
            lambda: vec![State::zeros(); n],
            lambda_target: vec![0.0; targets],
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.z.copy_from_slice(&other.z);
        self.t = other.t;
        self.lambda.copy_from_slice(&other.lambda);
        self.lambda_target.copy_from_slice(&other.lambda_target);
    }

    fn add(&mut self, other: &Self) {
        self.z.iter_mut().zip(&other.z).for_each(|(a, b)| *a += b);
        self.t += other.t;
        self.lambda.iter_mut().zip(&other.lambda).for_each(|(a, b)| *a += b);
        self.lambda_target.iter_mut().zip(&other.lambda_target).for_each(|(a, b)| *a += b);
    }
}

/// The matrix of the system.
#[derive(Clone, Debug)]
pub struct Kkt {
    /// h = t_F / N, s.
    pub h: f64,
    /// H_k, symmetric.
    pub hessian: Vec<KnotMatrix>,
    /// c_k: second derivatives with respect to z_k and t.
    pub with_t: Vec<KnotVector>,
    /// w: second derivative with respect to t.
    pub t_t: f64,
    /// A_k, B_k, f_k
    pub dynamics: Vec<KnotDynamics>,
    /// T
    pub target: Vec<TargetRow>,
}

/// Memory of [`Kkt::solve_into`].
#[derive(Clone, Debug)]
pub struct SolveWorkspace {
    /// Gradient of the value function of stages k+1..N at s_k = 0, and the input there.
    gradient: Vec<StateRow>,
    feedforward: Vec<ActuatedVector>,
    left: Rhs,
    next_left: Rhs,
    correction: NewtonStep,
    refined: NewtonStep,
}

impl SolveWorkspace {
    /// For systems of `n` intervals with `targets` target rows.
    pub fn new(n: usize, targets: usize) -> Self {
        Self {
            gradient: vec![[0.0; STATE_ROW]; n],
            feedforward: vec![ActuatedVector::zeros(); n],
            left: Rhs::zeros(n, targets),
            next_left: Rhs::zeros(n, targets),
            correction: NewtonStep::zeros(n, targets),
            refined: NewtonStep::zeros(n, targets),
        }
    }
}

impl Kkt {
    fn intervals(&self) -> usize {
        self.dynamics.len() - 1
    }

    /// Adds to `left` what the constraints contribute to the conditions of a solution: their multipliers' forces
    /// on z and t, and their residuals at z and t.
    pub(crate) fn add_constraints(&self, step: &NewtonStep, left: &mut Rhs) {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        for k in 0..=n {
            // Multipliers of the intervals on both sides.
            let mut sum = State::zeros();
            let g = &mut left.g[k];
            if k < n {
                sum += step.lambda[k];
                for i in 0..NX {
                    g[i] -= step.lambda[k][i];
                }
            }
            if k > 0 {
                sum += step.lambda[k - 1];
                for i in 0..NX {
                    g[i] += step.lambda[k - 1][i];
                }
            }
            *g -= self.dynamics[k].apply_transposed(&sum) * half_h;
            left.g_t -= sum.dot(&self.dynamics[k].f) / (2.0 * n as f64);
        }
        for (row, m) in self.target.iter().zip(&step.lambda_target) {
            for i in 0..NX {
                left.g[n][i] += row.coefficients[i] * m;
            }
        }
        let mut near = self.dynamics[0].apply(&step.z[0]);
        for k in 0..n {
            let far = self.dynamics[k + 1].apply(&step.z[k + 1]);
            let share = step.t / (2.0 * n as f64);
            for i in 0..NX {
                left.defects[k][i] += step.z[k + 1][i]
                    - step.z[k][i]
                    - (near[i] + far[i]) * half_h
                    - (self.dynamics[k].f[i] + self.dynamics[k + 1].f[i]) * share;
            }
            near = far;
        }
        left.start -= step.z[0].x();
        for (l, row) in left.target.iter_mut().zip(&self.target) {
            *l += vector::<NX>(&row.coefficients).dot(&step.z[n].x());
        }
        // The multiplier of the start state is not computed: nothing needs it.
        for i in 0..NX {
            left.g[0][i] = 0.0;
        }
    }

    /// Residual of the linear system at `step`, with the damping of the factorisation.
    fn residual(&self, rhs: &Rhs, step: &NewtonStep, damping: f64, input_damping: f64, left: &mut Rhs) {
        left.copy_from(rhs);
        left.g_t += (self.t_t + damping) * step.t;
        for (k, z) in step.z.iter().enumerate() {
            let g = &mut left.g[k];
            g.gemv(1.0, &self.hessian[k], z, 1.0);
            g.axpy(step.t, &self.with_t[k], 1.0);
            for i in 0..NZ {
                g[i] += z[i] * if i < NX { damping } else { input_damping };
            }
            left.g_t += self.with_t[k].dot(z);
        }
        self.add_constraints(step, left);
    }

    /// Solves the system with the `damping` of the factorisation, refining until the residual stops shrinking: at most
    /// as often as given, and not once the residual is below the given share of the right-hand side.
    pub fn solve_into(
        &self,
        factor: &Factor,
        rhs: &Rhs,
        damping: (f64, f64),
        (refinements, accuracy): (usize, f64),
        work: &mut SolveWorkspace,
        step: &mut NewtonStep,
    ) {
        let SolveWorkspace { gradient, feedforward, left, next_left, correction, refined } = work;
        self.sweep(factor, rhs, gradient, feedforward, step);
        if refinements == 0 {
            return;
        }
        self.residual(rhs, step, damping.0, damping.1, left);
        let scale = rhs.norm().max(1e-300);
        let mut norm = left.norm();
        for _ in 0..refinements {
            if norm <= accuracy * scale {
                break;
            }
            self.sweep(factor, left, gradient, feedforward, correction);
            refined.copy_from(step);
            refined.add(correction);
            self.residual(rhs, refined, damping.0, damping.1, next_left);
            let next_norm = next_left.norm();
            // A NaN also ends the loop.
            if !(next_norm < norm) {
                break;
            }
            step.copy_from(refined);
            std::mem::swap(left, next_left);
            norm = next_norm;
        }
    }

    /// A right-hand side of the right size, all zero.
    pub fn zero_rhs(&self) -> Rhs {
        Rhs::zeros(self.intervals(), self.target.len())
    }
}
