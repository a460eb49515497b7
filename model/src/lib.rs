//! Rigid-body dynamics of a ceiling-mounted serial chain whose last joints are unactuated.
//!
//! All quantities are SI. Vectors over joints run from the base to the tip: first the actuated joints
//! q_A, then the unactuated ones q_U. The state is x = [q, qd], the input u = qdd_A (4).

use nalgebra::SVector;

/// Number of actuated joints (q_A); with [`N_UNACTUATED`] the only place where a dimension is written down.
pub const N_ACTUATED: usize = 7;
/// Number of unactuated joints (q_U) at the end of the chain.
pub const N_UNACTUATED: usize = 2;
/// Number of joints, q.
pub const NQ: usize = N_ACTUATED + N_UNACTUATED;
/// Dimension of the state x = [q, qd].
pub const NX: usize = 2 * NQ;
/// Dimension of the input u = qdd_A.
pub const NU: usize = N_ACTUATED;

/// One number per joint (q in rad, qd in rad/s, ...).
pub type JointVector = SVector<f64, NQ>;
/// One number per actuated joint (torque in N m, u in rad/s^2).
pub type ActuatedVector = SVector<f64, NU>;
/// State x = [q, qd] (rad, rad/s).
pub type State = SVector<f64, NX>;
