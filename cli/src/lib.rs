//! The command line of upswing: parses, calls, prints.
//!
//! The `upswing` program can also run as any of the three processes.

pub mod cli;
pub mod commands;
mod parse;
