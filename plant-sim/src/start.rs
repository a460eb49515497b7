//! Check of a requested state of the plant.

use upswing_config::RobotSettings;
use upswing_model::{JointVector, Model, Sizes, StartError};

/// Error of a requested state of the plant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StateError {
    /// The state is that of another chain.
    #[error(
        "expected a state of {} joints, {} of them actuated, got {} and {}",
        .expected.joints(), .expected.actuated(), .got.joints(), .got.actuated()
    )]
    OtherChain {
        /// Numbers of joints of the plant.
        expected: Sizes,
        /// Numbers of joints of the refused state.
        got: Sizes,
    },
    /// A position is not a number or outside the limits open to plans, or the unactuated joints have no rest position there.
    #[error(transparent)]
    Position(#[from] StartError),
    /// A velocity is not a number or outside the limits of `robot.toml`.
    #[error("velocity of joint `{joint}`: expected -{max:.1} to {max:.1} {unit}/s, got {got:.2} {unit}/s")]
    Velocity {
        /// Name of the joint.
        joint: String,
        /// Speed limit, `unit` per second.
        max: f64,
        /// Velocity of the refused state, `unit` per second.
        got: f64,
        /// deg or m.
        unit: &'static str,
    },
    /// The brakes are released: the daemon controls the state.
    #[error(
        "the brakes are released: stop or fault the daemon first, a state can be set only with closed brakes"
    )]
    BrakesReleased,
}

/// Fails unless all joint positions q (rad or m) and velocities qd (rad/s or m/s) are within the limits of the robot.
pub(crate) fn check_state(
    model: &Model,
    robot: &RobotSettings,
    q: &JointVector,
    qd: &JointVector,
) -> Result<(), StateError> {
    let expected = model.sizes();
    if let Some(got) = [q.sizes(), qd.sizes()].into_iter().find(|got| *got != expected) {
        return Err(StateError::OtherChain { expected, got });
    }
    for i in 0..expected.joints() {
        model.check_position(&robot.planning, i, q[i])?;
        let max = robot.limits.qd_max[i];
        // Written so that NaN is refused.
        if !(-max..=max).contains(&qd[i]) {
            let joint = model.joint_name(i).to_owned();
            let [(max, unit), (got, _)] = [max, qd[i]].map(|v| model.joint_kind(i).shown(v));
            return Err(StateError::Velocity { joint, max, got, unit });
        }
    }
    Ok(())
}
