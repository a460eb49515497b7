//! Swing-up trajectories, offline and in milliseconds.
//!
//! - [`problem`]: (6), (8), (9), (11) as an optimisation problem; [`interior_point`] solves it, [`kkt`] is the
//!   structured linear algebra underneath, [`offline`] applies them to a configuration, [`build`] makes databases with it.
//! - [`nearest`]: the K-D tree over database entries; [`qp`]: (16); [`replan`]: both together with
//!   [`lqr`], the gains (23). [`service`]: the process that answers requests; [`predict`]: where a moving start will be.
//! - [`coriolis`]: the bound c of (11) by random states.

pub mod build;
pub mod coriolis;
pub mod interior_point;
pub mod kkt;
pub mod lqr;
pub mod nearest;
pub mod offline;
pub mod predict;
pub mod problem;
pub mod qp;
pub mod replan;
mod rows;
pub mod service;
