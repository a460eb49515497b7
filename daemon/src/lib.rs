//! The 125 us control daemon: keeps the robot in one of six modes (ARCHITECTURE.md lists them), follows the plans of the planner,
//! and trips to Stop or Fault before a limit is exceeded.
//!
//! | module | contents |
//! |---|---|
//! | [`controller`] | one control cycle: a pure function of its input and its own state |
//! | [`step`] | input and output of one step of the controller, and the recorded form of the input |
//! | `modes`, `arm` | the data of each mode: plan and setpoint of Track and Balance, reference of the arm in Hold and Stop |
//! | [`supervisor`], `checks`, [`trip`] | the table of modes; the limits with their warning and trip levels; causes of trips |
//! | `observer`, [`filter`] | the state x from measurements, and the reason why it cannot be trusted |
//! | `disturbance`, `standstill` | the torque that the model does not explain; encoders that are stuck |
//! | `law` | the torque law (24) and the torque limiter |
//! | [`plan`], `sent_plans` | the check of a plan that arrives; the plan that the controller has loaded |
//! | `realtime` | the real-time thread, which runs the cycle on time |
//! | [`os`] | scheduler and memory settings, and those that the system refuses |
//! | [`service`] | the service thread: requests, plans, telemetry, plants |
//! | `cycle_log`, [`histogram`], `overrun`, [`flight`] | statistics of the cycles, causes of overruns, the flight recorder |
//! | [`recovery`] | the next swing-up after a lost balance |

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
mod modes;
mod observer;
pub mod os;
mod overrun;
pub mod plan;
mod realtime;
pub mod recovery;
mod sent_plans;
pub mod service;
mod standstill;
pub mod step;
pub mod supervisor;
pub mod trip;

pub use trip::{fault_text, warning_texts};

use upswing_ipc::Domain;
use upswing_process::{Failure, ProcessArgs, shutdown_flag};

/// Runs the daemon until SIGINT, SIGTERM or SIGHUP, as the main function of a process.
///
/// # Errors
/// [`Failure::BadInput`] for invalid settings or an invalid domain name; otherwise the errors of [`service::serve`].
pub fn run(args: &ProcessArgs) -> Result<(), Failure> {
    let config = args.load()?;
    let domain = Domain::new(&args.domain).map_err(Failure::bad_input)?;
    let shutdown = shutdown_flag()?;
    service::serve(&config, &domain, &shutdown)
}
