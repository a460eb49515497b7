//! Equilibria of the unactuated joints: the rest positions, in which they hang, and the test of the target.

use crate::thresholds::EQUILIBRIUM_ACCELERATION;
use crate::vector::Matrix;
use crate::{ActuatedVector, JointVector, Linearization, Model, State, Workspace};

/// The search for a rest position found none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no rest position of the unactuated joints: |g_U| stays at {residual:e} N m")]
pub struct RestError {
    /// |g_U| at the last iterate, N m or N.
    pub residual: f64,
}

/// A target is no equilibrium: an unactuated joint accelerates in it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("joint `{joint}` accelerates with {acceleration:.3} {unit}/s^2 in the target")]
pub struct TargetError {
    /// Name of the first such joint.
    pub joint: String,
    /// Its acceleration.
    pub acceleration: f64,
    /// Unit of the joint's position.
    pub unit: &'static str,
}

/// Longest step of the iteration, rad or m: where the curvature nearly vanishes, a full step would be many turns long.
const LONGEST_STEP: f64 = 0.5;

/// Which equilibrium of the unactuated joints with q_A held is looked for.
#[derive(Clone, Copy)]
enum Extremum {
    /// The smallest potential energy: they hang.
    Lowest,
    /// The largest one: they stand.
    Highest,
}

impl Model {
    /// A rest position q = [q_A, q_U]: the unactuated joints hang, g_U(q) = 0 with a positive curvature
    /// of the potential energy. A damped Newton iteration from the q_U of `q`; q_A stays as it is.
    ///
    /// # Errors
    /// [`RestError`] if the iteration does not converge.
    pub fn rest_position(&self, q: &JointVector, work: &mut Workspace) -> Result<JointVector, RestError> {
        self.equilibrium(Extremum::Lowest, q, work)
    }

    /// The position q = [q_A, q_U] in which all unactuated joints stand upright: g_U(q) = 0 with a negative curvature of the potential
    /// energy. Iterates from the q_U of `q` as [`Model::rest_position`] does.
    ///
    /// # Errors
    /// [`RestError`] if the iteration does not converge.
    pub fn upright_position(&self, q: &JointVector, work: &mut Workspace) -> Result<JointVector, RestError> {
        self.equilibrium(Extremum::Highest, q, work)
    }

    /// The equilibrium at an extremum of the potential energy over q_U.
    fn equilibrium(
        &self,
        extremum: Extremum,
        q: &JointVector,
        work: &mut Workspace,
    ) -> Result<JointVector, RestError> {
        /// Step away from an equilibrium that is no extremum, rad or m.
        const KICK: f64 = 0.01;
        /// Curvature relative to its largest entry below which a direction counts as flat.
        const FLAT: f64 = 1e-9;
        let sign = match extremum {
            Extremum::Lowest => 1.0,
            Extremum::Highest => -1.0,
        };
        let sizes = self.sizes();
        let mut q = *q;
        let mut energy = sign * self.potential_energy(&q);
        let mut residual = f64::INFINITY;
        let mut derivatives = Linearization::new(sizes);
        for _ in 0..100 {
            let (g, curvature) = self.unactuated_gravity(&q, work, &mut derivatives);
            let (g, curvature) = (g * sign, curvature * sign);
            residual = g.norm();
            let shifted = |shift: f64| curvature + Matrix::from_diagonal_element(sizes, shift);
            if residual < 1e-13 {
                if shifted(FLAT * (1.0 + curvature.amax())).solve_positive(&g).is_some() {
                    break;
                }
                // Zero of the URDF can be the other extremum, or a saddle.
                for q in q.unactuated_mut() {
                    *q += KICK;
                }
                (energy, residual) = (sign * self.potential_energy(&q), f64::INFINITY);
                continue;
            }
            // Away from the minimum the curvature can be indefinite; shift it until it is not.
            let mut shift = 0.0;
            let step = loop {
                match shifted(shift).solve_positive(&-g) {
                    Some(step) => break step,
                    // What is not finite never becomes positive definite.
                    None if !curvature.amax().is_finite() || !residual.is_finite() => {
                        return Err(RestError { residual });
                    }
                    None => shift = 2.0 * shift + 1e-3 * (1.0 + curvature.amax()),
                }
            };
            let mut fraction = (LONGEST_STEP / step.norm()).min(1.0);
            loop {
                let trial = JointVector::joined(&q.actuated(), &(q.unactuated() + step * fraction));
                let trial_energy = sign * self.potential_energy(&trial);
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

    /// Checks that the unactuated joints stay at rest in `x` with u = 0.
    ///
    /// # Errors
    /// [`TargetError`] with the acceleration above [`EQUILIBRIUM_ACCELERATION`].
    pub fn check_equilibrium(&self, x: &State, work: &mut Workspace) -> Result<(), TargetError> {
        let actuated = self.sizes().actuated();
        let qdd_u = self.hybrid_dynamics(x, &ActuatedVector::zeros(self.sizes()), work).qdd_u;
        // Written so that NaN is refused.
        match qdd_u.iter().position(|qdd| !(qdd.abs() <= EQUILIBRIUM_ACCELERATION)) {
            None => Ok(()),
            Some(c) => Err(TargetError {
                joint: self.joint_name(actuated + c).to_owned(),
                acceleration: qdd_u[c],
                unit: self.joint_kind(actuated + c).unit(),
            }),
        }
    }
}
