//! Rigid-body dynamics of a serial chain of revolute joints whose last ones are unactuated.
//!
//! M(q) qdd + C(q, qd) qd + g(q) = [tau_A, 0] (1), partitioned into the actuated joints q_A and the
//! unactuated ones q_U (2). With the input u = qdd_A the state x = [q, qd] obeys the partially
//! feedback-linearised dynamics f(x, u) (4), (5), and the motor torque follows from u by (3b), (9).
//!
//! [`Model`] holds the constants of the robot; [`Workspace`] is the caller's scratch memory. Nothing
//! here allocates (but for making a [`Model`]), does I/O or differentiates numerically. SI units; joints
//! are ordered from base to tip.

pub mod coriolis;
mod derivatives;
mod description;
mod dynamics;
mod model;
mod period;
mod positive;
mod rest;
mod spatial;
mod start;
mod urdf;

pub use derivatives::{Derivatives, Hessian};
pub use description::{Urdf, UrdfJoint, UrdfJointKind, UrdfLink, UrdfShape, UrdfVisual};
pub use dynamics::{Accelerations, Workspace};
pub use model::{Limits, Model, Pose};
pub use period::Period;
pub use rest::RestError;
pub use start::StartError;
pub use urdf::UrdfError;

use nalgebra::{SMatrix, SVector};

/// Dimension of the input u = qdd_A and of the torque tau_A: the number of actuated joints q_A, which come first in the chain.
/// The dimensions of the robot follow from this number and [`N_UNACTUATED`].
pub const NU: usize = 7;
/// Number of unactuated joints, q_U, at the end of the chain.
pub const N_UNACTUATED: usize = 2;
/// Number of joints, q = [q_A, q_U].
pub const NQ: usize = NU + N_UNACTUATED;
/// Dimension of the state x = [q, qd].
pub const NX: usize = 2 * NQ;
/// Dimension of one collocation knot z = [x, u].
pub const NZ: usize = NX + NU;

/// One number per joint (q in rad, qd in rad/s).
pub type JointVector = SVector<f64, NQ>;
/// One number per actuated joint (u in rad/s^2, tau in N m).
pub type ActuatedVector = SVector<f64, NU>;
/// One number per unactuated joint.
pub type UnactuatedVector = SVector<f64, N_UNACTUATED>;
/// State x = [q, qd] (rad, rad/s).
pub type State = SVector<f64, NX>;
/// One row and column per actuated joint.
pub type ActuatedMatrix = SMatrix<f64, NU, NU>;
/// One row and column per joint.
pub type JointMatrix = SMatrix<f64, NQ, NQ>;

/// Joint positions q of a state, rad.
pub fn position(x: &State) -> JointVector {
    x.fixed_rows::<NQ>(0).into()
}

/// Joint velocities qd of a state, rad/s.
pub fn velocity(x: &State) -> JointVector {
    x.fixed_rows::<NQ>(NQ).into()
}

/// The state x = [q, qd] (rad, rad/s).
pub fn state(q: &JointVector, qd: &JointVector) -> State {
    let mut x = State::zeros();
    x.fixed_rows_mut::<NQ>(0).copy_from(q);
    x.fixed_rows_mut::<NQ>(NQ).copy_from(qd);
    x
}
