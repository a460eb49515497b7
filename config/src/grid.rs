//! Grids of the start poses of a trajectory database.

use upswing_model::{ActuatedVector, Sizes};

/// Grid of start poses of a trajectory database: the Cartesian product of all axes; joints without an axis are at 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSettings {
    /// Numbers of joints of the robot.
    pub sizes: Sizes,
    /// One axis per varied joint, in the order of the file.
    pub axes: Vec<GridAxis>,
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

impl GridAxis {
    /// Position of the joint at a point of the axis, rad or m; points are counted from 0.
    pub fn position(&self, point: usize) -> f64 {
        self.from + (self.to - self.from) * point as f64 / (self.points - 1).max(1) as f64
    }
}

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
}
