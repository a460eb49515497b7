//! How far an iterate is from the conditions of an optimum, and which limit is in its way.

use super::newton::LinearSystem;
use super::{BoundedVector, Limit, NlpSolver, Scalar};
use crate::fixed::{NU, NX};
use crate::fixed_kkt::KnotParts;
use upswing_model::LimitKind;

/// Multipliers up to this mean size leave the residuals unscaled.
const S_MAX: f64 = 100.0;

impl NlpSolver<'_> {
    /// Largest residual of the stationarity conditions, scaled by the size of the multipliers.
    pub(super) fn stationarity(&self, linear: &mut LinearSystem) -> f64 {
        let LinearSystem { kkt, torque, rhs, .. } = linear;
        let g_t = self.objective_gradient(&mut rhs.g);
        let mut worst = 0.0_f64;
        let mut on_t = g_t - self.bound_t.z_lower[0] + self.bound_t.z_upper[0];
        let n = self.primal.intervals();
        for k in 0..=n {
            let w = self.defect_multiplier(k);
            let mut grad = rhs.g[k] - kkt.dynamics[k].apply_transposed(&w) * (0.5 * kkt.h);
            on_t -= w.dot(&kkt.dynamics[k].f) * (0.5 / n as f64);
            for i in 0..NX {
                if k > 0 {
                    grad[i] += self.lambda[k - 1][i];
                }
                if k < n {
                    grad[i] -= self.lambda[k][i];
                }
            }
            if k == n {
                for (row, m) in kkt.target.iter().zip(&self.lambda_target) {
                    for i in 0..NX {
                        grad[i] += row.coefficients[i] * m;
                    }
                }
            }
            grad += torque[k] * self.lambda_torque[k];
            let b = &self.bound_s[k];
            worst = worst.max((-self.lambda_torque[k] - b.z_lower + b.z_upper).amax());
            if k > 0 {
                let b = &self.bound_x[k - 1];
                for i in 0..NX {
                    grad[i] += b.z_upper[i] - b.z_lower[i];
                }
                worst = worst.max(grad.amax());
            } else {
                // x_0 is given: only u_0 has a condition.
                worst = worst.max(grad.u().amax());
            }
        }
        let equalities: f64 = self.lambda_torque.iter().map(|y| y.lp_norm(1)).sum::<f64>()
            + self.lambda.iter().map(|l| l.lp_norm(1)).sum::<f64>();
        let count = 1.5 * self.bounds();
        worst.max(on_t.abs()) / ((self.multiplier_sum() + equalities) / count).max(S_MAX) * S_MAX
    }

    /// Largest |z gap - mu| of all bounds, scaled by the size of their multipliers.
    pub(super) fn complementarity(&self, mu: f64) -> f64 {
        let t = self.bound_t.complementarity(&Scalar::new(self.primal.t), mu);
        let x = self.bound_x.iter().zip(&self.primal.x[1..]).map(|(b, x)| b.complementarity(x, mu));
        let s = self.bound_s.iter().zip(&self.primal.s).map(|(b, s)| b.complementarity(s, mu));
        x.chain(s).fold(t, f64::max) / (self.multiplier_sum() / self.bounds()).max(S_MAX) * S_MAX
    }

    /// Number of bounds of states and slacks.
    fn bounds(&self) -> f64 {
        (2 * (self.bound_x.len() * NX + self.bound_s.len() * NU)) as f64
    }

    /// Sum of the multipliers of the bounds of states and slacks.
    fn multiplier_sum(&self) -> f64 {
        let x: f64 = self.bound_x.iter().map(BoundedVector::multiplier_sum).sum();
        x + self.bound_s.iter().map(BoundedVector::multiplier_sum).sum::<f64>()
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
        for (k, b) in self.bound_x.iter().enumerate() {
            for i in 0..NX {
                let pull = b.z_lower[i].max(b.z_upper[i]) * (b.upper[i] - b.lower[i]);
                let (kind, joint) = LimitKind::of_row(i, self.problem.sizes());
                consider(pull, kind, joint, k + 1);
            }
        }
        for (k, b) in self.bound_s.iter().enumerate() {
            for i in 0..NU {
                let pull = b.z_lower[i].max(b.z_upper[i]) * (b.upper[i] - b.lower[i]);
                consider(pull, LimitKind::Torque, i, k);
            }
        }
        worst.1
    }
}
