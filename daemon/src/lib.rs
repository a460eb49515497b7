//! The 125 us control daemon: keeps the robot in one of a few modes (ARCHITECTURE.md lists them), follows the plans
//! of the planner and gives up in time.
//!
//! | module | what |
//! |---|---|
//! | [`controller`] | one cycle: measurement in, command out; a pure function of measurement, time and its own state |
//! | `observer`, [`filter`] | the state x from measurements, and whether it can be trusted |
//! | `arm`, `law` | the reference of Hold and Stop, the torque law (24) |
//! | `standstill` | encoders that are stuck |
//! | `disturbance` | the torque that acts besides the commanded one, to be taken off it |
//! | [`supervisor`], `checks`, [`trip`] | the table of modes, the levels that are watched, what is beyond them |
//! | [`plan`], `loads` | which plans it may run, which one it has |
//! | `realtime` | the thread that runs the cycle on time |
//! | [`os`] | scheduler and memory calls, and what the system refuses of them |
//! | [`service`] | the thread that does all the rest |
//! | `cycle_log`, [`histogram`], `overrun`, [`flight`] | what it keeps of the cycles: statistics, causes of overruns, the flight recorder |
//! | [`recovery`] | what follows a lost balance |

// `.ci/rtsan` builds with this: the functions of the cycle then end the process if they allocate, lock or block.
#![cfg_attr(rtsan, feature(sanitize))]

mod arm;
mod checks;
pub mod controller;
mod cycle_log;
mod disturbance;
pub mod filter;
pub mod flight;
pub mod histogram;
mod law;
mod loads;
mod modes;
mod observer;
pub mod os;
mod overrun;
pub mod plan;
mod realtime;
pub mod recovery;
pub mod service;
mod standstill;
pub mod step;
pub mod supervisor;
pub mod trip;

pub use trip::{fault_text, warning_texts};

use upswing_ipc::Domain;
use upswing_process::{Failure, ProcessArgs, shutdown_flag};

/// Runs the daemon until SIGINT, SIGTERM or SIGHUP; the main function of a process.
///
/// # Errors
/// [`Failure::BadInput`] for settings or a domain name that cannot be used, otherwise as [`service::serve`].
pub fn run(args: &ProcessArgs) -> Result<(), Failure> {
    let config = args.load()?;
    let domain = Domain::new(&args.domain).map_err(|e| Failure::BadInput(e.to_string()))?;
    let shutdown = shutdown_flag()?;
    service::serve(&config, &domain, &shutdown)
}
