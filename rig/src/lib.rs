//! Systems for tests and studies: three processes in a domain of their own ([`session`]), or controller and simulated plant in one
//! process ([`closed_loop`]), and what is done with them: a swing-up ([`swing_up`]), the same from many random starts
//! ([`montecarlo`]), many in a row while processes are killed ([`soak`]).

pub mod closed_loop;
pub mod fault_args;
pub mod montecarlo;
pub mod session;
pub mod soak;
pub mod swing_up;
