//! Settings of the start poses of a trajectory database, `grid.toml`.

use crate::conflict::{SettingsConflict, degrees};
use crate::rule::{Finite, Positive, Rule, Whole};
use crate::{PendulumStart, RobotSettings};
use serde::Deserialize;
use upswing_model::NU;

/// Grid of start poses of a trajectory database: the Cartesian product of all axes; joints without an axis are at 0.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridSettings {
    /// One axis per varied joint, in the order of the file.
    #[serde(rename = "joints")]
    pub axes: Vec<GridAxis>,
    /// Angles of the pendulum at the start.
    pub start: PendulumStart,
    /// Largest angle of the hanging pendulum, rad; poses with a larger one are skipped.
    #[serde(rename = "max_rest_angle_deg", deserialize_with = "Positive::degrees")]
    pub max_rest_angle: f64,
}

/// Equally spaced angles of one joint, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridAxis {
    /// Index of the joint, counted from 0 (the file counts from 1).
    #[serde(deserialize_with = "Whole::<1, { NU as i64 }>::index")]
    pub joint: usize,
    /// First angle, rad.
    #[serde(rename = "from_deg", deserialize_with = "Finite::degrees")]
    pub from: f64,
    /// Last angle, rad; above `from`, or equal for one point.
    #[serde(rename = "to_deg", deserialize_with = "Finite::degrees")]
    pub to: f64,
    /// Number of angles, at least 1.
    #[serde(deserialize_with = "Whole::<1, { MOST_POSES as i64 }>::read")]
    pub points: usize,
}

impl GridAxis {
    /// Angle of the joint at a point of the axis, rad; points are counted from 0.
    pub fn angle(&self, point: usize) -> f64 {
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

    /// Angles of the actuated joints (rad) of pose `number`, counted from 0; the last axis varies fastest.
    pub fn pose(&self, number: usize) -> [f64; NU] {
        let mut pose = [0.0; NU];
        let mut left = number;
        for axis in self.axes.iter().rev() {
            pose[axis.joint] = axis.angle(left % axis.points);
            left /= axis.points;
        }
        pose
    }

    /// Checks the rules between the settings of the grid, and between them and the limits of the robot.
    pub(crate) fn validate(&self, robot: &RobotSettings) -> Result<(), SettingsConflict> {
        for (i, axis) in self.axes.iter().enumerate() {
            if self.axes[..i].iter().any(|known| known.joint == axis.joint) {
                let got = format!("joint {} twice", axis.joint + 1);
                return Err(SettingsConflict::new(
                    "joints.joint",
                    "each joint at most once",
                    got,
                    "remove one of them",
                ));
            }
            SettingsConflict::unless_within("joints.from_deg", axis.from, axis.joint, &robot.planning)?;
            SettingsConflict::unless_within("joints.to_deg", axis.to, axis.joint, &robot.planning)?;
            let (from, to) = (degrees(axis.from), degrees(axis.to));
            if axis.points == 1 && from != to {
                let expected = format!("a whole number from 2 to {MOST_POSES}");
                return Err(SettingsConflict::new(
                    "joints.points",
                    expected,
                    1,
                    "one point is from_deg and to_deg",
                ));
            }
            if axis.points > 1 {
                SettingsConflict::unless_above("joints.to_deg", to, from, "joints.from_deg")?;
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
