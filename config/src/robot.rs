//! Limits and drives of the robot, `robot.toml`.

use crate::combinations::combinations;
use crate::conflict::{SettingsConflict, in_file, unit};
use crate::joints::{Prismatic, Range, Revolute, both_kinds};
use crate::rule::{Margin, Negative, NonNegative, Position, Positive, PositiveShare, Rule};
use serde::de::{Deserialize, Deserializer, Error};
use upswing_model::{
    ActuatedVector, JointFriction, JointVector, Joints, Limits, Model, Unactuated, UnactuatedMatrix,
    UnactuatedVector, Workspace,
};

/// Limits and drives of the robot.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(from = "RobotFile")]
pub struct RobotSettings {
    /// What the robot is, in a few words.
    pub description: String,
    /// Rated limits, 100 % (Table II).
    pub limits: Limits,
    /// Limits of plans: shares of the rated velocities, torques and ranges of the actuated joints, ranges of the unactuated joints with a
    /// margin.
    pub planning: Limits,
    /// Bound c of the Coriolis torques in (11), if it is known.
    pub coriolis_bound: Option<CoriolisBound>,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2 or kg; part of [`crate::Config::model`].
    pub rotor_inertia: ActuatedVector,
    /// Viscous friction of the unactuated joints, N m s/rad or N s/m; part of [`crate::Config::model`].
    pub bearing_friction: UnactuatedVector,
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

/// Contents of `robot.toml`, in SI units.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    description: String,
    #[serde(deserialize_with = "rated_limits")]
    limits: Limits,
    usage: LimitUsage,
    coriolis_bound: Option<CoriolisBound>,
    drives: DriveProperties,
    bearings: BearingProperties,
}

fn rated_limits<'de, D: Deserializer<'de>>(from: D) -> Result<Limits, D::Error> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct RatedLimits {
        #[serde(default, deserialize_with = "Position::degrees")]
        q_deg: Option<Revolute<Joints, Range>>,
        #[serde(default, deserialize_with = "Position::read")]
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
    position_fraction_actuated: f64,
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
    #[serde(deserialize_with = "PositiveShare::read")]
    position_fraction_actuated: f64,
    #[serde(default, deserialize_with = "Margin::degrees")]
    position_margin_deg: Option<Revolute<Unactuated>>,
    #[serde(default, deserialize_with = "Margin::read")]
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
            position_fraction_actuated: file.position_fraction_actuated,
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

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct BearingProperties {
    #[serde(deserialize_with = "NonNegative::read")]
    friction_viscous: UnactuatedVector,
}

impl From<RobotFile> for RobotSettings {
    fn from(RobotFile { description, limits, usage, coriolis_bound, drives, bearings }: RobotFile) -> Self {
        let mut planning = limits;
        planning.tau_max *= usage.torque_fraction;
        planning.qd_max.actuated_mut().iter_mut().for_each(|qd| *qd *= usage.velocity_fraction_actuated);
        planning.qd_max.unactuated_mut().iter_mut().for_each(|qd| *qd *= usage.velocity_fraction_unactuated);
        let margin =
            (limits.q_max - limits.q_min).actuated() * (0.5 * (1.0 - usage.position_fraction_actuated));
        for i in 0..margin.len() {
            planning.q_min[i] += margin[i];
            planning.q_max[i] -= margin[i];
        }
        for (i, margin) in usage.position_margin.iter().enumerate() {
            planning.q_min.unactuated_mut()[i] -= margin;
            planning.q_max.unactuated_mut()[i] += margin;
        }
        Self {
            description,
            limits,
            planning,
            coriolis_bound,
            rotor_inertia: drives.rotor_inertia,
            bearing_friction: bearings.friction_viscous,
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
        for (joint, most) in self.planning.tau_max.iter().enumerate() {
            let Some(CoriolisBound { lower, upper }) = &self.coriolis_bound else { break };
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
        self.check_inertia(model)
    }

    /// Checks that M_UU is well conditioned over the ranges of plans: (3) divides by it. It depends on the joints behind the first
    /// unactuated one only.
    fn check_inertia(&self, model: &Model) -> Result<(), SettingsConflict> {
        /// Smallest inertia of a joint relative to its largest one in the ranges, and smallest pivot of M_UU, scaled to a diagonal of 1.
        const SMALLEST: f64 = 1e-4;
        /// Largest number of poses, and numbers of positions of each joint, of which the largest one fits.
        const MOST_POSES: usize = 4096;
        const POSITIONS: [usize; 3] = [5, 3, 2];
        let (sizes, order) = (model.sizes(), model.order());
        let first = (0..sizes.joints()).find(|joint| !order.is_actuated(*joint)).unwrap_or_default();
        let behind: Vec<_> = (first + 1..sizes.joints()).map(|joint| order.coordinate(joint)).collect();
        let poses = |points: usize| points.checked_pow(behind.len() as u32).unwrap_or(usize::MAX);
        let points = POSITIONS.into_iter().find(|points| poses(*points) <= MOST_POSES).unwrap_or(2);
        let positions = |joint: &usize| -> Vec<f64> {
            let (low, high) = (self.planning.q_min[*joint], self.planning.q_max[*joint]);
            (0..points).map(|i| low + (high - low) * i as f64 / (points - 1) as f64).collect()
        };
        let positions: Vec<_> = behind.iter().map(positions).collect();
        let mut work = Workspace::default();
        let mut inertia = |pose: &[f64]| {
            let mut q = JointVector::zeros(sizes);
            behind.iter().zip(pose).for_each(|(joint, position)| q[*joint] = *position);
            model.mass_matrix(&q, &mut work).unactuated()
        };
        let poses: Vec<_> = combinations(&positions).take(MOST_POSES).collect();
        let inertias: Vec<_> = poses.iter().map(|pose| inertia(pose)).collect();
        let largest =
            UnactuatedVector::from_fn(sizes, |i| inertias.iter().map(|m| m[(i, i)]).fold(0.0, f64::max));
        let shares = inertias.iter().map(|m| weakest(m, &largest).1);
        let Some((mut pose, _)) = poses.into_iter().zip(shares).min_by(|(_, a), (_, b)| a.total_cmp(b))
        else {
            return Ok(());
        };
        // Between the poses: joint by joint, within the distance of two of them.
        for (k, joint) in (0..2 * behind.len()).map(|k| (k % behind.len(), behind[k % behind.len()])) {
            let (low, high) = (self.planning.q_min[joint], self.planning.q_max[joint]);
            let step = (high - low) / (points - 1) as f64;
            let (mut from, mut to) = ((pose[k] - step).max(low), (pose[k] + step).min(high));
            let mut share = |position: f64| {
                pose[k] = position;
                weakest(&inertia(&pose), &largest).1
            };
            for _ in 0..40 {
                let (a, b) = (from + (to - from) / 3.0, to - (to - from) / 3.0);
                if share(a) <= share(b) { to = b } else { from = a }
            }
            let ends = [from, 0.5 * (from + to), to].map(|position| (position, share(position)));
            let best = ends.into_iter().min_by(|(_, a), (_, b)| a.total_cmp(b));
            pose[k] = best.map_or(from, |(position, _)| position);
        }
        let (i, share) = weakest(&inertia(&pose), &largest);
        if !(share > SMALLEST) {
            let mut q = JointVector::zeros(sizes);
            behind.iter().zip(&pose).for_each(|(joint, position)| q[*joint] = *position);
            let shown = |joint: &usize| {
                let (q, unit) = model.joint_kind(*joint).shown(q[*joint]);
                format!("{} {q:.4} {unit}", model.joint_name(*joint))
            };
            let place = behind.iter().map(shown).collect::<Vec<_>>().join(", ");
            let place = if place.is_empty() { "everywhere".to_owned() } else { format!("at {place}") };
            let joint = model.joint_name(sizes.actuated() + i);
            return Err(SettingsConflict::new(
                "limits",
                format!(
                    "ranges in which the unactuated joint `{joint}` moves a mass: M_UU is well conditioned"
                ),
                format!("a singular M_UU, or nearly so, {place}"),
                format!("narrow the ranges, or add the mass or inertia that is missing in {}", crate::URDF),
            ));
        }
        Ok(())
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
            let expected = format!("the {urdf} of joint `{}` in {}", model.joint_name(joint), crate::URDF);
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

/// Index of the unactuated joint with the smallest share, and that share: its inertia relative to its `largest` one, or, because it moves
/// with those before it, the pivot of M_UU = `m`, scaled to a diagonal of 1. Not a number counts as 0.
fn weakest(m: &UnactuatedMatrix, largest: &UnactuatedVector) -> (usize, f64) {
    let n = largest.len();
    // L of M_UU = L L'.
    let mut l = *m;
    let mut smallest = (0, f64::INFINITY);
    for j in 0..n {
        let pivot = m[(j, j)] - (0..j).map(|k| l[(j, k)] * l[(j, k)]).sum::<f64>();
        let share = (m[(j, j)] / largest[j]).min(pivot / m[(j, j)]).max(0.0);
        if share < smallest.1 {
            smallest = (j, share);
        }
        if !(pivot > 0.0) {
            return (j, 0.0);
        }
        l[(j, j)] = pivot.sqrt();
        for i in j + 1..n {
            let sum = m[(i, j)] - (0..j).map(|k| l[(i, k)] * l[(j, k)]).sum::<f64>();
            l[(i, j)] = sum / l[(j, j)];
        }
    }
    smallest
}
