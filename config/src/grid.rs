//! `grid.toml`: the start poses of a trajectory database.

use crate::check::{Check, POSITIVE};
use crate::{ConfigError, PendulumStart, RobotSettings};
use serde::Deserialize;
use upswing_model::NU;

/// Start poses of the database: the product of all axes; joints without an axis start at 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSettings {
    /// One axis per varied joint, in the order of the file.
    pub axes: Vec<GridAxis>,
    /// How the pendulum starts.
    pub start: PendulumStart,
    /// Poses in which an angle of the hanging pendulum is larger than this are left out, rad.
    pub max_rest_angle: f64,
}

/// Equally spaced angles of one joint, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridAxis {
    /// Index of the joint, counted from 0 (the file counts from 1).
    pub joint: usize,
    /// First angle, rad.
    pub from: f64,
    /// Last angle, rad, above `from` unless there is but one point.
    pub to: f64,
    /// Number of angles, at least 1.
    pub points: usize,
}

impl GridAxis {
    /// Angle of a point counted from 0, rad.
    pub fn angle(&self, point: usize) -> f64 {
        self.from + (self.to - self.from) * point as f64 / (self.points - 1).max(1) as f64
    }
}

/// More start poses than any database will have; keeps a slip of the pen from filling the memory.
const MOST_POSES: usize = 1_000_000;

impl GridSettings {
    /// Number of poses, those that are left out included.
    pub fn poses(&self) -> usize {
        self.axes.iter().map(|a| a.points).product()
    }

    /// The arm's angles (rad) of a pose, counted from 0; the last axis runs fastest.
    pub fn pose(&self, number: usize) -> [f64; NU] {
        let mut pose = [0.0; NU];
        let mut left = number;
        for axis in self.axes.iter().rev() {
            pose[axis.joint] = axis.angle(left % axis.points);
            left /= axis.points;
        }
        pose
    }

    pub(crate) fn read(file: &str, text: &str, robot: &RobotSettings) -> Result<Self, ConfigError> {
        let check = Check { file };
        let raw: RawGrid = check.parse(text)?;
        Ok(Self {
            axes: read_axes(check, &raw.joints, robot)?,
            start: raw.start,
            max_rest_angle: check
                .number("max_rest_angle_deg", raw.max_rest_angle_deg, &POSITIVE)?
                .to_radians(),
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawGrid {
    joints: Vec<RawAxis>,
    start: PendulumStart,
    max_rest_angle_deg: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAxis {
    joint: i64,
    from_deg: f64,
    to_deg: f64,
    points: i64,
}

fn read_axes(check: Check<'_>, raw: &[RawAxis], robot: &RobotSettings) -> Result<Vec<GridAxis>, ConfigError> {
    let mut axes: Vec<GridAxis> = Vec::with_capacity(raw.len());
    let mut poses = 1_usize;
    for axis in raw {
        let number: usize = check.integer("joints.joint", axis.joint, 1..=NU as i64)?;
        let joint = number - 1;
        if axes.iter().any(|known| known.joint == joint) {
            let got = format!("joint {number} twice");
            return Err(check.refuse("joints.joint", "each joint at most once", got, "remove one of them"));
        }
        let from = check.angle("joints.from_deg", axis.from_deg, joint, &robot.planning)?;
        let to = check.angle("joints.to_deg", axis.to_deg, joint, &robot.planning)?;
        let fewest = if axis.to_deg == axis.from_deg { 1 } else { 2 };
        let points = check.integer("joints.points", axis.points, fewest..=MOST_POSES as i64)?;
        if points > 1 {
            check.above("joints.to_deg", axis.to_deg, axis.from_deg, "joints.from_deg")?;
        }
        poses = poses.saturating_mul(points);
        axes.push(GridAxis { joint, from, to, points });
    }
    if axes.is_empty() || poses > MOST_POSES {
        let expected = format!("at least one joint and at most {MOST_POSES} start poses");
        let got = format!("{} joints, {poses} start poses", axes.len());
        return Err(check.refuse("joints", expected, got, "change the list or its numbers of points"));
    }
    Ok(axes)
}
