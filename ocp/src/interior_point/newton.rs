//! The linear system of an iteration, its factorisation and the step that it gives.

use super::{NlpSolver, Residuals, Scalar};
use crate::fixed::{ActuatedVector, N_UNACTUATED, NU, NX, NZ, State, vector};
use crate::fixed_kkt::{
    Factor, Kkt, KnotDynamics, KnotMatrix, KnotParts, KnotVector, NewtonStep, Rhs, SolveWorkspace,
};
use crate::kkt::{Dynamics, TargetRow};
use nalgebra::SMatrix;
use upswing_model::{Dims, Sizes};

/// Of the linear solves: each refinement gains several digits; more than this many means there is nothing left to
/// gain, and so does a residual this small against the right-hand side.
const REFINEMENTS: usize = 8;
const ACCURACY: f64 = 1e-12;

/// Inputs are ten times larger than angles and velocities: their damping is smaller by the square of it.
const INPUT_DAMPING: f64 = 1e-2;

/// Gradients of the torques tau_k with respect to z_k in units of the slacks, one column for each motor.
type TorqueGradients = SMatrix<f64, NZ, NU>;

/// Full primal-dual step.
pub(super) struct Direction {
    pub(super) step: NewtonStep,
    /// Damping of the factorisation that gave it.
    pub(super) damping: f64,
    pub(super) s: Vec<ActuatedVector>,
    /// Step of lambda_torque.
    pub(super) lambda_torque: Vec<ActuatedVector>,
    pub(super) bound_x: Vec<(State, State)>,
    pub(super) bound_s: Vec<(ActuatedVector, ActuatedVector)>,
    pub(super) bound_t: (Scalar, Scalar),
    /// Largest fractions to the boundary.
    pub(super) alpha: (f64, f64),
}

/// The linear system of an iteration and the memory to solve it, made once.
pub(super) struct LinearSystem {
    pub(super) kkt: Kkt,
    dynamics: Dynamics,
    pub(super) torque: Vec<TorqueGradients>,
    pub(super) factor: Factor,
    pub(super) rhs: Rhs,
    pub(super) work: SolveWorkspace,
}

impl LinearSystem {
    pub(super) fn new(sizes: Sizes, target: &[TargetRow], n: usize) -> Self {
        let kkt = Kkt {
            h: 0.0,
            hessian: vec![KnotMatrix::zeros(); n + 1],
            with_t: vec![KnotVector::zeros(); n + 1],
            t_t: 0.0,
            dynamics: vec![KnotDynamics::zeros(); n + 1],
            target: target.to_vec(),
        };
        let rhs = kkt.zero_rhs();
        let work = SolveWorkspace::new(n, target.len());
        let dynamics = Dynamics::zeros(sizes, n);
        Self {
            kkt,
            dynamics,
            torque: vec![TorqueGradients::zeros(); n + 1],
            factor: Factor::new(n),
            rhs,
            work,
        }
    }
}

impl NlpSolver<'_> {
    /// Multiplier sum w_k = lambda_{k-1} + lambda_k of the defects at knot k.
    pub(super) fn defect_multiplier(&self, k: usize) -> State {
        let mut w = State::zeros();
        if k > 0 {
            w += self.lambda[k - 1];
        }
        if k < self.primal.intervals() {
            w += self.lambda[k];
        }
        w
    }

    /// Sets the matrix (without barrier and torque terms) and the torques' gradients to those of the current point.
    pub(super) fn linearise(&mut self, linear: &mut LinearSystem) {
        let (h, n) = (self.primal.h(), self.primal.intervals());
        let r = self.problem.input_weight;
        let sizes = self.problem.sizes();
        let kkt = &mut linear.kkt;
        kkt.h = h;
        kkt.t_t = 0.0;
        for k in 0..=n {
            let (x, u) = self.primal.knot(sizes, k);
            let w = self.defect_multiplier(k);
            let w_u =
                upswing_model::UnactuatedVector::from_fn(sizes, |i| w[NX - N_UNACTUATED + i] * (-0.5 * h));
            let mu = self.lambda_torque[k].component_div(&self.torque_half);
            let mu = upswing_model::ActuatedVector::from_fn(sizes, |i| mu[i]);
            let (derivatives, hessian) = (&mut self.derivatives, &mut self.hessian);
            self.problem.knot_derivatives(&x, &u, &w_u, &mu, &mut self.work, derivatives, hessian);
            let rows = hessian.chunks_exact(sizes.knot_row());
            // Symmetric: rows are columns.
            let columns = kkt.hessian[k].as_mut_slice().chunks_exact_mut(NZ);
            columns.zip(rows).for_each(|(column, row)| column.copy_from_slice(&row[..NZ]));
            linear.dynamics.set(k, &derivatives.dynamics, &x, &u);
            kkt.dynamics[k] = KnotDynamics::of(&linear.dynamics, k);
            let with_t = &mut kkt.with_t[k];
            *with_t = kkt.dynamics[k].apply_transposed(&w) * (-0.5 / n as f64);
            for i in 0..NU {
                kkt.hessian[k][(NX + i, NX + i)] += h * r;
                with_t[NX + i] += r * u[i] / n as f64;
                let tau = derivatives.torque().tau(i);
                linear.torque[k].set_column(i, &(vector::<NZ>(tau) / self.torque_half[i]));
            }
        }
    }

    /// Gradient of the objective: with respect to z_k into `g`; that with respect to t_F is returned.
    pub(super) fn objective_gradient(&self, g: &mut [KnotVector]) -> f64 {
        let (h, r) = (self.primal.h(), self.problem.input_weight);
        for (g, u) in g.iter_mut().zip(self.primal.u.iter()) {
            g.fill(0.0);
            g.u_mut().copy_from(&(u * (h * r)));
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
        linear.kkt.t_t += self.bound_t.sigma(&Scalar::new(self.primal.t))[0];
        for k in 0..self.primal.x.len() {
            let hessian = &mut linear.kkt.hessian[k];
            if k > 0 {
                let sigma = self.bound_x[k - 1].sigma(&self.primal.x[k]);
                for i in 0..NX {
                    hessian[(i, i)] += sigma[i];
                }
            }
            let sigma = self.bound_s[k].sigma(&self.primal.s[k]);
            for (gradient, sigma) in linear.torque[k].column_iter().zip(&sigma) {
                hessian.ger(*sigma, &gradient, &gradient, 1.0);
            }
        }
    }

    fn right_hand_side(&self, linear: &mut LinearSystem, c: &Residuals) {
        let rhs = &mut linear.rhs;
        rhs.g_t = self.objective_gradient(&mut rhs.g)
            + self.bound_t.gradient(&Scalar::new(self.primal.t), self.mu)[0];
        rhs.defects.copy_from_slice(&c.defects);
        rhs.target.copy_from_slice(&c.target);
        for k in 0..self.primal.x.len() {
            if k > 0 {
                let barrier = self.bound_x[k - 1].gradient(&self.primal.x[k], self.mu);
                for i in 0..NX {
                    rhs.g[k][i] += barrier[i];
                }
            }
            let sigma = self.bound_s[k].sigma(&self.primal.s[k]);
            let pull =
                sigma.component_mul(&c.torque[k]) + self.bound_s[k].gradient(&self.primal.s[k], self.mu);
            rhs.g[k] += linear.torque[k] * pull;
        }
    }

    /// The step for the constraint residuals `c`; needs the factorised matrix.
    pub(super) fn direction(&self, linear: &mut LinearSystem, damping: f64, c: &Residuals) -> Direction {
        self.right_hand_side(linear, c);
        let LinearSystem { kkt, torque, factor, rhs, work, .. } = linear;
        let n = self.primal.intervals();
        let mut step = NewtonStep::zeros(n, kkt.target.len());
        kkt.solve_into(
            factor,
            rhs,
            (damping, damping * INPUT_DAMPING),
            (REFINEMENTS, ACCURACY),
            work,
            &mut step,
        );
        let share = (1.0 - self.mu).max(0.99);
        let mut alpha = (1.0_f64, 1.0_f64);
        let mut shorten = |a: (f64, f64)| alpha = (alpha.0.min(a.0), alpha.1.min(a.1));
        let (mut s, mut lambda_torque) = (Vec::with_capacity(n + 1), Vec::with_capacity(n + 1));
        let (mut bound_x, mut bound_s) = (Vec::with_capacity(n), Vec::with_capacity(n + 1));
        for k in 0..self.primal.x.len() {
            let (b, v) = (&self.bound_s[k], &self.primal.s[k]);
            let ds = torque[k].tr_mul(&step.z[k]) + c.torque[k];
            let new_lambda = b.sigma(v).component_mul(&ds) + b.gradient(v, self.mu);
            let dz = b.dual_step(v, &ds, self.mu);
            shorten(b.to_boundary(v, &ds, &dz, share));
            lambda_torque.push(new_lambda - self.lambda_torque[k]);
            s.push(ds);
            bound_s.push(dz);
            if k > 0 {
                let (b, v) = (&self.bound_x[k - 1], &self.primal.x[k]);
                let dx: State = step.z[k].x().into();
                let dz = b.dual_step(v, &dx, self.mu);
                shorten(b.to_boundary(v, &dx, &dz, share));
                bound_x.push(dz);
            }
        }
        let (t, dt) = (Scalar::new(self.primal.t), Scalar::new(step.t));
        let bound_t = self.bound_t.dual_step(&t, &dt, self.mu);
        shorten(self.bound_t.to_boundary(&t, &dt, &bound_t, share));
        Direction { step, s, lambda_torque, damping, bound_x, bound_s, bound_t, alpha }
    }

    /// Factorises with as little damping as gives the right inertia, at least `least`: that damping.
    pub(super) fn factor(&mut self, linear: &mut LinearSystem, least: f64) -> Option<f64> {
        const FIRST: f64 = 1e-4;
        const MOST: f64 = 1e10;
        let mut damping = least;
        loop {
            if linear.kkt.factor_into(damping, damping * INPUT_DAMPING, &mut linear.factor) {
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
