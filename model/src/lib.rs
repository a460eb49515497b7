//! Rigid-body dynamics of a serial chain of revolute and prismatic joints, some of which are unactuated.
//!
//! M(q) qdd + C(q, qd) qd + g(q) = [tau_A, 0] (1), partitioned into the actuated joints q_A and the
//! unactuated ones q_U (2), which may stand anywhere in the chain. With the input u = qdd_A the state x = [q, qd] obeys the partially
//! feedback-linearised dynamics f(x, u) (4), (5), and the motor torque follows from u by (3b), (9).
//!
//! [`Model`] holds the constants of the robot; [`Workspace`] is scratch memory that the caller owns. Only the construction
//! of a [`Model`] or of a [`Linearization`] allocates; nothing does I/O or differentiates numerically. SI units: positions, velocities and
//! forces of a revolute joint in rad, rad/s, N m, those of a prismatic joint in m, m/s, N. Vectors are sorted, the actuated joints first;
//! [`Order`] converts from and to the chain's order, from base to tip.

pub mod coriolis;
mod description;
mod dims;
mod dynamics;
mod friction;
mod integration;
mod limits;
mod linearization;
mod model;
mod order;
mod period;
mod posture;
mod rest;
mod scalar;
mod spatial;
mod start;
pub mod thresholds;
mod urdf;
mod urdf_edit;
mod urdf_error;
mod vector;

pub use description::{Urdf, UrdfJoint, UrdfJointKind, UrdfLink, UrdfShape, UrdfVisual};
pub use dims::{Dims, Fixed};
pub use dynamics::{HybridDynamics, HybridValues, Workspace};
pub use friction::JointFriction;
pub use integration::runge_kutta_step;
pub use limits::{LimitKind, Limits};
pub use linearization::Linearization;
pub use model::{JointKind, Model, Pose};
pub use order::Order;
pub use period::Period;
pub use posture::Posture;
pub use rest::{RestError, TargetError};
pub use scalar::{Lanes, Scalar};
pub use start::StartError;
pub use urdf_error::{UrdfElement, UrdfElementError, UrdfError, UrdfSyntaxError};
pub use vector::{
    Actuated, ActuatedMatrix, ActuatedVector, JointMatrix, JointVector, Joints, LARGEST_STATE, MOST_JOINTS,
    Matrix, Sizes, Space, State, States, Unactuated, UnactuatedMatrix, UnactuatedVector, Vector,
};
