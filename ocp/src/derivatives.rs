//! Values and derivatives at the knots of a trajectory, several knots side by side: half the time of one knot after the other, and the same
//! bits.

use crate::kkt::Dynamics;
use crate::problem::{Problem, TorqueConstraint};
use upswing_model::{
    ActuatedVector, Dims, HybridValues, LARGEST_STATE, Lanes, Linearization, MOST_JOINTS, Sizes, State,
    Workspace,
};

/// Number of knots side by side.
pub(crate) const LANES: usize = 4;

type Number = Lanes<LANES>;

/// Values and derivatives of dynamics and constrained torque at up to [`LANES`] knots, one in each lane, and memory for them.
pub(crate) struct KnotDerivatives {
    sizes: Sizes,
    x: [Number; LARGEST_STATE],
    u: [Number; MOST_JOINTS],
    /// Factors of qdd_U and of the torque in the second derivatives.
    w: [Number; MOST_JOINTS],
    mu: [Number; MOST_JOINTS],
    work: Workspace<Number>,
    values: HybridValues<Number>,
    dynamics: Linearization<Number>,
    /// Of (11) where that is the constraint.
    constraint: Option<Linearization<Number>>,
    hessian: Vec<Number>,
    constraint_hessian: Vec<Number>,
}

impl KnotDerivatives {
    /// Memory for the derivatives of a problem.
    pub(crate) fn new(problem: &Problem<'_>) -> Self {
        let (sizes, zero) = (problem.sizes(), Lanes([0.0; LANES]));
        let hessian = vec![zero; sizes.knot() * sizes.knot_row()];
        let (constraint, constraint_hessian) = match problem.torque {
            TorqueConstraint::Exact => (None, Vec::new()),
            TorqueConstraint::WithoutCoriolis { .. } => (Some(Linearization::new(sizes)), hessian.clone()),
        };
        Self {
            sizes,
            x: [zero; LARGEST_STATE],
            u: [zero; MOST_JOINTS],
            w: [zero; MOST_JOINTS],
            mu: [zero; MOST_JOINTS],
            work: Workspace::default(),
            values: HybridValues::ZERO,
            dynamics: Linearization::new(sizes),
            constraint,
            hessian,
            constraint_hessian,
        }
    }

    /// Sets the point of a lane.
    pub(crate) fn set_point(&mut self, lane: usize, x: &[f64], u: &[f64]) {
        put(lane, x, &mut self.x);
        put(lane, u, &mut self.u);
    }

    /// Sets the factors of qdd_U and of the torque in the second derivatives of a lane.
    pub(crate) fn set_multipliers(
        &mut self,
        lane: usize,
        w: impl Iterator<Item = f64>,
        mu: impl Iterator<Item = f64>,
    ) {
        self.w.iter_mut().zip(w).for_each(|(out, w)| out.0[lane] = w);
        self.mu.iter_mut().zip(mu).for_each(|(out, mu)| out.0[lane] = mu);
    }

    /// Calls `visit` with qdd_U and the constrained torque of `count` knots, in order: with the number of the knot, the values, and the lane
    /// that holds them. `point` gives the state and the input of a knot.
    pub(crate) fn evaluate_all<'p>(
        &mut self,
        problem: &Problem<'_>,
        count: usize,
        point: impl Fn(usize) -> (&'p [f64], &'p [f64]),
        mut visit: impl FnMut(usize, &HybridValues<Number>, usize),
    ) {
        let sizes = self.sizes;
        let mut work = match problem.torque {
            TorqueConstraint::Exact => None,
            TorqueConstraint::WithoutCoriolis { .. } => Some(Workspace::default()),
        };
        for first in (0..count).step_by(LANES) {
            for lane in 0..LANES {
                // Lanes that are left over repeat the last knot.
                let (x, u) = point((first + lane).min(count - 1));
                self.set_point(lane, x, u);
            }
            let (x, u) = (&self.x[..sizes.state()], &self.u[..sizes.actuated()]);
            problem.model.hybrid_dynamics_of(x, u, &mut self.work, &mut self.values);
            for (lane, k) in (first..count).take(LANES).enumerate() {
                if let Some(work) = &mut work {
                    let (x, u) = point(k);
                    let (x, u) = (State::from_fn(sizes, |i| x[i]), ActuatedVector::from_fn(sizes, |i| u[i]));
                    let tau = problem.model.torque_without_coriolis(&x, &u, work);
                    put(lane, &tau, &mut self.values.tau);
                }
                visit(k, &self.values, lane);
            }
        }
    }

    /// First derivatives at the points.
    pub(crate) fn linearise(&mut self, problem: &Problem<'_>) {
        let (x, u) = (&self.x[..self.sizes.state()], &self.u[..self.sizes.actuated()]);
        problem.model.linearize(x, u, &mut self.work, &mut self.dynamics);
        if let Some(constraint) = &mut self.constraint {
            problem.model.linearize_without_coriolis(x, u, &mut self.work, constraint);
        }
    }

    /// First derivatives at the points, and second derivatives of `w` . qdd_U + `mu` . tau.
    pub(crate) fn linearise_twice(&mut self, problem: &Problem<'_>) {
        let Self { work, dynamics, constraint, hessian, constraint_hessian, .. } = self;
        let (x, u) = (&self.x[..self.sizes.state()], &self.u[..self.sizes.actuated()]);
        problem.model.linearize(x, u, work, dynamics);
        let Some(constraint) = constraint else {
            return problem.model.hessian(&self.w, &self.mu, dynamics, work, hessian);
        };
        let no_torque = [Lanes([0.0; LANES]); MOST_JOINTS];
        problem.model.hessian(&self.w, &no_torque, dynamics, work, hessian);
        problem.model.linearize_without_coriolis(x, u, work, constraint);
        problem.model.hessian_without_coriolis(&self.mu, constraint, work, constraint_hessian);
        hessian.iter_mut().zip(constraint_hessian).for_each(|(h, of_torque)| *h += *of_torque);
    }

    /// Writes A_k, B_k and f_k of a lane to knot `k`.
    pub(crate) fn write_dynamics(&self, lane: usize, k: usize, dynamics: &mut Dynamics) {
        let (joints, actuated) = (self.sizes.joints(), self.sizes.actuated());
        for c in 0..self.sizes.unactuated() {
            take(lane, self.dynamics.qdd_u(c), dynamics.rows.row_mut(k, c));
        }
        // f = [qd, u, qdd_U]
        let (qd, qdd) = dynamics.f.vector_mut(k).split_at_mut(joints);
        let (qdd_a, qdd_u) = qdd.split_at_mut(actuated);
        take(lane, &self.x[joints..], qd);
        take(lane, &self.u, qdd_a);
        take(lane, self.dynamics.qdd_u_values(), qdd_u);
    }

    /// Derivatives of the torque that the constraint bounds.
    fn torque(&self) -> &Linearization<Number> {
        self.constraint.as_ref().unwrap_or(&self.dynamics)
    }

    /// The constrained torque of a lane.
    pub(crate) fn tau(&self, lane: usize) -> ActuatedVector {
        ActuatedVector::from_fn(self.sizes, |a| self.torque().tau_values()[a].0[lane])
    }

    /// Writes d tau / dz of motor `a` of a lane.
    pub(crate) fn write_torque_row(&self, lane: usize, a: usize, row: &mut [f64]) {
        take(lane, self.torque().tau(a), row);
    }

    /// Writes the second derivatives of a lane: rows of the length [`Dims::knot_row`].
    pub(crate) fn write_hessian(&self, lane: usize, h: &mut [f64]) {
        take(lane, &self.hessian, h);
    }
}

/// Puts `values` into a lane.
fn put(lane: usize, values: &[f64], out: &mut [Number]) {
    out.iter_mut().zip(values).for_each(|(out, v)| out.0[lane] = *v);
}

/// Takes the values of a lane, as many as `out` has.
fn take(lane: usize, values: &[Number], out: &mut [f64]) {
    out.iter_mut().zip(values).for_each(|(out, v)| *out = v.0[lane]);
}
