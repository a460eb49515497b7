//! Settings of the start poses of a trajectory database, `grid.toml`.

use crate::conflict::{SettingsConflict, in_file, unit};
use crate::file::TextFile;
use crate::rule::{Finite, Positive, Rule, Whole};
use crate::{ConfigError, PendulumStart, RobotSettings};
use serde::Deserialize;
use toml::Spanned;
use upswing_model::{ActuatedVector, Model, Sizes};

/// Grid of start poses of a trajectory database: the Cartesian product of all axes; joints without an axis are at 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSettings {
    /// Numbers of joints of the robot.
    pub sizes: Sizes,
    /// One axis per varied joint, in the order of the file.
    pub axes: Vec<GridAxis>,
    /// Positions of the unactuated joints at the start.
    pub start: PendulumStart,
    /// Largest angle of the hanging pendulum, rad; poses with a larger one are skipped.
    pub max_rest_angle: f64,
}

/// Equally spaced positions of one joint, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridAxis {
    /// Index of the joint in q_A.
    pub joint: usize,
    /// First position, rad or m.
    pub from: f64,
    /// Last position, rad or m; above `from`, or equal for one point.
    pub to: f64,
    /// Number of positions, at least 1.
    pub points: usize,
}

/// A grid as a file states it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GridInFile {
    joints: Vec<Spanned<AxisInFile>>,
    start: PendulumStart,
    #[serde(rename = "max_rest_angle_deg", deserialize_with = "Positive::degrees")]
    max_rest_angle: f64,
}

/// An axis as a file states it, with the keys of one of both units.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisInFile {
    joint: String,
    #[serde(default, deserialize_with = "Finite::degrees")]
    from_deg: Option<f64>,
    #[serde(default, deserialize_with = "Finite::degrees")]
    to_deg: Option<f64>,
    #[serde(default, deserialize_with = "Finite::read")]
    from_m: Option<f64>,
    #[serde(default, deserialize_with = "Finite::read")]
    to_m: Option<f64>,
    #[serde(deserialize_with = "Whole::<1, { MOST_POSES as i64 }>::read")]
    points: usize,
}

impl AxisInFile {
    /// The axis, or what is wrong: a `reason` for [`TextFile::error`].
    fn axis(self, model: &Model) -> Result<GridAxis, String> {
        let Self { joint: name, from_deg, to_deg, from_m, to_m, points } = self;
        let actuated = 0..model.sizes().actuated();
        let Some(joint) = actuated.clone().find(|joint| model.joint_name(*joint) == name) else {
            let names: Vec<_> = actuated.map(|joint| model.joint_name(joint)).collect();
            let (names, urdf) = (names.join(", "), crate::URDF.name);
            return Err(format!(".joint: expected one of {names}, got `{name}` (joints of {urdf})"));
        };
        let ends = match unit(model.joint_kind(joint)) {
            "m" => [("from_m", from_m, from_deg), ("to_m", to_m, to_deg)],
            _ => [("from_deg", from_deg, from_m), ("to_deg", to_deg, to_m)],
        };
        let [from, to] = ends.map(|(key, end, in_other_unit)| match (end, in_other_unit) {
            (Some(end), None) => Ok(end),
            _ => Err(format!(".{key}: expected a position of joint `{name}` in this unit only")),
        });
        Ok(GridAxis { joint, from: from?, to: to?, points })
    }
}

impl GridAxis {
    /// Position of the joint at a point of the axis, rad or m; points are counted from 0.
    pub fn position(&self, point: usize) -> f64 {
        self.from + (self.to - self.from) * point as f64 / (self.points - 1).max(1) as f64
    }
}

/// Largest number of start poses, so that a typing error does not exhaust the memory.
const MOST_POSES: usize = 1_000_000;

impl GridSettings {
    /// Number of poses, including skipped ones.
    pub fn poses(&self) -> usize {
        self.axes.iter().map(|axis| axis.points).product()
    }

    /// Positions of the actuated joints (rad or m) of pose `number`, counted from 0; the last axis varies fastest.
    pub fn pose(&self, number: usize) -> ActuatedVector {
        let mut pose = ActuatedVector::zeros(self.sizes);
        let mut left = number;
        for axis in self.axes.iter().rev() {
            pose[axis.joint] = axis.position(left % axis.points);
            left /= axis.points;
        }
        pose
    }

    /// Reads the grid in `file`.
    pub(crate) fn read(file: &TextFile, robot: &RobotSettings, model: &Model) -> Result<Self, ConfigError> {
        let GridInFile { joints, start, max_rest_angle } = file.parse(model)?;
        let axes = joints.into_iter().map(|axis| {
            let at = axis.span().start;
            axis.into_inner().axis(model).map_err(|reason| file.error(at, Some("joints".into()), reason))
        });
        let grid =
            Self { sizes: model.sizes(), axes: axes.collect::<Result<_, _>>()?, start, max_rest_angle };
        grid.validate(robot, model).map_err(|conflict| file.refuse(conflict))?;
        Ok(grid)
    }

    /// Checks the rules between the settings of the grid, and between them and the limits of the robot.
    fn validate(&self, robot: &RobotSettings, model: &Model) -> Result<(), SettingsConflict> {
        for (i, axis) in self.axes.iter().enumerate() {
            if self.axes[..i].iter().any(|known| known.joint == axis.joint) {
                let got = format!("joint `{}` twice", model.joint_name(axis.joint));
                return Err(SettingsConflict::new(
                    "joints.joint",
                    "each joint at most once",
                    got,
                    "remove one of them",
                ));
            }
            let kind = model.joint_kind(axis.joint);
            for (key, position) in [("joints.from", axis.from), ("joints.to", axis.to)] {
                SettingsConflict::unless_within(key, position, axis.joint, &robot.planning, model)?;
            }
            let [from, to] = [axis.from, axis.to].map(|q| in_file(kind, q));
            if axis.points == 1 && from != to {
                let expected = format!("a whole number from 2 to {MOST_POSES}");
                return Err(SettingsConflict::new("joints.points", expected, 1, "one point is both ends"));
            }
            if axis.points > 1 {
                let [to_key, from_key] = ["to", "from"].map(|end| format!("joints.{end}_{}", unit(kind)));
                SettingsConflict::unless_above(to_key, to, from, &from_key)?;
            }
        }
        let poses = self.axes.iter().fold(1, |poses: usize, axis| poses.saturating_mul(axis.points));
        if self.axes.is_empty() || poses > MOST_POSES {
            let expected = format!("at least one joint and at most {MOST_POSES} start poses");
            let got = format!("{} joints, {poses} start poses", self.axes.len());
            return Err(SettingsConflict::new(
                "joints",
                expected,
                got,
                "change the list or its numbers of points",
            ));
        }
        Ok(())
    }
}
