//! Posture of the unactuated joints at an equilibrium: they hang, or they stand.

use crate::vector::Vector;
use crate::{JointVector, Linearization, Model, Workspace};
use std::fmt;

/// Posture of the unactuated joints at an equilibrium g_U(q) = 0, by the curvature of the potential energy in q_U.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Posture {
    /// The curvature is positive in all directions: with q_A held, the equilibrium is stable.
    Hanging,
    /// The curvature is negative or 0 in at least one direction: the equilibrium needs feedback.
    Standing,
}

impl Posture {
    /// Name in settings and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hanging => "hanging",
            Self::Standing => "standing",
        }
    }
}

impl fmt::Display for Posture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Model {
    /// Posture at `q`, which is taken for an equilibrium: whether the curvature of the potential energy in q_U is positive definite.
    pub fn posture(&self, q: &JointVector, work: &mut Workspace) -> Posture {
        self.posture_with(q, work, &mut Linearization::new(self.sizes()))
    }

    /// As [`Self::posture`], with the memory of the caller: it allocates nothing.
    pub fn posture_with(
        &self,
        q: &JointVector,
        work: &mut Workspace,
        derivatives: &mut Linearization,
    ) -> Posture {
        let (_, curvature) = self.unactuated_gravity(q, work, derivatives);
        match curvature.solve_positive(&Vector::zeros(self.sizes())) {
            Some(_) => Posture::Hanging,
            None => Posture::Standing,
        }
    }
}
