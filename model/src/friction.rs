//! Friction of the actuated joints.

use crate::ActuatedVector;

/// Friction of the actuated joints: viscous qd + coulomb tanh(qd / smoothing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFriction {
    /// Viscous friction, N m s/rad or N s/m.
    pub viscous: ActuatedVector,
    /// Coulomb friction, N m or N.
    pub coulomb: ActuatedVector,
    /// Speed at which Coulomb friction reaches 76 % of its value, rad/s or m/s, above 0.
    pub smoothing: f64,
}

impl JointFriction {
    /// Torque that moves the joints against their friction at the speeds `qd` (rad/s or m/s), N m or N.
    pub fn torque(&self, qd: &ActuatedVector) -> ActuatedVector {
        ActuatedVector::from_fn(qd.sizes(), |i| {
            // Most robots leave it at 0, and a tanh is slow.
            let coulomb = if self.coulomb[i] == 0.0 { 0.0 } else { libm::tanh(qd[i] / self.smoothing) };
            self.viscous[i] * qd[i] + self.coulomb[i] * coulomb
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sizes;

    #[test]
    fn friction_is_smooth_at_rest_and_opposes_either_direction() {
        let sizes = Sizes::new(5, 4).expect("sizes");
        let [viscous, coulomb] = [0.2, 0.3].map(|v| ActuatedVector::repeat(sizes, v));
        let friction = JointFriction { viscous, coulomb, smoothing: 0.05 };
        let at = |speed: f64| friction.torque(&ActuatedVector::repeat(sizes, speed))[3];
        assert_eq!(at(0.0), 0.0);
        assert!((at(1.0) - 0.5).abs() < 1e-9 && at(-1.0) == -at(1.0));
        // Its slope at rest is 0.2 + 0.3 / 0.05.
        assert!((at(1e-6) / 1e-6 - 6.2).abs() < 1e-3);
    }
}
