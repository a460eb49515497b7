//! Limits of the joints of a robot.

use crate::{ActuatedVector, JointKind, JointVector, Sizes};

/// Limits of positions, velocities and motor torques, joint by joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest position of each joint, rad or m.
    pub q_min: JointVector,
    /// Highest position of each joint, rad or m.
    pub q_max: JointVector,
    /// Highest speed of each joint in both directions, rad/s or m/s.
    pub qd_max: JointVector,
    /// Highest torque of each motor in both directions, N m or N.
    pub tau_max: ActuatedVector,
}

/// The quantity that a limit bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitKind {
    /// q, rad or m.
    Position,
    /// qd, rad/s or m/s.
    Velocity,
    /// tau_A, N m or N.
    Torque,
}

impl Limits {
    /// Lower and upper limit of the joint of index `joint` in sorted vectors, in the unit of `kind`. Torques have limits for actuated joints only.
    pub fn range(&self, kind: LimitKind, joint: usize) -> (f64, f64) {
        match kind {
            LimitKind::Position => (self.q_min[joint], self.q_max[joint]),
            LimitKind::Velocity => (-self.qd_max[joint], self.qd_max[joint]),
            LimitKind::Torque => (-self.tau_max[joint], self.tau_max[joint]),
        }
    }

    /// Largest distance from 0 that the position limits of the joint of index `joint` in sorted vectors allow, rad or m: the scale of a
    /// drawing.
    pub fn largest_position(&self, joint: usize) -> f64 {
        self.q_max[joint].abs().max(self.q_min[joint].abs())
    }

    /// These limits, with pi (rad or m, also per second) instead of an infinite one: the scale of a drawing.
    pub fn scale(&self) -> Self {
        let finite = |v: f64| if v.is_finite() { v } else { std::f64::consts::PI.copysign(v) };
        Self {
            q_min: self.q_min.map(finite),
            q_max: self.q_max.map(finite),
            qd_max: self.qd_max.map(finite),
            ..*self
        }
    }
}

impl LimitKind {
    /// The kind of the limit of a row of the state x = [q, qd], and the index of the joint of that row in sorted vectors.
    pub fn of_row(row: usize, sizes: Sizes) -> (Self, usize) {
        let joints = sizes.joints();
        if row < joints { (Self::Position, row) } else { (Self::Velocity, row - joints) }
    }

    /// Unit of the quantity of a joint.
    pub fn unit(self, joint: JointKind) -> &'static str {
        match (self, joint) {
            (Self::Position, JointKind::Prismatic) => "m",
            (Self::Velocity, JointKind::Prismatic) => "m/s",
            (Self::Torque, JointKind::Prismatic) => "N",
            (Self::Position, _) => "rad",
            (Self::Velocity, _) => "rad/s",
            (Self::Torque, _) => "N m",
        }
    }
}

impl std::fmt::Display for LimitKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Torque => "torque",
        })
    }
}
