//! How far an iterate is from the conditions of an optimum, and which limit is in its way.

use super::newton::LinearSystem;
use super::{BoundedVector, Limit, NlpSolver, part};
use crate::kernels::dot;
use crate::kkt::Kkt;
use crate::slab::KnotVector;
use upswing_model::LimitKind;

/// Multipliers up to this mean size leave the residuals unscaled.
const S_MAX: f64 = 100.0;

impl NlpSolver<'_> {
    /// Largest residual of the stationarity conditions, scaled by the size of the multipliers.
    pub(super) fn stationarity(&self, linear: &mut LinearSystem) -> f64 {
        let LinearSystem { kkt, torque, rhs, .. } = linear;
        let Kkt { h, dynamics, target, .. } = kkt;
        let (n, sizes) = (self.primal.intervals(), self.primal.sizes);
        let (state, actuated) = (sizes.state(), sizes.actuated());
        let g_t = self.objective_gradient(&mut rhs.g);
        let mut on_t = g_t - self.bound_t.z_lower[0] + self.bound_t.z_upper[0];
        let mut worst = 0.0_f64;
        let mut by_defects = KnotVector::zeros(sizes);
        for k in 0..=n {
            let w = self.on_knots.vector(k);
            on_t -= dot(w, dynamics.f.vector(k)) * (0.5 / n as f64);
            dynamics.apply_transposed(k, w, &mut by_defects);
            torque.add_transposed_times(k, part(&self.lambda_torque, k, actuated), rhs.g.vector_mut(k));
            let g = rhs.g.vector_mut(k);
            for (g, by_defects) in g.iter_mut().zip(by_defects.iter()) {
                *g -= by_defects * (0.5 * *h);
            }
            if k == 0 {
                // x_0 is given: only u_0 has a condition.
                g[..state].fill(0.0);
            } else {
                let before = self.lambda.vector(k - 1);
                let (lower, upper) =
                    (part(&self.bound_x.z_lower, k - 1, state), part(&self.bound_x.z_upper, k - 1, state));
                for i in 0..state {
                    g[i] += before[i] + upper[i] - lower[i];
                }
                if k < n {
                    let after = self.lambda.vector(k);
                    (0..state).for_each(|i| g[i] -= after[i]);
                } else {
                    for (row, m) in target.iter().zip(&self.lambda_target) {
                        (0..state).for_each(|i| g[i] += row.coefficients[i] * m);
                    }
                }
            }
            worst = g.iter().fold(worst, |worst, g| worst.max(g.abs()));
        }
        let b = &self.bound_s;
        for (i, lambda) in self.lambda_torque.iter().enumerate() {
            worst = worst.max((-lambda - b.z_lower[i] + b.z_upper[i]).abs());
        }
        let sum = |v: &[f64]| v.iter().map(|v| v.abs()).sum::<f64>();
        let equalities = sum(&self.lambda_torque) + sum(self.lambda.as_slice());
        let count = 1.5 * self.bounds();
        worst.max(on_t.abs()) / ((self.multiplier_sum() + equalities) / count).max(S_MAX) * S_MAX
    }

    /// Largest |z gap - mu| of all bounds, scaled by the size of their multipliers.
    pub(super) fn complementarity(&self, mu: f64) -> f64 {
        let t = self.bound_t.complementarity(&[self.primal.t], mu);
        let x = self.bound_x.complementarity(self.primal.free_x(), mu);
        let s = self.bound_s.complementarity(&self.primal.s, mu);
        t.max(x).max(s) / (self.multiplier_sum() / self.bounds()).max(S_MAX) * S_MAX
    }

    /// Number of bounds of states and slacks.
    fn bounds(&self) -> f64 {
        (2 * (self.bound_x.len() + self.bound_s.len())) as f64
    }

    /// Sum of the multipliers of the bounds of states and slacks.
    fn multiplier_sum(&self) -> f64 {
        self.bound_x.multiplier_sum() + self.bound_s.multiplier_sum()
    }

    /// The limit with the largest multiplier, as a share of its range: at a point where the constraints contradict
    /// each other it is the one that yields most if it is moved.
    pub(super) fn blocking_limit(&self) -> Limit {
        let h = self.primal.h();
        let mut worst = (0.0, Limit { kind: LimitKind::Position, joint: 0, time: 0.0 });
        let mut consider = |pull: f64, kind, joint, knot: usize| {
            if pull > worst.0 {
                worst = (pull, Limit { kind, joint, time: knot as f64 * h });
            }
        };
        let sizes = self.primal.sizes;
        let pull = |b: &BoundedVector, i: usize| b.z_lower[i].max(b.z_upper[i]) * (b.upper[i] - b.lower[i]);
        for i in 0..self.bound_x.len() {
            let (kind, joint) = LimitKind::of_row(i % sizes.state(), sizes);
            consider(pull(&self.bound_x, i), kind, joint, 1 + i / sizes.state());
        }
        for i in 0..self.bound_s.len() {
            let (knot, joint) = (i / sizes.actuated(), i % sizes.actuated());
            consider(pull(&self.bound_s, i), LimitKind::Torque, joint, knot);
        }
        worst.1
    }
}
