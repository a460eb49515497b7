//! Equilibria of the unactuated joints: the rest positions, in which they hang, and the test of the target.

use crate::thresholds::EQUILIBRIUM_ACCELERATION;
use crate::{
    ActuatedVector, JointParts, JointVector, Model, N_UNACTUATED, NQ, NU, State, StateParts,
    UnactuatedVector, Workspace,
};

/// The search for a rest position found none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no rest position of the unactuated joints: |g_U| stays at {residual:e} N m")]
pub struct RestError {
    /// |g_U| at the last iterate, N m.
    pub residual: f64,
}

/// The target (8) is no equilibrium: an unactuated joint accelerates in it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("joint {joint} accelerates with {acceleration:.3} rad/s^2 in the target")]
pub struct TargetError {
    /// The first such joint, counted from 1.
    pub joint: usize,
    /// Its acceleration, rad/s^2.
    pub acceleration: f64,
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

    /// Checks that the unactuated joints stay at rest in the target (8): qd = 0, u = 0, q2 - q4 + q6 = `pitch` (rad), first
    /// unactuated joint at `q8` (rad), all other angles 0. (8) fixes the sum only, so that the target has to be an equilibrium
    /// whichever of the three joints pitches the flange.
    ///
    /// # Errors
    /// [`TargetError`] with the acceleration above [`EQUILIBRIUM_ACCELERATION`].
    pub fn check_target(&self, pitch: f64, q8: f64, work: &mut Workspace) -> Result<(), TargetError> {
        for (joint, sign) in [(1, 1.0), (3, -1.0), (5, 1.0)] {
            let mut x = State::zeros();
            (x[joint], x[NU]) = (sign * pitch, q8);
            let qdd = self.f(&x, &ActuatedVector::zeros(), work).qd();
            // Written so that NaN is refused.
            if let Some(i) = (NU..NQ).find(|i| !(qdd[*i].abs() <= EQUILIBRIUM_ACCELERATION)) {
                return Err(TargetError { joint: i + 1, acceleration: qdd[i] });
            }
        }
        Ok(())
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
