//! `robot.toml`.

use crate::ConfigError;
use crate::check::{Check, FRACTION, FULL_TURN, NEGATIVE, NON_NEGATIVE, POSITIVE};
use serde::Deserialize;
use upswing_model::{ActuatedVector, JointVector, Limits, N_UNACTUATED, NQ, NU};

/// What the robot may do and where the swing-up ends.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSettings {
    /// The limits at 100 % (Table II): rad, rad/s, N m.
    pub limits: Limits,
    /// The limits that a plan keeps: shares of velocity and torque, margins of the unactuated joints.
    pub planning: Limits,
    /// Range of the Coriolis torques, the c of (11).
    pub coriolis_bound: CoriolisBound,
    /// The target x_T, (8).
    pub target: Target,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2; part of [`crate::Config::model`].
    pub rotor_inertia: [f64; NU],
    /// Joint friction that the drives leave, which the daemon adds to its torque.
    pub friction: JointFriction,
}

/// Friction of the actuated joints: viscous qd + coulomb tanh(qd / smoothing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFriction {
    /// N m s/rad
    pub viscous: [f64; NU],
    /// N m
    pub coulomb: [f64; NU],
    /// rad/s, above 0
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

/// Range of C~ qd over all admissible states, (11), N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoriolisBound {
    /// Lowest torque, below 0, N m.
    pub lower: [f64; NU],
    /// Highest torque, above 0, N m.
    pub upper: [f64; NU],
}

/// The target state x_T, (8): at rest, all other angles zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// q2 - q4 + q6, rad.
    pub pitch: f64,
    /// First angle of the pendulum, rad; counts turns.
    pub q8: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    limits: RawLimits,
    usage: RawUsage,
    coriolis_bound: RawCoriolisBound,
    target: RawTarget,
    drives: RawDrives,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLimits {
    q_deg: Vec<f64>,
    qd_deg_s: Vec<f64>,
    tau_nm: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawUsage {
    velocity_fraction_actuated: f64,
    velocity_fraction_unactuated: f64,
    torque_fraction: f64,
    position_margin_deg: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCoriolisBound {
    upper_nm: Vec<f64>,
    lower_nm: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrives {
    rotor_inertia_kg_m2: Vec<f64>,
    friction_viscous: Vec<f64>,
    friction_coulomb: Vec<f64>,
    friction_smoothing_rad_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTarget {
    pitch_deg: f64,
    q8_deg: f64,
}

impl RobotSettings {
    pub(crate) fn read(file: &str, text: &str) -> Result<Self, ConfigError> {
        let check = Check { file };
        let raw: Raw = check.parse(text)?;

        let q: [f64; NQ] = check.list("limits.q_deg", &raw.limits.q_deg, 1, &POSITIVE)?;
        let qd: [f64; NQ] = check.list("limits.qd_deg_s", &raw.limits.qd_deg_s, 1, &POSITIVE)?;
        let tau: [f64; NU] = check.list("limits.tau_nm", &raw.limits.tau_nm, 1, &POSITIVE)?;
        let q_max = JointVector::from(q.map(f64::to_radians));
        let limits = Limits {
            q_min: -q_max,
            q_max,
            qd_max: JointVector::from(qd.map(f64::to_radians)),
            tau_max: ActuatedVector::from(tau),
        };

        let usage = &raw.usage;
        let margin: [f64; N_UNACTUATED] =
            check.list("usage.position_margin_deg", &usage.position_margin_deg, NU + 1, &NON_NEGATIVE)?;
        let of_arm =
            check.number("usage.velocity_fraction_actuated", usage.velocity_fraction_actuated, &FRACTION)?;
        let of_pendulum = check.number(
            "usage.velocity_fraction_unactuated",
            usage.velocity_fraction_unactuated,
            &FRACTION,
        )?;
        let of_torque = check.number("usage.torque_fraction", usage.torque_fraction, &FRACTION)?;
        let mut planning = limits;
        planning.tau_max *= of_torque;
        for i in 0..NQ {
            planning.qd_max[i] *= if i < NU { of_arm } else { of_pendulum };
        }
        for i in 0..N_UNACTUATED {
            planning.q_max[NU + i] += margin[i].to_radians();
            planning.q_min[NU + i] -= margin[i].to_radians();
        }

        let bound = &raw.coriolis_bound;
        let coriolis_bound = CoriolisBound {
            upper: check.list("coriolis_bound.upper_nm", &bound.upper_nm, 1, &POSITIVE)?,
            lower: check.list("coriolis_bound.lower_nm", &bound.lower_nm, 1, &NEGATIVE)?,
        };
        for i in 0..NU {
            for (key, c) in [("upper_nm", coriolis_bound.upper[i]), ("lower_nm", coriolis_bound.lower[i])] {
                if c.abs() >= planning.tau_max[i] {
                    return Err(check.refuse(
                        &format!("coriolis_bound.{key}"),
                        format!("less than the {} N m that a plan may use", planning.tau_max[i]),
                        format!("{c} for joint {}", i + 1),
                        "lower it or raise usage.torque_fraction",
                    ));
                }
            }
        }

        let target = Target {
            pitch: check.number("target.pitch_deg", raw.target.pitch_deg, &FULL_TURN)?.to_radians(),
            q8: check.angle("target.q8_deg", raw.target.q8_deg, NU, &planning)?,
        };
        let key = "drives.rotor_inertia_kg_m2";
        let rotor_inertia = check.list(key, &raw.drives.rotor_inertia_kg_m2, 1, &NON_NEGATIVE)?;
        let arm = |key: &str, values: &[f64]| check.list(key, values, 1, &NON_NEGATIVE);
        let friction = JointFriction {
            viscous: arm("drives.friction_viscous", &raw.drives.friction_viscous)?,
            coulomb: arm("drives.friction_coulomb", &raw.drives.friction_coulomb)?,
            smoothing: check.number(
                "drives.friction_smoothing_rad_s",
                raw.drives.friction_smoothing_rad_s,
                &POSITIVE,
            )?,
        };
        Ok(Self { limits, planning, coriolis_bound, target, rotor_inertia, friction })
    }
}

#[cfg(test)]
mod tests {
    use super::JointFriction;
    use upswing_model::ActuatedVector;

    #[test]
    fn friction_is_smooth_at_rest_and_opposes_either_direction() {
        let friction = JointFriction { viscous: [0.2; 7], coulomb: [0.3; 7], smoothing: 0.05 };
        let at = |speed: f64| friction.torque(&ActuatedVector::repeat(speed))[3];
        assert_eq!(at(0.0), 0.0);
        assert!((at(1.0) - 0.5).abs() < 1e-9 && at(-1.0) == -at(1.0));
        // Its slope at rest is 0.2 + 0.3 / 0.05.
        assert!((at(1e-6) / 1e-6 - 6.2).abs() < 1e-3);
    }
}
