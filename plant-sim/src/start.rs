//! Which states the plant can be put into, and the pose after power-up.

use std::f64::consts::TAU;
use upswing_config::{Config, PendulumStart, RobotSettings};
use upswing_model::{JointVector, Model, N_ACTUATED, NQ, NU, RestError, Workspace};

/// Why the plant cannot be put into a state. Joints count from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StateError {
    /// An angle is not a number or outside the limits of `robot.toml` (with the margin that plans have).
    #[error("joint {joint}: expected an angle from {low} to {high} deg, got {got}")]
    Angle {
        /// The joint.
        joint: usize,
        /// Lowest angle, deg.
        low: f64,
        /// Highest angle, deg.
        high: f64,
        /// What came, deg.
        got: f64,
    },
    /// A velocity is not a number or outside the limits of `robot.toml`.
    #[error("joint {joint}: expected a velocity from -{max} to {max} deg/s, got {got}")]
    Velocity {
        /// The joint.
        joint: usize,
        /// Highest speed, deg/s.
        max: f64,
        /// What came, deg/s.
        got: f64,
    },
    /// The pose has no hanging equilibrium of the pendulum.
    #[error(
        "the pendulum has no rest in this pose ({0}): choose another pose, or start the pendulum at `zero`"
    )]
    NoRest(#[from] RestError),
    /// The pose has a hanging equilibrium, but beyond the limits: there the real pendulum lies on its stop.
    #[error(
        "the pendulum of this pose hangs at rest with joint {joint} at {got} deg: expected {low} to {high} deg; \
         choose q2 - q4 + q6 closer to 90 deg, or start the pendulum at `zero`"
    )]
    RestOutside {
        /// The joint.
        joint: usize,
        /// Lowest angle, deg.
        low: f64,
        /// Highest angle, deg.
        high: f64,
        /// The angle of rest, deg.
        got: f64,
    },
    /// The state of a plant with released brakes is the daemon's.
    #[error(
        "the brakes are released: stop or fault the daemon first, a state can be set only with closed brakes"
    )]
    BrakesReleased,
}

/// The pose that the settings start with (rad).
pub(crate) fn start_position(config: &Config) -> Result<JointVector, StateError> {
    let start = &config.plant.start;
    let mut q = JointVector::zeros();
    for i in 0..NU {
        q[i] = start.q[i];
        check_angle(&config.robot, i, q[i])?;
    }
    match start.pendulum {
        PendulumStart::Zero => Ok(q),
        PendulumStart::Rest => rest(&config.model, &config.robot, &q),
    }
}

fn rest(model: &Model, robot: &RobotSettings, q: &JointVector) -> Result<JointVector, StateError> {
    let mut q = model.rest_position(q, &mut Workspace::default())?;
    for i in N_ACTUATED..NQ {
        // The search may end a few turns away.
        q[i] -= TAU * (q[i] / TAU).round();
        check_angle(robot, i, q[i]).map_err(|e| match e {
            StateError::Angle { joint, low, high, got } => StateError::RestOutside { joint, low, high, got },
            other => other,
        })?;
    }
    Ok(q)
}

/// Fails unless all of q (rad) and qd (rad/s) are within what the robot can do.
pub(crate) fn check_state(
    robot: &RobotSettings,
    q: &JointVector,
    qd: &JointVector,
) -> Result<(), StateError> {
    for i in 0..NQ {
        check_angle(robot, i, q[i])?;
        let max = robot.limits.qd_max[i];
        // Written so that NaN is refused.
        if !(-max..=max).contains(&qd[i]) {
            return Err(StateError::Velocity { joint: i + 1, max: degrees(max), got: degrees(qd[i]) });
        }
    }
    Ok(())
}

fn check_angle(robot: &RobotSettings, i: usize, angle: f64) -> Result<(), StateError> {
    // The limits of plans: those of the robot, and room for the pendulum to overshoot.
    let (low, high) = (robot.planning.q_min[i], robot.planning.q_max[i]);
    if (low..=high).contains(&angle) {
        return Ok(());
    }
    Err(StateError::Angle { joint: i + 1, low: degrees(low), high: degrees(high), got: degrees(angle) })
}

/// An angle as a message shows it: deg, without the rounding errors of the way to rad and back.
fn degrees(rad: f64) -> f64 {
    (rad.to_degrees() * 1e6).round() / 1e6
}
