//! The filter of the line search.

/// Pairs (constraint violation, barrier function) that no later iterate may be worse than in both.
#[derive(Default)]
pub(super) struct Filter {
    entries: Vec<(f64, f64)>,
    theta_min: f64,
    theta_max: f64,
}

impl Filter {
    pub(super) fn set_scale(&mut self, theta: f64) {
        self.theta_min = 1e-4 * theta.max(1.0);
        self.theta_max = 1e4 * theta.max(1.0);
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Whether the trial point is acceptable; enters the current point into the filter where the step is not
    /// one of descent in the barrier function.
    pub(super) fn accepts(
        &mut self,
        theta: f64,
        phi: f64,
        theta_p: f64,
        phi_p: f64,
        alpha: f64,
        slope: f64,
    ) -> bool {
        const GAMMA_THETA: f64 = 1e-5;
        const GAMMA_PHI: f64 = 1e-8;
        const ETA_PHI: f64 = 1e-8;
        const S_THETA: f64 = 1.1;
        const S_PHI: f64 = 2.3;
        if !(theta_p.is_finite() && phi_p.is_finite()) || theta_p > self.theta_max {
            return false;
        }
        if self.entries.iter().any(|(t, p)| theta_p >= *t && phi_p >= *p) {
            return false;
        }
        // Rounding of the barrier function near convergence.
        let slack = 10.0 * f64::EPSILON * phi.abs();
        let descent = slope < 0.0 && alpha * libm::pow(-slope, S_PHI) > libm::pow(theta, S_THETA);
        let armijo = phi_p <= phi + ETA_PHI * alpha * slope + slack;
        let good = if theta <= self.theta_min && descent {
            armijo
        } else {
            theta_p <= (1.0 - GAMMA_THETA) * theta || phi_p <= phi - GAMMA_PHI * theta + slack
        };
        if good && !(descent && armijo) {
            self.entries.push(((1.0 - GAMMA_THETA) * theta, phi - GAMMA_PHI * theta));
        }
        good
    }
}
