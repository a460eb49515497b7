//! Harness for hardware-in-the-loop style tests: starts a whole system, the three programs as separate processes
//! in a shared-memory domain of its own, drives it, breaks it and looks at its telemetry.
//!
//! ```no_run
//! use upswing_ipc::{Clock, Mode};
//! use upswing_tests::{START, System};
//!
//! let mut system = System::start(Clock::Lockstep, START);
//! system.bring_to(Mode::Balance);
//! system.inject("encoder-jump --joint 8 --amount -0.1");
//! let fault = system.wait_until("a fault", |record| record.mode() == Ok(Mode::Fault));
//! assert_eq!(upswingd::fault_text(fault.fault), Some("an angle jumped"));
//! system.end();
//! ```
//!
//! All methods panic with what went wrong: they are the assertions of a test. Tests run in parallel and beside the ruins of
//! killed ones. A system that is dropped leaves nothing behind; if its test fails it keeps the logs of its processes and
//! every cycle as a recording, and says where.
//!
//! - [`System`]: three processes. [`System::inject`] breaks the plant; [`System::kill`], [`System::restart`] and
//!   [`System::stall`] break processes; on the clock `lockstep` all of it happens at known cycles.
//! - [`matrix`]: controller and plant in one process, for many short runs: the fault matrix of `docs/faults.md`.
//! - [`running`]: one program alone.

pub mod matrix;
pub mod running;
mod system;

pub use system::{START, System};

use std::path::{Path, PathBuf};
use upswing_ipc::Telemetry;

/// Folder of the programs under test: that of the test programs' parent.
///
/// # Panics
/// If they are not built.
pub fn programs() -> PathBuf {
    let test = std::env::current_exe().expect("path of the test program");
    let folder = test.parent().and_then(|p| p.parent()).expect("target folder").to_owned();
    for program in ["upswing", "upswingd", "upswing-planner", "upswing-plant"] {
        let path = folder.join(program);
        assert!(path.exists(), "{} is not built: run `cargo test --release --workspace`", path.display());
    }
    folder
}

/// Whether every number of two records is the same, bit for bit.
pub fn same_bits(a: &Telemetry, b: &Telemetry) -> bool {
    a.words().eq(b.words())
}

/// The folder of the project.
///
/// # Panics
/// Never: this crate has a folder in it.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the folder above this crate")
}
