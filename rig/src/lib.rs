//! Whole systems for tests and studies: daemon, planner and plant as three processes in a shared-memory domain of their own
//! ([`session`]), or controller and simulated plant in one process ([`closed_loop`]). Both execute manoeuvres step by step
//! ([`course`]): once, from many random starts ([`montecarlo`]), to compare planners and controllers
//! ([`benchmark`], [`realaigym`]), or repeatedly while processes are killed ([`soak`]).

pub mod benchmark;
pub mod closed_loop;
pub mod course;
pub mod fault_args;
pub mod montecarlo;
pub mod realaigym;
pub mod session;
pub mod soak;
