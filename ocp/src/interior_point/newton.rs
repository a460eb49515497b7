//! The linear system of an iteration, its factorisation and the step that it gives.

use super::bounded::DualStep;
use super::{BoundedVector, NlpSolver, Residuals, part};
use crate::derivatives::LANES;
use crate::kernels::shift_add;
use crate::kkt::{Factor, Kkt, NewtonStep, Rhs, SolveWorkspace, TargetRow};
use crate::slab::{Knots, Slab};
use upswing_model::{Sizes, States};

/// Of the linear solves: each refinement gains several digits; more than this many means there is nothing left to
/// gain, and so does a residual this small against the right-hand side.
const REFINEMENTS: usize = 8;
const ACCURACY: f64 = 1e-12;

/// Inputs are ten times larger than angles and velocities: their damping is smaller by the square of it.
const INPUT_DAMPING: f64 = 1e-2;

/// Full primal-dual step: entries of all knots, as in the iterate.
pub(super) struct Direction {
    sizes: Sizes,
    pub(super) t: f64,
    pub(super) x: Vec<f64>,
    pub(super) u: Vec<f64>,
    pub(super) s: Vec<f64>,
    /// Multipliers after a full step.
    pub(super) lambda: Slab<States>,
    pub(super) lambda_target: Vec<f64>,
    pub(super) lambda_torque: Vec<f64>,
    pub(super) bound_x: DualStep,
    pub(super) bound_s: DualStep,
    pub(super) bound_t: DualStep,
    /// Largest fractions to the boundary.
    pub(super) alpha: (f64, f64),
    /// Damping of the factorisation that gave it.
    pub(super) damping: f64,
}

impl Direction {
    /// The step of x_1..x_N.
    pub(super) fn free_x(&self) -> &[f64] {
        &self.x[self.sizes.state()..]
    }
}

/// The linear system of an iteration and the memory to solve it, made once.
pub(super) struct LinearSystem {
    pub(super) kkt: Kkt,
    /// Jacobians of the torques tau_k with respect to z_k in units of the slacks.
    pub(super) torque: Slab<Knots>,
    /// Memory for one of them.
    scaled: Slab<Knots>,
    pub(super) factor: Factor,
    pub(super) rhs: Rhs,
    pub(super) work: SolveWorkspace,
}

impl LinearSystem {
    pub(super) fn new(sizes: Sizes, target: &[TargetRow], n: usize) -> Self {
        let kkt = Kkt::zeros(sizes, n, target);
        Self {
            rhs: kkt.zero_rhs(),
            kkt,
            torque: Slab::zeros(sizes, n + 1, sizes.actuated()),
            scaled: Slab::zeros(sizes, 1, sizes.actuated()),
            factor: Factor::new(sizes, n),
            work: SolveWorkspace::new(sizes, n, target.len()),
        }
    }
}

impl NlpSolver<'_> {
    /// Sums the multipliers of the defects on both sides of each knot.
    fn sum_multipliers(&mut self) {
        let (lambda, row) = (self.lambda.as_slice(), self.lambda.stride());
        let sums = self.on_knots.as_mut_slice();
        let last = sums.len() - row;
        sums[..last].copy_from_slice(lambda);
        sums[last..].fill(0.0);
        shift_add(&mut sums[row..], 1.0, lambda);
    }

    /// Sets the matrix (without barrier and torque terms) and the torques' Jacobians to those of the current point.
    pub(super) fn linearise(&mut self, linear: &mut LinearSystem) {
        self.sum_multipliers();
        let (h, n, sizes) = (self.primal.h(), self.primal.intervals(), self.primal.sizes);
        let (state, actuated) = (sizes.state(), sizes.actuated());
        let r = self.problem.input_weight;
        let Kkt { hessian, with_t, dynamics, .. } = &mut linear.kkt;
        for first in (0..=n).step_by(LANES) {
            for lane in 0..LANES {
                // Lanes that are left over repeat the last knot.
                let k = (first + lane).min(n);
                let on_qdd_u = &self.on_knots.vector(k)[sizes.joints() + actuated..];
                let lambda = part(&self.lambda_torque, k, actuated);
                self.derivatives.set_point(
                    lane,
                    part(&self.primal.x, k, state),
                    part(&self.primal.u, k, actuated),
                );
                self.derivatives.set_multipliers(
                    lane,
                    on_qdd_u.iter().map(|w| w * (-0.5 * h)),
                    lambda.iter().zip(self.torque_half.iter()).map(|(lambda, half)| lambda / half),
                );
            }
            self.derivatives.linearise_twice(self.problem);
            for (lane, k) in (first..=n).take(LANES).enumerate() {
                self.derivatives.write_hessian(lane, hessian.panel_mut(k));
                self.derivatives.write_dynamics(lane, k, dynamics);
                for i in 0..actuated {
                    let row = linear.torque.row_mut(k, i);
                    self.derivatives.write_torque_row(lane, i, row);
                    row.iter_mut().for_each(|v| *v /= self.torque_half[i]);
                }
            }
        }
        for k in 0..=n {
            let with_t = with_t.vector_mut(k);
            dynamics.apply_transposed(k, self.on_knots.vector(k), with_t);
            with_t.iter_mut().for_each(|v| *v *= -0.5 / n as f64);
            let u = part(&self.primal.u, k, actuated);
            for i in 0..actuated {
                hessian.row_mut(k, state + i)[state + i] += h * r;
                with_t[state + i] += r * u[i] / n as f64;
            }
        }
        linear.kkt.h = h;
        linear.kkt.t_t = 0.0;
    }

    /// Gradient of the objective: with respect to z_k into `g`; that with respect to t_F is returned.
    pub(super) fn objective_gradient(&self, g: &mut Slab<Knots>) -> f64 {
        let p = &self.primal;
        let factor = p.h() * self.problem.input_weight;
        g.clear();
        for k in 0..=p.intervals() {
            let u = part(&p.u, k, p.sizes.actuated());
            g.u_mut(k).iter_mut().zip(u).for_each(|(g, u)| *g = u * factor);
        }
        self.objective_on_t()
    }

    /// Derivative of the objective with respect to t_F.
    pub(super) fn objective_on_t(&self) -> f64 {
        let effort = self.primal.effort();
        1.0 + 0.5 * self.problem.input_weight * effort / self.primal.intervals() as f64
    }

    /// Adds barrier and torque terms to the matrix.
    pub(super) fn condense(&self, linear: &mut LinearSystem) {
        let p = &self.primal;
        let (state, actuated) = (p.sizes.state(), p.sizes.actuated());
        linear.kkt.t_t += self.bound_t.sigma(0, p.t);
        for k in 1..=p.intervals() {
            let (first, stride) = ((k - 1) * state, linear.kkt.hessian.stride());
            let panel = linear.kkt.hessian.panel_mut(k);
            for i in 0..state {
                panel[i * stride + i] += self.bound_x.sigma(first + i, p.free_x()[first + i]);
            }
        }
        let sigma: Vec<f64> = p.s.iter().enumerate().map(|(i, s)| self.bound_s.sigma(i, *s)).collect();
        let LinearSystem { kkt, torque, scaled, .. } = linear;
        for k in 0..=p.intervals() {
            kkt.add_products(k, torque, part(&sigma, k, actuated), scaled);
        }
    }

    fn right_hand_side(&self, linear: &mut LinearSystem, c: &Residuals) {
        let LinearSystem { torque, rhs, .. } = linear;
        let p = &self.primal;
        let (state, actuated) = (p.sizes.state(), p.sizes.actuated());
        rhs.g_t = self.objective_gradient(&mut rhs.g) + self.bound_t.gradient(0, p.t, self.mu);
        rhs.defects.copy_from(&c.defects);
        rhs.target.copy_from_slice(&c.target);
        for k in 1..=p.intervals() {
            let (first, g) = ((k - 1) * state, rhs.g.vector_mut(k));
            for i in 0..state {
                g[i] += self.bound_x.gradient(first + i, p.free_x()[first + i], self.mu);
            }
        }
        let b = &self.bound_s;
        let pull = |(i, s): (usize, &f64)| b.sigma(i, *s) * c.torque[i] + b.gradient(i, *s, self.mu);
        let pull: Vec<f64> = p.s.iter().enumerate().map(pull).collect();
        for k in 0..=p.intervals() {
            torque.add_transposed_times(k, part(&pull, k, actuated), rhs.g.vector_mut(k));
        }
    }

    /// The step for the constraint residuals `c`; needs the factorised matrix.
    pub(super) fn direction(&self, linear: &mut LinearSystem, damping: f64, c: &Residuals) -> Direction {
        self.right_hand_side(linear, c);
        let LinearSystem { kkt, torque, factor, rhs, work, .. } = linear;
        let p = &self.primal;
        let (sizes, n) = (p.sizes, p.intervals());
        let mut step = NewtonStep::zeros(sizes, n, kkt.target.len());
        let dampings = (damping, damping * INPUT_DAMPING);
        kkt.solve_into(factor, rhs, dampings, (REFINEMENTS, ACCURACY), work, &mut step);
        let (mut x, mut u, mut s) = (p.x.clone(), p.u.clone(), c.torque.clone());
        for k in 0..=n {
            let (dx, du) = step.z.vector(k).split_at(sizes.state());
            x[k * dx.len()..][..dx.len()].copy_from_slice(dx);
            u[k * du.len()..][..du.len()].copy_from_slice(du);
            torque.add_times(k, step.z.vector(k), &mut s[k * du.len()..][..du.len()]);
        }
        let b = &self.bound_s;
        let multiplier = |i: usize| b.sigma(i, p.s[i]) * s[i] + b.gradient(i, p.s[i], self.mu);
        let lambda_torque = (0..s.len()).map(multiplier).collect();
        let share = (1.0 - self.mu).max(0.99);
        let mut alpha = (1.0_f64, 1.0_f64);
        let mut dual_step = |b: &BoundedVector, v: &[f64], dv: &[f64]| {
            let dz = b.dual_step(v, dv, self.mu);
            let to_boundary = b.to_boundary(v, dv, &dz, share);
            alpha = (alpha.0.min(to_boundary.0), alpha.1.min(to_boundary.1));
            dz
        };
        let bound_x = dual_step(&self.bound_x, p.free_x(), &x[sizes.state()..]);
        let bound_s = dual_step(&self.bound_s, &p.s, &s);
        let bound_t = dual_step(&self.bound_t, &[p.t], &[step.t]);
        let NewtonStep { t, lambda, lambda_target, .. } = step;
        Direction {
            sizes,
            t,
            x,
            u,
            s,
            lambda,
            lambda_target,
            lambda_torque,
            bound_x,
            bound_s,
            bound_t,
            alpha,
            damping,
        }
    }

    /// Factorises with as little damping as gives the right inertia, at least `least`: that damping.
    pub(super) fn factor(&mut self, linear: &mut LinearSystem, least: f64) -> Option<f64> {
        const FIRST: f64 = 1e-4;
        const MOST: f64 = 1e10;
        let mut damping = least;
        if !linear.kkt.change_variables(&mut linear.factor) {
            return None;
        }
        loop {
            if linear.kkt.factorise(damping, damping * INPUT_DAMPING, &mut linear.factor) {
                if damping > 0.0 {
                    self.last_damping = damping;
                }
                return Some(damping);
            }
            damping = if damping == 0.0 {
                if self.last_damping == 0.0 { FIRST } else { (self.last_damping / 3.0).max(1e-12) }
            } else if self.last_damping == 0.0 {
                damping * 100.0
            } else {
                damping * 8.0
            };
            if damping > MOST {
                return None;
            }
        }
    }
}
