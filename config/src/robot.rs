//! Limits of the robot and target of the swing-up, `robot.toml`.

use crate::conflict::{SettingsConflict, degrees};
use crate::rule::{Angle, Finite, Negative, NonNegative, Positive, PositiveShare, Rule};
use serde::Deserialize;
use upswing_model::{
    ActuatedVector, JointFriction, JointVector, Limits, Model, N_UNACTUATED, NQ, NU, TargetError, Workspace,
};

/// Limits and drives of the robot, and the target of the swing-up.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(from = "RobotFile")]
pub struct RobotSettings {
    /// Rated limits, 100 % (Table II), rad, rad/s, N m.
    pub limits: Limits,
    /// Limits of plans, rad, rad/s, N m: shares of the rated velocities and torques, angles of the unactuated joints with a margin.
    pub planning: Limits,
    /// Bound c of the Coriolis torques in (11), N m.
    pub coriolis_bound: CoriolisBound,
    /// The target x_T, (8).
    pub target: Target,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2; part of [`crate::Config::model`].
    pub rotor_inertia: [f64; NU],
    /// Joint friction that the drives do not compensate; the daemon adds it to its torque.
    pub friction: JointFriction,
}

/// Bound c of (11): range of the Coriolis torques C~ qd over all admissible states, N m.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoriolisBound {
    /// Lowest torque, below 0, N m.
    #[serde(rename = "lower_nm", deserialize_with = "Negative::read")]
    pub lower: [f64; NU],
    /// Highest torque, above 0, N m.
    #[serde(rename = "upper_nm", deserialize_with = "Positive::read")]
    pub upper: [f64; NU],
}

/// The target state x_T, (8): at rest, all other angles zero.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Pitch of the flange, q2 - q4 + q6, rad.
    #[serde(rename = "pitch_deg", deserialize_with = "Angle::degrees")]
    pub pitch: f64,
    /// First angle of the pendulum, rad; not wrapped, counts turns.
    #[serde(rename = "q8_deg", deserialize_with = "Finite::degrees")]
    pub q8: f64,
}

/// Contents of `robot.toml`, in SI units.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    limits: RatedLimits,
    usage: LimitUsage,
    coriolis_bound: CoriolisBound,
    target: Target,
    drives: DriveProperties,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RatedLimits {
    #[serde(rename = "q_deg", deserialize_with = "Positive::degrees")]
    q: [f64; NQ],
    #[serde(rename = "qd_deg_s", deserialize_with = "Positive::degrees")]
    qd: [f64; NQ],
    #[serde(rename = "tau_nm", deserialize_with = "Positive::read")]
    tau: [f64; NU],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitUsage {
    #[serde(deserialize_with = "PositiveShare::read")]
    velocity_fraction_actuated: f64,
    #[serde(deserialize_with = "PositiveShare::read")]
    velocity_fraction_unactuated: f64,
    #[serde(deserialize_with = "PositiveShare::read")]
    torque_fraction: f64,
    #[serde(rename = "position_margin_deg", deserialize_with = "NonNegative::degrees")]
    position_margin: [f64; N_UNACTUATED],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DriveProperties {
    #[serde(rename = "rotor_inertia_kg_m2", deserialize_with = "NonNegative::read")]
    rotor_inertia: [f64; NU],
    #[serde(deserialize_with = "NonNegative::read")]
    friction_viscous: [f64; NU],
    #[serde(deserialize_with = "NonNegative::read")]
    friction_coulomb: [f64; NU],
    #[serde(rename = "friction_smoothing_rad_s", deserialize_with = "Positive::read")]
    friction_smoothing: f64,
}

impl From<RobotFile> for RobotSettings {
    fn from(RobotFile { limits, usage, coriolis_bound, target, drives }: RobotFile) -> Self {
        let q_max = JointVector::from(limits.q);
        let limits = Limits {
            q_min: -q_max,
            q_max,
            qd_max: JointVector::from(limits.qd),
            tau_max: ActuatedVector::from(limits.tau),
        };
        let mut planning = limits;
        planning.tau_max *= usage.torque_fraction;
        for i in 0..NQ {
            planning.qd_max[i] *=
                if i < NU { usage.velocity_fraction_actuated } else { usage.velocity_fraction_unactuated };
        }
        for i in 0..N_UNACTUATED {
            planning.q_max[NU + i] += usage.position_margin[i];
            planning.q_min[NU + i] -= usage.position_margin[i];
        }
        Self {
            limits,
            planning,
            coriolis_bound,
            target,
            rotor_inertia: drives.rotor_inertia,
            friction: JointFriction {
                viscous: drives.friction_viscous,
                coulomb: drives.friction_coulomb,
                smoothing: drives.friction_smoothing,
            },
        }
    }
}

impl RobotSettings {
    /// Checks the rules between the settings of the robot, and between them and the `model` of the URDF.
    pub(crate) fn validate(&self, model: &Model) -> Result<(), SettingsConflict> {
        let CoriolisBound { lower, upper } = &self.coriolis_bound;
        for i in 0..NU {
            for (key, c) in [("coriolis_bound.upper_nm", upper[i]), ("coriolis_bound.lower_nm", lower[i])] {
                if c.abs() >= self.planning.tau_max[i] {
                    let expected =
                        format!("less than the {} N m that a plan may use", self.planning.tau_max[i]);
                    let got = format!("{c} for joint {}", i + 1);
                    return Err(SettingsConflict::new(
                        key,
                        expected,
                        got,
                        "lower it or raise usage.torque_fraction",
                    ));
                }
            }
        }
        SettingsConflict::unless_within("target.q8_deg", self.target.q8, NU, &self.planning)?;
        self.agree_with(model.rated_limits())?;
        self.target_is_equilibrium(model)
    }

    /// Checks that the rated limits (Table II) agree in `robot.toml` and, for other programs, in the URDF. A joint that is continuous in
    /// the URDF has the limit of `robot.toml`.
    fn agree_with(&self, urdf: &Limits) -> Result<(), SettingsConflict> {
        /// Rounding of the URDF's numbers, deg, deg/s, N m.
        const ROUNDING: f64 = 1e-4;
        let agree = |key, joint: usize, toml: f64, urdf: f64| {
            // A NaN disagrees.
            if (toml - urdf).abs() <= ROUNDING || urdf.is_infinite() {
                return Ok(());
            }
            let expected = format!("the {urdf} of joint {} in {}", joint + 1, crate::URDF.name);
            Err(SettingsConflict::new(key, expected, toml, "change both files alike"))
        };
        let toml = &self.limits;
        for i in 0..NQ {
            agree("limits.q_deg", i, degrees(toml.q_max[i]), degrees(urdf.q_max[i]))?;
            agree("limits.q_deg", i, degrees(toml.q_min[i]), degrees(urdf.q_min[i]))?;
            agree("limits.qd_deg_s", i, degrees(toml.qd_max[i]), degrees(urdf.qd_max[i]))?;
        }
        (0..NU).try_for_each(|i| agree("limits.tau_nm", i, toml.tau_max[i], urdf.tau_max[i]))
    }

    /// Refuses a target (8) that is no equilibrium of the pendulum: no trajectory can end at rest in such a target.
    fn target_is_equilibrium(&self, model: &Model) -> Result<(), SettingsConflict> {
        let Target { pitch, q8 } = self.target;
        let refuse = |TargetError { joint, acceleration }| {
            SettingsConflict::new(
                "target.pitch_deg",
                "with target.q8_deg an equilibrium of the pendulum",
                format!(
                    "{:.2} with q8_deg {:.2}, where joint {joint} of {} at rest accelerates with {acceleration:.3} rad/s^2",
                    pitch.to_degrees(),
                    q8.to_degrees(),
                    crate::URDF.name
                ),
                "make axis 8 horizontal and the rod vertical; the shipped robot has 90 and 180",
            )
        };
        model.check_target(pitch, q8, &mut Workspace::default()).map_err(refuse)
    }
}
