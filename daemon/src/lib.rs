//! The 125 us control daemon: keeps the robot in one of a few modes (ARCHITECTURE.md lists them), follows the plans
//! of the planner and gives up in time.
//!
//! | module | what |
//! |---|---|
//! | [`controller`] | one cycle: measurement in, command out; a pure function of measurement, time and its own state |
//! | [`filter`], [`law`] | what the cycle computes: velocities, the torque law (24) |
//! | [`supervisor`], [`checks`] | what it decides: the table of modes, the trip levels |
//! | [`plan`] | which plans it may run |
//! | [`realtime`] | the thread that runs the cycle on time |
//! | [`service`] | the thread that does all the rest |

pub mod checks;
pub mod controller;
pub mod filter;
pub mod law;
mod os;
pub mod plan;
pub mod realtime;
pub mod service;
pub mod supervisor;

pub use supervisor::fault_text;

use upswing_config::process::{Failure, ProcessArgs, shutdown_flag, start_logging};
use upswing_ipc::Domain;

/// Command line of the daemon.
#[derive(Clone, Debug, clap::Args)]
pub struct DaemonArgs {
    /// Options of every process.
    #[command(flatten)]
    pub process: ProcessArgs,
}

/// Runs the daemon until SIGINT, SIGTERM or SIGHUP; the main function of a process.
///
/// # Errors
/// [`Failure::BadInput`] for settings or a domain name that cannot be used, otherwise as [`service::serve`].
pub fn run(args: DaemonArgs) -> Result<(), Failure> {
    start_logging();
    let config = args.process.load()?;
    let domain = Domain::new(&args.process.domain).map_err(|e| Failure::BadInput(e.to_string()))?;
    let shutdown = shutdown_flag()?;
    service::serve(&config, &domain, &shutdown)
}
