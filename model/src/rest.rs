//! Rest positions: the hanging equilibria of the unactuated joints.

use crate::{JointParts, JointVector, Model, N_UNACTUATED, NU, UnactuatedVector, Workspace};

/// The search for a rest position found none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no rest position of the unactuated joints: |g_U| stays at {residual:e} N m")]
pub struct RestError {
    /// |g_U| at the last iterate, N m.
    pub residual: f64,
}

/// Longest step of the iteration, rad: where the curvature nearly vanishes, a full step would be many turns long.
const LONGEST_STEP: f64 = 0.5;

impl Model {
    /// A rest position q = [q_A, q_U], rad: the unactuated joints hang, g_U(q) = 0 with a positive curvature
    /// of the potential energy. A damped Newton iteration from the q_U of `q`; q_A stays as it is.
    ///
    /// # Errors
    /// [`RestError`] if the iteration does not converge.
    pub fn rest_position(&self, q: &JointVector, work: &mut Workspace) -> Result<JointVector, RestError> {
        let mut q = *q;
        let mut energy = self.potential_energy(&q);
        let mut residual = f64::INFINITY;
        for _ in 0..100 {
            let (g, curvature) = self.unactuated_gravity(&q, work);
            residual = g.norm();
            if residual < 1e-13 {
                break;
            }
            // Away from the minimum the curvature can be indefinite; shift it until it is not.
            let mut shift = 0.0;
            let step = loop {
                let shifted = curvature + nalgebra::SMatrix::identity() * shift;
                // nalgebra's factorisation: `positive` is written out for M of all joints, and this block has the unactuated ones.
                match shifted.cholesky() {
                    Some(factor) => break -factor.solve(&g),
                    None => shift = 2.0 * shift + 1e-3 * (1.0 + curvature.norm()),
                }
            };
            let mut fraction = (LONGEST_STEP / step.norm()).min(1.0);
            loop {
                let mut trial = q;
                let mut q_u = trial.unactuated_mut();
                q_u += step * fraction;
                let trial_energy = self.potential_energy(&trial);
                // The slack is the rounding of an energy of about 100 J.
                if trial_energy <= energy + 1e-13 || fraction < 1e-6 {
                    (q, energy) = (trial, trial_energy);
                    break;
                }
                fraction *= 0.5;
            }
        }
        if residual < 1e-10 && q.iter().all(|v| v.is_finite()) { Ok(q) } else { Err(RestError { residual }) }
    }

    /// g_U (N m) and its derivative with respect to q_U (N m/rad).
    fn unactuated_gravity(
        &self,
        q: &JointVector,
        work: &mut Workspace,
    ) -> (UnactuatedVector, nalgebra::SMatrix<f64, N_UNACTUATED, N_UNACTUATED>) {
        let zero = JointVector::zeros();
        let r = self.inverse_dynamics(q, &zero, &zero, work);
        let (dr_dq, _) = work.inverse_dynamics_derivatives();
        (r.unactuated(), dr_dq.fixed_view::<N_UNACTUATED, N_UNACTUATED>(NU, NU).into())
    }
}
