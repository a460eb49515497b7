//! Check of a requested state of the plant.

use upswing_config::RobotSettings;
use upswing_model::{JointVector, NQ, StartError};

/// Error of a requested state of the plant. Joints count from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StateError {
    /// An angle is not a number or outside the limits open to plans, or the pendulum has no rest position there.
    #[error(transparent)]
    Angle(#[from] StartError),
    /// A velocity is not a number or outside the limits of `robot.toml`.
    #[error("joint {joint}: expected a velocity from -{max:.1} to {max:.1} deg/s, got {got:.2}")]
    Velocity {
        /// Number of the joint, from 1.
        joint: usize,
        /// Speed limit, deg/s.
        max: f64,
        /// Velocity of the refused state, deg/s.
        got: f64,
    },
    /// The brakes are released: the daemon controls the state.
    #[error(
        "the brakes are released: stop or fault the daemon first, a state can be set only with closed brakes"
    )]
    BrakesReleased,
}

/// Fails unless all joint positions q (rad) and velocities qd (rad/s) are within the limits of the robot.
pub(crate) fn check_state(
    robot: &RobotSettings,
    q: &JointVector,
    qd: &JointVector,
) -> Result<(), StateError> {
    for i in 0..NQ {
        robot.planning.check_angle(i, q[i])?;
        let max = robot.limits.qd_max[i];
        // Written so that NaN is refused.
        if !(-max..=max).contains(&qd[i]) {
            return Err(StateError::Velocity {
                joint: i + 1,
                max: max.to_degrees(),
                got: qd[i].to_degrees(),
            });
        }
    }
    Ok(())
}
