//! Command line of upswing: parses arguments, calls the libraries, prints results.
//!
//! The `upswing` program can also run as daemon, planner or plant.

pub mod cli;
pub mod commands;
mod parse;
