//! Bounds with logarithmic barriers.

use nalgebra::SVector;

/// A vector with lower and upper bounds, their multipliers and their steps.
#[derive(Clone, Debug)]
pub(super) struct BoundedVector<const D: usize> {
    pub(super) lower: SVector<f64, D>,
    pub(super) upper: SVector<f64, D>,
    pub(super) z_lower: SVector<f64, D>,
    pub(super) z_upper: SVector<f64, D>,
}

impl<const D: usize> BoundedVector<D> {
    /// Multipliers of a central point; `v` is moved inside by 1 % of the range where needed.
    pub(super) fn new(
        lower: SVector<f64, D>,
        upper: SVector<f64, D>,
        v: &mut SVector<f64, D>,
        barrier: f64,
    ) -> Self {
        for i in 0..D {
            let push = (1e-2 * (upper[i] - lower[i])).min(1e-2 * lower[i].abs().max(1.0));
            v[i] = v[i].clamp(lower[i] + push, upper[i] - push);
        }
        let mut b = Self { lower, upper, z_lower: lower, z_upper: upper };
        b.z_lower = (*v - b.lower).map(|gap| barrier / gap);
        b.z_upper = (b.upper - *v).map(|gap| barrier / gap);
        b
    }

    /// Diagonal of the barrier's second derivative, primal-dual.
    pub(super) fn sigma(&self, v: &SVector<f64, D>) -> SVector<f64, D> {
        self.z_lower.component_div(&(v - self.lower)) + self.z_upper.component_div(&(self.upper - v))
    }

    /// Gradient of the barrier.
    pub(super) fn gradient(&self, v: &SVector<f64, D>, mu: f64) -> SVector<f64, D> {
        SVector::from_fn(|i, _| mu / (self.upper[i] - v[i]) - mu / (v[i] - self.lower[i]))
    }

    /// Value of the barrier; infinite outside the bounds.
    pub(super) fn barrier(&self, v: &SVector<f64, D>, mu: f64) -> f64 {
        /// Logarithms are slow: one is taken of a product of gaps, before that can underflow.
        const SMALL: f64 = 1e-200;
        let (mut sum, mut product) = (0.0, 1.0);
        for i in 0..D {
            let (low, high) = (v[i] - self.lower[i], self.upper[i] - v[i]);
            if !(low > 0.0 && high > 0.0) {
                return f64::INFINITY;
            }
            if product < SMALL {
                sum += f64::ln(product);
                product = 1.0;
            }
            product *= low * high;
        }
        -mu * (sum + product.ln())
    }

    /// Steps of the multipliers that belong to the step `dv`.
    pub(super) fn dual_step(
        &self,
        v: &SVector<f64, D>,
        dv: &SVector<f64, D>,
        mu: f64,
    ) -> (SVector<f64, D>, SVector<f64, D>) {
        let lower = SVector::from_fn(|i, _| {
            let gap = v[i] - self.lower[i];
            mu / gap - self.z_lower[i] - self.z_lower[i] / gap * dv[i]
        });
        let upper = SVector::from_fn(|i, _| {
            let gap = self.upper[i] - v[i];
            mu / gap - self.z_upper[i] + self.z_upper[i] / gap * dv[i]
        });
        (lower, upper)
    }

    /// Largest fractions of the steps that keep `share` of the distance to the bounds: (primal, dual).
    pub(super) fn to_boundary(
        &self,
        v: &SVector<f64, D>,
        dv: &SVector<f64, D>,
        dz: &(SVector<f64, D>, SVector<f64, D>),
        share: f64,
    ) -> (f64, f64) {
        let (mut primal, mut dual) = (1.0_f64, 1.0_f64);
        let limit = |gap: f64, rate: f64| if rate < 0.0 { -share * gap / rate } else { f64::INFINITY };
        for i in 0..D {
            primal = primal.min(limit(v[i] - self.lower[i], dv[i])).min(limit(self.upper[i] - v[i], -dv[i]));
            dual = dual.min(limit(self.z_lower[i], dz.0[i])).min(limit(self.z_upper[i], dz.1[i]));
        }
        (primal, dual)
    }

    /// Moves the multipliers and keeps them near those of a central point.
    pub(super) fn advance(
        &mut self,
        v: &SVector<f64, D>,
        dz: &(SVector<f64, D>, SVector<f64, D>),
        alpha: f64,
        mu: f64,
    ) {
        /// Largest ratio of a multiplier to mu / gap, and its inverse.
        const KAPPA: f64 = 1e10;
        self.z_lower += dz.0 * alpha;
        self.z_upper += dz.1 * alpha;
        for i in 0..D {
            let (low, high) = (mu / (v[i] - self.lower[i]), mu / (self.upper[i] - v[i]));
            self.z_lower[i] = self.z_lower[i].clamp(low / KAPPA, low * KAPPA);
            self.z_upper[i] = self.z_upper[i].clamp(high / KAPPA, high * KAPPA);
        }
    }

    /// Largest |z gap - mu|.
    pub(super) fn complementarity(&self, v: &SVector<f64, D>, mu: f64) -> f64 {
        (0..D)
            .map(|i| {
                let low = (self.z_lower[i] * (v[i] - self.lower[i]) - mu).abs();
                low.max((self.z_upper[i] * (self.upper[i] - v[i]) - mu).abs())
            })
            .fold(0.0, f64::max)
    }

    pub(super) fn multiplier_sum(&self) -> f64 {
        self.z_lower.sum() + self.z_upper.sum()
    }
}
