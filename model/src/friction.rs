//! Friction of the actuated joints.

use crate::{ActuatedVector, NU};

/// Friction of the actuated joints: viscous qd + coulomb tanh(qd / smoothing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFriction {
    /// Viscous friction, N m s/rad.
    pub viscous: [f64; NU],
    /// Coulomb friction, N m.
    pub coulomb: [f64; NU],
    /// Speed at which Coulomb friction reaches 76 % of its value, rad/s, above 0.
    pub smoothing: f64,
}

impl JointFriction {
    /// Torque that moves the joints against their friction at the speeds `qd` (rad/s), N m.
    pub fn torque(&self, qd: &ActuatedVector) -> ActuatedVector {
        ActuatedVector::from_fn(|i, _| {
            // Most robots leave it at 0, and a tanh is slow.
            let coulomb = if self.coulomb[i] == 0.0 { 0.0 } else { (qd[i] / self.smoothing).tanh() };
            self.viscous[i] * qd[i] + self.coulomb[i] * coulomb
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_is_smooth_at_rest_and_opposes_either_direction() {
        let friction = JointFriction { viscous: [0.2; NU], coulomb: [0.3; NU], smoothing: 0.05 };
        let at = |speed: f64| friction.torque(&ActuatedVector::repeat(speed))[3];
        assert_eq!(at(0.0), 0.0);
        assert!((at(1.0) - 0.5).abs() < 1e-9 && at(-1.0) == -at(1.0));
        // Its slope at rest is 0.2 + 0.3 / 0.05.
        assert!((at(1e-6) / 1e-6 - 6.2).abs() < 1e-3);
    }
}
