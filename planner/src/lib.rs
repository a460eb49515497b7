//! Plans of swing-ups and swing-downs: the trajectory database, replanning in milliseconds, and the planner process.
//!
//! - [`offline`]: the optimisation problem of the settings, solved for one start state; [`database`] applies it to a grid of
//!   start poses and finds the entries nearest to a start pose.
//! - [`replan`]: a plan from a measured start; [`continuous`]: the rest of a running plan, planned again from the newest state;
//!   [`predict`]: the state in which a moving system will be when a plan begins.
//! - [`wanted`]: a manoeuvre as a person asks for it; [`service`]: the planner process, which answers requests.

pub mod continuous;
pub mod database;
mod export;
pub mod offline;
pub mod predict;
pub mod replan;
mod request_error;
pub mod service;
pub mod wanted;

pub use export::{ExportError, export};
