//! Swing-up trajectories xi (7), their spline (12), gains, checks and the database file.

/// Number of collocation intervals of a trajectory (the paper's N).
pub const N: usize = 100;
/// Number of knots x_0..x_N.
pub const KNOTS: usize = N + 1;
