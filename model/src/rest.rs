//! The hanging equilibrium of the unactuated joints.

use crate::{JointVector, Model, N_UNACTUATED, NQ, NU, UnactuatedVector, Workspace};

/// No hanging equilibrium was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no rest position of the unactuated joints: |g_U| stays at {residual:e} N m")]
pub struct RestError {
    /// What is left of |g_U|, N m.
    pub residual: f64,
}

/// Longest step of the iteration, rad: where the curvature nearly vanishes, a full step would lead many turns away.
const LONGEST_STEP: f64 = 0.5;

impl Model {
    /// The pose q = [q_A, q_U] (rad) in which the unactuated joints hang at rest: g_U(q) = 0 with positive
    /// curvature of the potential energy. Starts from the q_U given; joints q_A stay as they are.
    ///
    /// # Errors
    /// [`RestError`] if the damped Newton iteration does not settle.
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
                match shifted.cholesky() {
                    Some(factor) => break -factor.solve(&g),
                    None => shift = 2.0 * shift + 1e-3 * (1.0 + curvature.norm()),
                }
            };
            let mut fraction = (LONGEST_STEP / step.norm()).min(1.0);
            loop {
                let mut trial = q;
                for i in 0..N_UNACTUATED {
                    trial[NU + i] += fraction * step[i];
                }
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

    /// g_U (N m) and its derivative with respect to q_U.
    fn unactuated_gravity(
        &self,
        q: &JointVector,
        work: &mut Workspace,
    ) -> (UnactuatedVector, nalgebra::SMatrix<f64, N_UNACTUATED, N_UNACTUATED>) {
        let zero = JointVector::zeros();
        let r = self.inverse_dynamics(q, &zero, &zero, work);
        let (dr_dq, _) = work.inverse_dynamics_derivatives();
        (
            r.fixed_rows::<N_UNACTUATED>(NU).into(),
            dr_dq.fixed_view::<N_UNACTUATED, N_UNACTUATED>(NQ - N_UNACTUATED, NQ - N_UNACTUATED).into(),
        )
    }
}
