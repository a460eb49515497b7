//! The Python package `upswing`: thin classes around the functions of the libraries that the command line calls, too, so that both give
//! the same numbers.
//!
//! Vectors of joints have the order of the chain, from base to tip, as in files; [`chain`] converts at this edge. Arrays of any leading shape
//! are batches. Nothing here panics on bad input: errors become Python exceptions with the text of the Rust error.

mod array;
mod benchmark;
mod chain;
mod database;
mod errors;
mod model;
mod planning;
mod progress;
mod realaigym;
mod recording;
mod simulation;
mod system;
mod trajectory;

/// Classes and functions of the package; `upswing/__init__.py` exports them.
#[pyo3::pymodule(name = "_upswing")]
mod module {
    #[pymodule_export]
    use super::benchmark::{Benchmark, Score, score_table};
    #[pymodule_export]
    use super::database::{Database, build_database};
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::planning::{Optimum, Plan, Planner, lqr, optimize};
    #[pymodule_export]
    use super::realaigym::realaigym;
    #[pymodule_export]
    use super::recording::{read_recording, report_html};
    #[pymodule_export]
    use super::simulation::{ClosedLoop, Plant, Plants, Run, monte_carlo, random_starts};
    #[pymodule_export]
    use super::system::System;
    #[pymodule_export]
    use super::trajectory::Trajectory;
}
