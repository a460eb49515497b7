//! Systems for tests and studies: three processes in a domain of their own ([`session`]), or controller and simulated plant in one
//! process ([`closed_loop`]). Both take the course of a manoeuvre ([`course`]): once, from many random starts ([`montecarlo`]), or
//! many times in a row while processes are killed ([`soak`]).

pub mod closed_loop;
pub mod course;
pub mod fault_args;
pub mod montecarlo;
pub mod session;
pub mod soak;
