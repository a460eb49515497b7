//! Numerics of optimal control for trajectories of N collocation intervals with a free duration.
//!
//! - [`problem`]: the swing-up (6), (8), (9), (11) as a nonlinear program; [`interior_point`] solves it from one guess,
//!   [`multistart`] from several of [`guess`], and names the limit that leaves no solution.
//! - [`qp`]: the quadratic program of a replan (16), and its solvers.
//! - [`kkt`]: the stage-wise factorisation underneath both; [`lqr`]: the gains (18)-(23); [`slab`]: the memory of all knots.
//!
//! Nothing here reads files or settings, starts threads or sends anything.

mod derivatives;
mod dims;
pub mod guess;
pub mod interior_point;
mod kernels;
pub mod kkt;
pub mod lqr;
pub mod multistart;
pub mod problem;
pub mod qp;
mod random;
pub mod slab;
