//! The planner.
pub mod interior_point;
pub mod kkt;
pub mod problem;
