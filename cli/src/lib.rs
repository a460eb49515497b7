//! The operator's side of upswing: starts systems of three processes, drives a swing-up, reports and draws it.
//!
//! The `upswing` program is a thin layer of commands over this library; the end-to-end tests use it, too.

pub mod cli;
pub mod closed_loop;
pub mod commands;
mod http;
pub mod live;
mod metrics;
pub mod monitor;
pub mod montecarlo;
pub mod operator;
mod page;
mod parse;
mod picture;
pub mod recording;
pub mod replay;
pub mod report;
pub mod robot;
pub mod session;
mod soak;
pub mod swing_up;
pub mod web;
