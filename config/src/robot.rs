//! Limits of the robot and target of the swing-up, `robot.toml`.

use crate::conflict::{SettingsConflict, in_file, unit};
use crate::joints::{Prismatic, Range, Revolute, both_kinds};
use crate::rule::{Angle, Finite, Negative, NonNegative, Positive, PositiveShare, Rule};
use serde::de::{Deserialize, Deserializer, Error};
use upswing_model::{
    ActuatedVector, JointFriction, JointVector, Joints, Limits, Model, TargetError, Unactuated,
    UnactuatedVector, Workspace,
};

/// Limits and drives of the robot, and the target of the swing-up.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(from = "RobotFile")]
pub struct RobotSettings {
    /// Rated limits, 100 % (Table II).
    pub limits: Limits,
    /// Limits of plans: shares of the rated velocities and torques, positions of the unactuated joints with a margin.
    pub planning: Limits,
    /// Bound c of the Coriolis torques in (11).
    pub coriolis_bound: CoriolisBound,
    /// The target x_T, (8).
    pub target: Target,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2 or kg; part of [`crate::Config::model`].
    pub rotor_inertia: ActuatedVector,
    /// Joint friction that the drives do not compensate; the daemon adds it to its torque.
    pub friction: JointFriction,
}

/// Bound c of (11): range of the Coriolis torques C~ qd over all admissible states, N m or N.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoriolisBound {
    /// Lowest torque, below 0, N m or N.
    #[serde(rename = "lower_nm", deserialize_with = "Negative::read")]
    pub lower: ActuatedVector,
    /// Highest torque, above 0, N m or N.
    #[serde(rename = "upper_nm", deserialize_with = "Positive::read")]
    pub upper: ActuatedVector,
}

/// The target state x_T, (8): at rest, all other angles zero.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
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
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    #[serde(deserialize_with = "rated_limits")]
    limits: Limits,
    usage: LimitUsage,
    coriolis_bound: CoriolisBound,
    target: Target,
    drives: DriveProperties,
}

fn rated_limits<'de, D: Deserializer<'de>>(from: D) -> Result<Limits, D::Error> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct RatedLimits {
        #[serde(default, deserialize_with = "Finite::degrees")]
        q_deg: Option<Revolute<Joints, Range>>,
        #[serde(default, deserialize_with = "Finite::read")]
        q_m: Option<Prismatic<Joints, Range>>,
        #[serde(default, deserialize_with = "Positive::degrees")]
        qd_deg_s: Option<Revolute<Joints>>,
        #[serde(default, deserialize_with = "Positive::read")]
        qd_m_s: Option<Prismatic<Joints>>,
        #[serde(rename = "tau_nm", deserialize_with = "Positive::read")]
        tau_max: ActuatedVector,
    }
    let RatedLimits { q_deg, q_m, qd_deg_s, qd_m_s, tau_max } = RatedLimits::deserialize(from)?;
    let (sizes, q) = both_kinds(("q_deg", q_deg), ("q_m", q_m)).map_err(D::Error::custom)?;
    let (_, qd) = both_kinds(("qd_deg_s", qd_deg_s), ("qd_m_s", qd_m_s)).map_err(D::Error::custom)?;
    Ok(Limits {
        q_min: JointVector::from_fn(sizes, |i| q[i][0]),
        q_max: JointVector::from_fn(sizes, |i| q[i][1]),
        qd_max: JointVector::from_fn(sizes, |i| qd[i]),
        tau_max,
    })
}

/// Share of the limits that plans may use.
#[derive(serde::Deserialize)]
#[serde(try_from = "LimitUsageInFile")]
struct LimitUsage {
    velocity_fraction_actuated: f64,
    velocity_fraction_unactuated: f64,
    torque_fraction: f64,
    /// Extension of the position limits of the unactuated joints, rad or m.
    position_margin: UnactuatedVector,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitUsageInFile {
    #[serde(deserialize_with = "PositiveShare::read")]
    velocity_fraction_actuated: f64,
    #[serde(deserialize_with = "PositiveShare::read")]
    velocity_fraction_unactuated: f64,
    #[serde(deserialize_with = "PositiveShare::read")]
    torque_fraction: f64,
    #[serde(default, deserialize_with = "NonNegative::degrees")]
    position_margin_deg: Option<Revolute<Unactuated>>,
    #[serde(default, deserialize_with = "NonNegative::read")]
    position_margin_m: Option<Prismatic<Unactuated>>,
}

impl TryFrom<LimitUsageInFile> for LimitUsage {
    type Error = String;

    fn try_from(file: LimitUsageInFile) -> Result<Self, String> {
        let (deg, m) = (file.position_margin_deg, file.position_margin_m);
        let (sizes, margin) = both_kinds(("position_margin_deg", deg), ("position_margin_m", m))?;
        Ok(Self {
            velocity_fraction_actuated: file.velocity_fraction_actuated,
            velocity_fraction_unactuated: file.velocity_fraction_unactuated,
            torque_fraction: file.torque_fraction,
            position_margin: UnactuatedVector::from_fn(sizes, |i| margin[i]),
        })
    }
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct DriveProperties {
    #[serde(rename = "rotor_inertia_kg_m2", deserialize_with = "NonNegative::read")]
    rotor_inertia: ActuatedVector,
    #[serde(deserialize_with = "NonNegative::read")]
    friction_viscous: ActuatedVector,
    #[serde(deserialize_with = "NonNegative::read")]
    friction_coulomb: ActuatedVector,
    #[serde(rename = "friction_smoothing_rad_s", deserialize_with = "Positive::read")]
    friction_smoothing: f64,
}

impl From<RobotFile> for RobotSettings {
    fn from(RobotFile { limits, usage, coriolis_bound, target, drives }: RobotFile) -> Self {
        let mut planning = limits;
        planning.tau_max *= usage.torque_fraction;
        planning.qd_max.actuated_mut().iter_mut().for_each(|qd| *qd *= usage.velocity_fraction_actuated);
        planning.qd_max.unactuated_mut().iter_mut().for_each(|qd| *qd *= usage.velocity_fraction_unactuated);
        for (i, margin) in usage.position_margin.iter().enumerate() {
            planning.q_min.unactuated_mut()[i] -= margin;
            planning.q_max.unactuated_mut()[i] += margin;
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
        for (joint, most) in self.planning.tau_max.iter().enumerate() {
            for (key, c) in
                [("coriolis_bound.upper_nm", upper[joint]), ("coriolis_bound.lower_nm", lower[joint])]
            {
                if c.abs() >= *most {
                    return Err(SettingsConflict::new(
                        key,
                        format!("less than the {most} N m that a plan may use"),
                        format!("{c} for joint `{}`", model.joint_name(joint)),
                        "lower it or raise usage.torque_fraction",
                    ));
                }
            }
        }
        self.agree_with(model)?;
        self.target.validate(&self.planning, model)
    }

    /// Checks that the rated limits (Table II) agree in `robot.toml` and, for other programs, in the URDF. A joint that is continuous in
    /// the URDF has the limit of `robot.toml`.
    fn agree_with(&self, model: &Model) -> Result<(), SettingsConflict> {
        /// Rounding of the URDF's numbers, deg, deg/s, m, m/s, N m.
        const ROUNDING: f64 = 1e-4;
        let agree = |key: String, joint: usize, toml: f64, urdf: f64| {
            // A NaN disagrees.
            if (toml - urdf).abs() <= ROUNDING || urdf.is_infinite() {
                return Ok(());
            }
            let expected =
                format!("the {urdf} of joint `{}` in {}", model.joint_name(joint), crate::URDF.name);
            Err(SettingsConflict::new(key, expected, toml, "change both files alike"))
        };
        let (toml, urdf) = (&self.limits, model.rated_limits());
        for joint in 0..model.sizes().joints() {
            let kind = model.joint_kind(joint);
            let in_file = |q: f64| in_file(kind, q);
            let (q, qd) = (format!("limits.q_{}", unit(kind)), format!("limits.qd_{}_s", unit(kind)));
            agree(q.clone(), joint, in_file(toml.q_min[joint]), in_file(urdf.q_min[joint]))?;
            agree(q, joint, in_file(toml.q_max[joint]), in_file(urdf.q_max[joint]))?;
            agree(qd, joint, in_file(toml.qd_max[joint]), in_file(urdf.qd_max[joint]))?;
        }
        let mut torques = toml.tau_max.iter().zip(urdf.tau_max.iter()).enumerate();
        torques.try_for_each(|(joint, (toml, urdf))| agree("limits.tau_nm".into(), joint, *toml, *urdf))
    }
}

impl Target {
    /// Refuses a target (8) that is outside the limits, or no equilibrium of the pendulum: no trajectory can end at rest in such a
    /// target.
    fn validate(self, limits: &Limits, model: &Model) -> Result<(), SettingsConflict> {
        /// Numbers of actuated and unactuated joints for which (8) has a meaning.
        const OF_PAPER: (usize, usize) = (7, 2);
        let Self { pitch, q8 } = self;
        let (actuated, unactuated) = (model.sizes().actuated(), model.sizes().unactuated());
        if (actuated, unactuated) != OF_PAPER {
            return Err(SettingsConflict::new(
                "target",
                format!("{} actuated and {} unactuated joints, as (8) has", OF_PAPER.0, OF_PAPER.1),
                format!("{actuated} and {unactuated} in {}", crate::URDF.name),
                "targets of other robots are not supported yet",
            ));
        }
        SettingsConflict::unless_within("target.q8", q8, actuated, limits, model)?;
        let refuse = |TargetError { joint, acceleration, unit }| {
            SettingsConflict::new(
                "target.pitch_deg",
                "with target.q8_deg an equilibrium of the pendulum",
                format!(
                    "{:.2} with q8_deg {:.2}, where joint `{joint}` of {} at rest accelerates with {acceleration:.3} {unit}/s^2",
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
