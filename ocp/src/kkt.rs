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
//! are those of a double integrator but for the rows of qdd_U, so that they cost a few row operations instead of
//! products of full matrices. The reduced Hessian is positive definite exactly if every pivot block is; that is the
//! inertia test, for free. The target rows T enter as a stiff penalty, whose error iterative refinement removes.

mod dynamics;
mod orthonormal;
mod sweep;
mod target;
#[cfg(test)]
mod tests;
mod variables;

pub use dynamics::Dynamics;
pub use sweep::Factor;
use sweep::{Pass, SweepWorkspace};
pub(crate) use sweep::{change_variables, factorise};
pub(crate) use target::nearest_state;
pub use target::{DependentTargetRow, TargetRow, check_target_rows};

use crate::dims::{Registers, dispatch, kernels};
use crate::kernels::{amax, combine, dot, mirror, shift_add, update_lower};
use crate::slab::{Knots, LARGEST_KNOT, Slab};
use dynamics::{apply, apply_transposed};
use upswing_model::{LARGEST_STATE, MOST_JOINTS, Sizes, State, States};

/// Right-hand side of the system: gradients and residuals.
#[derive(Clone, Debug)]
pub struct Rhs {
    /// g_k, N + 1 vectors.
    pub g: Slab<Knots>,
    /// g_t
    pub g_t: f64,
    /// r_k: defects, the residuals of the dynamics (6b), N vectors.
    pub defects: Slab<States>,
    /// r_0: what dx_0 shall be.
    pub start: State,
    /// r_N: residual of each target row.
    pub target: Vec<f64>,
}

impl Rhs {
    fn zeros(sizes: Sizes, n: usize, targets: usize) -> Self {
        Self {
            g: Slab::zeros(sizes, n + 1, 1),
            g_t: 0.0,
            defects: Slab::zeros(sizes, n, 1),
            start: State::zeros(sizes),
            target: vec![0.0; targets],
        }
    }

    /// Overwrites this with `other`, which has the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.g.copy_from(&other.g);
        self.g_t = other.g_t;
        self.defects.copy_from(&other.defects);
        self.start = other.start;
        self.target.copy_from_slice(&other.target);
    }

    /// Largest absolute value of an entry.
    #[inline(always)]
    fn norm(&self) -> f64 {
        amax(self.g.as_slice())
            .max(self.g_t.abs())
            .max(amax(self.defects.as_slice()))
            .max(amax(&self.start))
            .max(amax(&self.target))
    }
}

/// Newton step that solves the system, and the multipliers of its constraints.
#[derive(Clone, Debug, PartialEq)]
pub struct NewtonStep {
    /// dz_k, N + 1 vectors.
    pub z: Slab<Knots>,
    /// dt
    pub t: f64,
    /// lambda_k: multipliers of the defects, N vectors.
    pub lambda: Slab<States>,
    /// Multipliers of the target rows.
    pub lambda_target: Vec<f64>,
}

impl NewtonStep {
    /// A step of `n` intervals with `targets` target rows, all zero.
    pub fn zeros(sizes: Sizes, n: usize, targets: usize) -> Self {
        Self {
            z: Slab::zeros(sizes, n + 1, 1),
            t: 0.0,
            lambda: Slab::zeros(sizes, n, 1),
            lambda_target: vec![0.0; targets],
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.z.copy_from(&other.z);
        self.t = other.t;
        self.lambda.copy_from(&other.lambda);
        self.lambda_target.copy_from_slice(&other.lambda_target);
    }

    /// Adds `alpha` times `other`.
    #[inline(always)]
    pub(crate) fn add_scaled(&mut self, alpha: f64, other: &Self) {
        shift_add(self.z.as_mut_slice(), alpha, other.z.as_slice());
        self.t += alpha * other.t;
        shift_add(self.lambda.as_mut_slice(), alpha, other.lambda.as_slice());
        shift_add(&mut self.lambda_target, alpha, &other.lambda_target);
    }
}

/// diag(d_k) + J_k' diag(sigma_k) J_k for all knots, which the factorisation adds up where it needs it: a QP whose H_k is nothing else
/// writes and reads no panels of it. Empty if there is none.
#[derive(Clone, Debug)]
pub(crate) struct Products {
    /// d_k, N + 1 vectors.
    pub(crate) diagonal: Slab<Knots>,
    /// J_k, N + 1 panels of n_A rows.
    pub(crate) jacobian: Slab<Knots>,
    /// sigma_k, n_A entries for each knot.
    pub(crate) sigma: Vec<f64>,
}

impl Products {
    fn zeros(sizes: Sizes, knots: usize) -> Self {
        let actuated = sizes.actuated();
        Self {
            diagonal: Slab::zeros(sizes, knots, 1),
            jacobian: Slab::zeros(sizes, knots, actuated),
            sigma: vec![0.0; knots * actuated],
        }
    }
}

/// The matrix of the system.
#[derive(Clone, Debug)]
pub struct Kkt {
    /// h = t_F / N, s.
    pub h: f64,
    /// H_k, symmetric: N + 1 panels of as many rows as z has entries. None of them where H_k is a sum of products alone.
    pub hessian: Slab<Knots>,
    /// What H_k has besides, if anything.
    pub(crate) products: Products,
    /// c_k: second derivatives with respect to z_k and t, N + 1 vectors.
    pub with_t: Slab<Knots>,
    /// w: second derivative with respect to t.
    pub t_t: f64,
    /// A_k, B_k, f_k
    pub dynamics: Dynamics,
    /// T, whose rows do not depend on each other.
    pub target: Vec<TargetRow>,
}

/// Memory of [`Kkt::solve_into`].
#[derive(Clone, Debug)]
pub struct SolveWorkspace {
    sweep: SweepWorkspace,
    left: Rhs,
    next_left: Rhs,
    correction: NewtonStep,
    refined: NewtonStep,
}

impl SolveWorkspace {
    /// For systems of `n` intervals with `targets` target rows.
    pub fn new(sizes: Sizes, n: usize, targets: usize) -> Self {
        Self {
            sweep: SweepWorkspace::new(sizes, n),
            left: Rhs::zeros(sizes, n, targets),
            next_left: Rhs::zeros(sizes, n, targets),
            correction: NewtonStep::zeros(sizes, n, targets),
            refined: NewtonStep::zeros(sizes, n, targets),
        }
    }
}

impl Kkt {
    /// The matrix 0 of `n` intervals.
    pub fn zeros(sizes: Sizes, n: usize, target: &[TargetRow]) -> Self {
        Self {
            h: 0.0,
            hessian: Slab::zeros(sizes, n + 1, sizes.knot()),
            products: Products::zeros(sizes, 0),
            with_t: Slab::zeros(sizes, n + 1, 1),
            t_t: 0.0,
            dynamics: Dynamics::zeros(sizes, n),
            target: target.to_vec(),
        }
    }

    /// The matrix of `n` intervals whose H_k are [`Products`] alone, 0.
    pub(crate) fn of_products(sizes: Sizes, n: usize, target: &[TargetRow]) -> Self {
        Self {
            hessian: Slab::zeros(sizes, 0, sizes.knot()),
            products: Products::zeros(sizes, n + 1),
            ..Self::zeros(sizes, n, target)
        }
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.dynamics.sizes()
    }

    /// N
    pub fn intervals(&self) -> usize {
        self.with_t.panels() - 1
    }

    /// A right-hand side of the right size, all zero.
    pub fn zero_rhs(&self) -> Rhs {
        Rhs::zeros(self.sizes(), self.intervals(), self.target.len())
    }

    /// [`Self::change_variables`] and [`Self::factorise`].
    pub fn factor_into(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> bool {
        self.change_variables(factor) && self.factorise(damping, input_damping, factor)
    }

    /// The part of a factorisation that depends on h, A_k, B_k, f_k and T alone. `factor` must be one for as many intervals. `false` if
    /// target rows depend on each other.
    pub fn change_variables(&self, factor: &mut Factor) -> bool {
        dispatch!(self.sizes(), |d| change_variables(d, self, factor))
    }

    /// Backward sweep with `damping` added to the diagonal of every H_k and to w (inertia correction): one
    /// number for states and t, one for inputs. `factor` must know the changes of variables. `false`, with a useless factor, if the
    /// reduced Hessian is not positive definite.
    pub fn factorise(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> bool {
        dispatch!(self.sizes(), |d| factorise(d, self, damping, input_damping, factor))
    }

    /// Solves the system with the `damping` of the factorisation, refining until the residual stops shrinking: at most
    /// as often as given, and not once the residual is below the given share of the right-hand side.
    pub fn solve_into(
        &self,
        factor: &Factor,
        rhs: &Rhs,
        damping: (f64, f64),
        refinements: (usize, f64),
        work: &mut SolveWorkspace,
        step: &mut NewtonStep,
    ) {
        dispatch!(self.sizes(), |d| solve(d, self, factor, rhs, damping, refinements, work, step));
    }

    /// Adds J_k' diag(`sigma`) J_k to H_k for the rows J_k of panel k of `jacobian`, one for each actuated joint. `scaled` is memory for
    /// one such panel.
    pub(crate) fn add_products(
        &mut self,
        k: usize,
        jacobian: &Slab<Knots>,
        sigma: &[f64],
        scaled: &mut Slab<Knots>,
    ) {
        let (row, knot) = (self.hessian.stride(), self.sizes().knot());
        let (jacobian, hessian, scaled) = (jacobian.panel(k), self.hessian.panel_mut(k), scaled.panel_mut(0));
        dispatch!(self.dynamics.sizes(), |d| {
            add_products(d, jacobian, sigma, hessian, scaled);
            mirror(d, hessian, row, knot);
        });
    }
}

kernels! {
    /// H += J' diag(`sigma`) J in the lower triangle of the symmetric panel `hessian` over z, for the rows of `jacobian`, one for each
    /// actuated joint. `scaled` is memory of the size of `jacobian`.
    pub(crate) fn add_products(
        d: D,
        jacobian: &[f64],
        sigma: &[f64],
        hessian: &mut [f64],
        scaled: &mut [f64],
    ) {
        let (actuated, row) = (d.actuated(), d.knot_row());
        let (jacobian, scaled) = (&jacobian[..actuated * row], &mut scaled[..actuated * row]);
        for i in 0..actuated {
            for j in 0..row {
                scaled[i * row + j] = sigma[i] * jacobian[i * row + j];
            }
        }
        update_lower(d, hessian, row, d.knot(), actuated, scaled, row, jacobian, row);
    }

    /// Adds to `left` what the constraints contribute to the conditions of a solution: their multipliers' forces
    /// on z and t, and their residuals at z and t.
    pub(crate) fn add_constraints(d: D, kkt: &Kkt, step: &NewtonStep, left: &mut Rhs) {
        let (state, state_row, row) = (d.state(), d.state_row(), d.knot_row());
        let dense = d.unactuated() * row;
        let n = kkt.intervals();
        let half_h = 0.5 * kkt.h;
        let (f, rows) = (kkt.dynamics.f.as_slice(), kkt.dynamics.rows.as_slice());
        let (z, lambda) = (step.z.as_slice(), step.lambda.as_slice());
        let g = left.g.as_mut_slice();
        for k in 0..=n {
            // Multipliers of the intervals on both sides.
            let mut sum = [0.0; LARGEST_STATE];
            let sum = &mut sum[..state_row];
            let g = &mut g[k * row..][..row];
            if k < n {
                let lambda = &lambda[k * state_row..][..state_row];
                for i in 0..state {
                    sum[i] += lambda[i];
                    g[i] -= lambda[i];
                }
            }
            if k > 0 {
                let lambda = &lambda[(k - 1) * state_row..][..state_row];
                for i in 0..state {
                    sum[i] += lambda[i];
                    g[i] += lambda[i];
                }
            }
            let mut on_z = [0.0; LARGEST_KNOT];
            let on_z = &mut on_z[..row];
            apply_transposed(d, &rows[k * dense..][..dense], sum, on_z);
            for i in 0..row {
                g[i] -= on_z[i] * half_h;
            }
            left.g_t -= dot(sum, &f[k * state_row..][..state_row]) / (2.0 * n as f64);
        }
        for (target, m) in kkt.target.iter().zip(&step.lambda_target) {
            shift_add(&mut g[n * row..][..state], *m, &target.coefficients);
        }
        let (mut near, mut far) = ([0.0; LARGEST_STATE], [0.0; LARGEST_STATE]);
        apply(d, rows, &z[..row], &mut near);
        let share = step.t / (2.0 * n as f64);
        let defects = left.defects.as_mut_slice();
        for k in 0..n {
            let (z, next) = (&z[k * row..][..row], &z[(k + 1) * row..][..row]);
            apply(d, &rows[(k + 1) * dense..][..dense], next, &mut far);
            let (f, f_next) = (&f[k * state_row..][..state_row], &f[(k + 1) * state_row..][..state_row]);
            let defects = &mut defects[k * state_row..][..state_row];
            for i in 0..state {
                defects[i] += next[i] - z[i] - (near[i] + far[i]) * half_h - (f[i] + f_next[i]) * share;
            }
            near = far;
        }
        for i in 0..state {
            left.start[i] -= z[i];
        }
        for (l, target) in left.target.iter_mut().zip(&kkt.target) {
            *l += dot(&target.coefficients, &z[n * row..]);
        }
        // The multiplier of the start state is not computed: nothing needs it.
        g[..state].fill(0.0);
    }

    /// Residual of the linear system at `step`, with the damping of the factorisation, into `left`, and its largest absolute value.
    fn residual(
        d: D,
        kkt: &Kkt,
        rhs: &Rhs,
        step: &NewtonStep,
        damping: (f64, f64),
        left: &mut Rhs,
    ) -> f64 {
        let (actuated, state, knot, row) = (d.actuated(), d.state(), d.knot(), d.knot_row());
        left.copy_from(rhs);
        left.g_t += (kkt.t_t + damping.0) * step.t;
        let (z, g) = (step.z.as_slice(), left.g.as_mut_slice());
        let Products { diagonal, jacobian, sigma } = &kkt.products;
        for k in 0..=kkt.intervals() {
            let (z, g) = (&z[k * row..][..row], &mut g[k * row..][..row]);
            if let Some(hessian) = kkt.hessian.as_slice().get(k * knot * row..(k + 1) * knot * row) {
                combine(g, knot, z, 1, hessian, row);
            }
            if let Some(sigma) = sigma.get(k * actuated..(k + 1) * actuated) {
                let jacobian = &jacobian.as_slice()[k * actuated * row..][..actuated * row];
                let mut pull = [0.0; MOST_JOINTS];
                for i in 0..actuated {
                    pull[i] = sigma[i] * dot(&jacobian[i * row..][..row], z);
                }
                combine(g, actuated, &pull, 1, jacobian, row);
                let diagonal = &diagonal.as_slice()[k * row..][..row];
                for i in 0..row {
                    g[i] += diagonal[i] * z[i];
                }
            }
            let with_t = &kkt.with_t.as_slice()[k * row..][..row];
            shift_add(g, step.t, with_t);
            for i in 0..knot {
                g[i] += z[i] * if i < state { damping.0 } else { damping.1 };
            }
            left.g_t += dot(with_t, z);
        }
        add_constraints(d, kkt, step, left);
        left.norm()
    }
}

/// dz and dt of the solution, without its multipliers; `step` keeps those that it has. No refinement.
pub(crate) fn predict<D: Registers>(
    d: D,
    kkt: &Kkt,
    factor: &Factor,
    rhs: &Rhs,
    work: &mut SolveWorkspace,
    step: &mut NewtonStep,
) {
    sweep::solve(d, kkt, factor, rhs, Pass::Predictor, &mut work.sweep, step);
}

/// The solution for the defects of the last [`predict`] and another gradient. No refinement.
pub(crate) fn correct<D: Registers>(
    d: D,
    kkt: &Kkt,
    factor: &Factor,
    rhs: &Rhs,
    work: &mut SolveWorkspace,
    step: &mut NewtonStep,
) {
    sweep::solve(d, kkt, factor, rhs, Pass::Corrector, &mut work.sweep, step);
}

/// [`Kkt::solve_into`]
pub(crate) fn solve<D: Registers>(
    d: D,
    kkt: &Kkt,
    factor: &Factor,
    rhs: &Rhs,
    damping: (f64, f64),
    (refinements, accuracy): (usize, f64),
    work: &mut SolveWorkspace,
    step: &mut NewtonStep,
) {
    let SolveWorkspace { sweep, left, next_left, correction, refined } = work;
    sweep::solve(d, kkt, factor, rhs, Pass::Whole, sweep, step);
    if refinements == 0 {
        return;
    }
    let mut norm = residual(d, kkt, rhs, step, damping, left);
    let scale = rhs.norm().max(1e-300);
    for _ in 0..refinements {
        if norm <= accuracy * scale {
            break;
        }
        sweep::solve(d, kkt, factor, left, Pass::Whole, sweep, correction);
        refined.copy_from(step);
        refined.add_scaled(1.0, correction);
        let next_norm = residual(d, kkt, rhs, refined, damping, next_left);
        // A NaN also ends the loop.
        if !(next_norm < norm) {
            break;
        }
        step.copy_from(refined);
        std::mem::swap(left, next_left);
        norm = next_norm;
    }
}
