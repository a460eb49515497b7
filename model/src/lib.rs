//! Rigid-body dynamics of a serial chain of revolute joints whose last ones are unactuated.
//!
//! M(q) qdd + C(q, qd) qd + g(q) = [tau_A, 0] (1), partitioned into the actuated joints q_A and the
//! unactuated ones q_U (2). With the input u = qdd_A the state x = [q, qd] obeys the partially
//! feedback-linearised dynamics f(x, u) (4), (5), and the motor torque follows from u by (3b), (9).
//!
//! [`Model`] holds the constants of the robot; [`Workspace`] is scratch memory that the caller owns. Only the construction
//! of a [`Model`] allocates; nothing does I/O or differentiates numerically. SI units; joints are ordered from base to tip.

pub mod coriolis;
mod derivatives;
mod description;
mod dynamics;
mod friction;
mod integration;
mod limits;
mod model;
mod parts;
mod period;
mod positive;
mod rest;
mod spatial;
mod start;
pub mod thresholds;
mod urdf;
mod urdf_error;

pub use derivatives::{Derivatives, Hessian};
pub use description::{Urdf, UrdfJoint, UrdfJointKind, UrdfLink, UrdfShape, UrdfVisual};
pub use dynamics::{HybridDynamics, Workspace};
pub use friction::JointFriction;
pub use integration::runge_kutta_step;
pub use limits::{LimitKind, Limits};
pub use model::{Model, Pose};
pub use parts::{JointParts, StateParts};
pub use period::Period;
pub use rest::{RestError, TargetError};
pub use start::StartError;
pub use urdf_error::{UrdfElement, UrdfElementError, UrdfError, UrdfSyntaxError};

use nalgebra::{SMatrix, SVector};

/// Number of actuated joints: dimension of q_A, of the input u = qdd_A and of the motor torque tau_A. This and
/// [`N_UNACTUATED`] are the only places that state a dimension of the robot.
pub const NU: usize = 7;
/// Number of unactuated joints, which are the last ones of the chain: dimension of q_U.
pub const N_UNACTUATED: usize = 2;
/// Number of joints: dimension of q = [q_A, q_U].
pub const NQ: usize = NU + N_UNACTUATED;
/// Dimension of the state x = [q, qd].
pub const NX: usize = 2 * NQ;
/// Dimension of one collocation knot z = [x, u].
pub const NZ: usize = NX + NU;

/// One component per joint: q (rad), qd (rad/s), qdd (rad/s^2) or joint torques (N m).
pub type JointVector = SVector<f64, NQ>;
/// One component per actuated joint: q_A (rad), qd_A (rad/s), u (rad/s^2) or tau_A (N m).
pub type ActuatedVector = SVector<f64, NU>;
/// One component per unactuated joint: q_U (rad), qd_U (rad/s), qdd_U (rad/s^2) or torques (N m).
pub type UnactuatedVector = SVector<f64, N_UNACTUATED>;
/// State x = [q, qd], rad and rad/s, or its time derivative, rad/s and rad/s^2.
pub type State = SVector<f64, NX>;
/// Matrix with one row and one column per actuated joint, as M~ (10).
pub type ActuatedMatrix = SMatrix<f64, NU, NU>;
/// Matrix with one row and one column per joint, as M (1).
pub type JointMatrix = SMatrix<f64, NQ, NQ>;

/// The state x = [q, qd] of `q` (rad) and `qd` (rad/s).
pub fn state(q: &JointVector, qd: &JointVector) -> State {
    let mut x = State::zeros();
    x.q_mut().copy_from(q);
    x.qd_mut().copy_from(qd);
    x
}
