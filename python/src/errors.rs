//! Python exceptions for the errors of the libraries.

use pyo3::PyErr;
use std::fmt::Display;
use upswing_process::Failure;

mod python {
    //! The exceptions of `upswing/errors.py`.
    pyo3::import_exception!(upswing.errors, UpswingError);
    pyo3::import_exception!(upswing.errors, InputError);
    pyo3::import_exception!(upswing.errors, NoPlan);
    pyo3::import_exception!(upswing.errors, Aborted);
}

pub use python::UpswingError;

/// `InputError`, also a `ValueError`: an argument, a file or a setting cannot be used.
pub fn input(e: impl Display) -> PyErr {
    python::InputError::new_err(e.to_string())
}

/// `UpswingError`: the computation failed.
pub fn failed(e: impl Display) -> PyErr {
    UpswingError::new_err(e.to_string())
}

/// `NoPlan`: no plan keeps all limits.
pub fn no_plan(e: impl Display) -> PyErr {
    python::NoPlan::new_err(e.to_string())
}

/// `Aborted`: a run in closed loop ended early.
pub fn aborted(e: impl Display) -> PyErr {
    python::Aborted::new_err(e.to_string())
}

/// The exception for the kind of a failure of the command line.
pub fn of_failure(failure: Failure) -> PyErr {
    match failure {
        Failure::BadInput(text) => input(text),
        Failure::Failed(text) => failed(text),
    }
}
