//! Harness for system tests in the style of hardware-in-the-loop: starts daemon, planner and simulated plant as separate processes in a
//! shared-memory domain of their own, sends requests, injects faults and checks the telemetry.
//!
//! ```no_run
//! use upswing_ipc::{Clock, Mode};
//! use upswing_tests::{START, System};
//!
//! let mut system = System::start(Clock::Lockstep, START);
//! system.bring_to(Mode::Balance);
//! system.inject("encoder-jump --joint pendulum_1 --amount -0.1");
//! let fault = system.wait_until("a fault", |record| record.mode() == Ok(Mode::Fault));
//! assert_eq!(upswingd::fault_text(fault.fault), Some("an angle jumped"));
//! system.end();
//! ```
//!
//! All methods panic with the cause of a failure: they are the assertions of a test. Tests run in parallel and tolerate the remains of
//! killed tests. A dropped system leaves nothing behind, except if its test fails: then the logs of the processes and a recording of
//! every cycle are kept, and their folder is printed.
//!
//! - [`System`]: three processes. [`System::inject`] injects a fault into the plant; [`System::kill`], [`System::restart`] and
//!   [`System::stall`] disturb processes; on the clock `lockstep` all of these happen at known cycles.
//! - [`matrix`]: controller and plant in one process, for many short runs: the fault matrix of `docs/faults.md`.
//! - [`running`]: a single program as a process.

pub mod matrix;
pub mod running;
mod system;

pub use system::{START, System};

use std::path::{Path, PathBuf};
use upswing_ipc::Telemetry;

/// Folder of the programs under test: the target folder, above that of the test programs.
///
/// # Panics
/// If a program is not built.
pub fn programs() -> PathBuf {
    let test = std::env::current_exe().expect("path of the test program");
    let folder = test.parent().and_then(|p| p.parent()).expect("target folder").to_owned();
    for program in ["upswing", "upswingd", "upswing-planner", "upswing-plant"] {
        let path = folder.join(program);
        assert!(path.exists(), "{} is not built: run `cargo test --release --workspace`", path.display());
    }
    folder
}

/// True if two telemetry records are equal, bit for bit.
pub fn same_bits(a: &Telemetry, b: &Telemetry) -> bool {
    a.words().eq(b.words())
}

/// Root folder of the repository.
///
/// # Panics
/// Never: the folder of this crate has a parent.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the folder above this crate")
}
