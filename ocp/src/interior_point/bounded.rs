//! Bounds with logarithmic barriers.

/// A vector with lower and upper bounds, their multipliers and their steps.
#[derive(Clone, Debug)]
pub(super) struct BoundedVector {
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    pub(super) z_lower: Vec<f64>,
    pub(super) z_upper: Vec<f64>,
}

/// Steps of the multipliers of lower and upper bounds.
pub(super) struct DualStep {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl BoundedVector {
    /// Multipliers of a central point; `v` is moved inside by 1 % of the range where needed.
    pub(super) fn new(lower: Vec<f64>, upper: Vec<f64>, v: &mut [f64], mu: f64) -> Self {
        for i in 0..v.len() {
            let push = (1e-2 * (upper[i] - lower[i])).min(1e-2 * lower[i].abs().max(1.0));
            v[i] = v[i].clamp(lower[i] + push, upper[i] - push);
        }
        let z_lower = (0..v.len()).map(|i| mu / (v[i] - lower[i])).collect();
        let z_upper = (0..v.len()).map(|i| mu / (upper[i] - v[i])).collect();
        Self { lower, upper, z_lower, z_upper }
    }

    /// Number of entries.
    pub(super) fn len(&self) -> usize {
        self.lower.len()
    }

    /// Entry i of the diagonal of the barrier's second derivative, primal-dual.
    #[inline(always)]
    pub(super) fn sigma(&self, i: usize, v: f64) -> f64 {
        self.z_lower[i] / (v - self.lower[i]) + self.z_upper[i] / (self.upper[i] - v)
    }

    /// Entry i of the gradient of the barrier.
    #[inline(always)]
    pub(super) fn gradient(&self, i: usize, v: f64, mu: f64) -> f64 {
        mu / (self.upper[i] - v) - mu / (v - self.lower[i])
    }

    /// Derivative of the barrier along the step `dv`.
    pub(super) fn slope(&self, v: &[f64], dv: &[f64], mu: f64) -> f64 {
        (0..v.len()).map(|i| self.gradient(i, v[i], mu) * dv[i]).sum()
    }

    /// Value of the barrier; infinite outside the bounds.
    pub(super) fn barrier(&self, v: &[f64], mu: f64) -> f64 {
        /// Logarithms are slow: one is taken of a product of gaps, before that can underflow or overflow.
        const SMALL: f64 = 1e-200;
        const LARGE: f64 = 1e200;
        let (mut sum, mut product) = (0.0, 1.0);
        for i in 0..v.len() {
            let (low, high) = (v[i] - self.lower[i], self.upper[i] - v[i]);
            if !(low > 0.0 && high > 0.0) {
                return f64::INFINITY;
            }
            if !(SMALL..LARGE).contains(&product) {
                sum += f64::ln(product);
                product = 1.0;
            }
            product *= low * high;
        }
        -mu * (sum + libm::log(product))
    }

    /// Steps of the multipliers that belong to the step `dv`.
    pub(super) fn dual_step(&self, v: &[f64], dv: &[f64], mu: f64) -> DualStep {
        let lower = |i: usize| {
            let gap = v[i] - self.lower[i];
            mu / gap - self.z_lower[i] - self.z_lower[i] / gap * dv[i]
        };
        let upper = |i: usize| {
            let gap = self.upper[i] - v[i];
            mu / gap - self.z_upper[i] + self.z_upper[i] / gap * dv[i]
        };
        DualStep { lower: (0..v.len()).map(lower).collect(), upper: (0..v.len()).map(upper).collect() }
    }

    /// Largest fractions of the steps that keep `share` of the distance to the bounds: (primal, dual).
    pub(super) fn to_boundary(&self, v: &[f64], dv: &[f64], dz: &DualStep, share: f64) -> (f64, f64) {
        let (mut primal, mut dual) = (1.0_f64, 1.0_f64);
        let limit = |gap: f64, rate: f64| if rate < 0.0 { -share * gap / rate } else { f64::INFINITY };
        for i in 0..v.len() {
            primal = primal.min(limit(v[i] - self.lower[i], dv[i])).min(limit(self.upper[i] - v[i], -dv[i]));
            dual = dual.min(limit(self.z_lower[i], dz.lower[i])).min(limit(self.z_upper[i], dz.upper[i]));
        }
        (primal, dual)
    }

    /// Moves the multipliers and keeps them near those of a central point.
    pub(super) fn advance(&mut self, v: &[f64], dz: &DualStep, alpha: f64, mu: f64) {
        /// Largest ratio of a multiplier to mu / gap, and its inverse.
        const KAPPA: f64 = 1e10;
        for i in 0..v.len() {
            let (low, high) = (mu / (v[i] - self.lower[i]), mu / (self.upper[i] - v[i]));
            self.z_lower[i] = (self.z_lower[i] + alpha * dz.lower[i]).clamp(low / KAPPA, low * KAPPA);
            self.z_upper[i] = (self.z_upper[i] + alpha * dz.upper[i]).clamp(high / KAPPA, high * KAPPA);
        }
    }

    /// Largest |z gap - mu|.
    pub(super) fn complementarity(&self, v: &[f64], mu: f64) -> f64 {
        (0..v.len())
            .map(|i| {
                let low = (self.z_lower[i] * (v[i] - self.lower[i]) - mu).abs();
                low.max((self.z_upper[i] * (self.upper[i] - v[i]) - mu).abs())
            })
            .fold(0.0, f64::max)
    }

    pub(super) fn multiplier_sum(&self) -> f64 {
        self.z_lower.iter().sum::<f64>() + self.z_upper.iter().sum::<f64>()
    }
}
