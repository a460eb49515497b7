//! The simulated robot: dynamics (1) of arm and pendulum, drives, encoders and brakes.
//!
//! [`Plant`] is the physics: pure, deterministic, without clock or shared memory, to be coupled with a controller
//! in the same process. [`run`] is the process around it, which advances on one of three clocks:
//!
//! - `wall`: cycle n begins at a deadline of CLOCK_MONOTONIC and applies the newest command.
//! - `paced`: cycle n waits for the command that answers measurement n, and lasts at least one period. Until the
//!   first command arrives, time goes on with closed brakes.
//! - `lockstep`: as `paced`, without deadlines, and only up to the cycle that `AdvanceTo` has granted. Until the first
//!   command arrives, cycle 1 waits: so every run begins with an answered cycle.
//!
//! On every clock the drives close the brakes when they get no fresh command for `drive.watchdog_cycles` cycles. A daemon
//! that answers nothing in `paced` or `lockstep` counts as lost after one second if its process is gone, and after 20 s
//! if it lives, until a command arrives. A cycle in which a fault shows the daemon nothing new does not wait for it.
//!
//! A cycle is complete when its measurement is answered and the state has moved on. The `plant` service states
//! the last complete cycle and the true state that the next measurement will show. A plant that pauses has therefore
//! no measurement outstanding, and what is asked of it or of the daemon takes effect in the next cycle.

mod body;
mod clock;
mod drives;
mod encoders;
mod faults;
mod link;
mod plant;
mod service;
mod start;

pub use faults::SetEventError;
pub use plant::Plant;
pub use start::StateError;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use tracing::info;
use upswing_config::{Config, PendulumStart};
use upswing_ipc::{Clock, Domain};
use upswing_model::{NU, StartError};
use upswing_process::{Failure, ProcessArgs, shutdown_flag};

/// Reads the name of a clock; completions of shells know the names.
pub fn clock_parser() -> impl TypedValueParser<Value = Clock> {
    PossibleValuesParser::new(["wall", "paced", "lockstep"]).try_map(|name| name.parse::<Clock>())
}

/// Options of the plant process.
#[derive(Clone, Debug, clap::Args)]
pub struct PlantArgs {
    /// What every process has.
    #[command(flatten)]
    pub process: ProcessArgs,
    /// Who advances time: wall (real time), paced (real time, waits for the daemon), lockstep (as granted)
    #[arg(long, value_name = "CLOCK", default_value = "paced", value_parser = clock_parser())]
    pub clock: Clock,
    /// Start angles of joints 1 to 7, deg [default: start.q_deg of plant.toml]
    #[arg(long, value_name = "Q1,..,Q7", value_delimiter = ',', allow_hyphen_values = true)]
    pub start: Option<Vec<f64>>,
    /// Start of the pendulum: hanging at rest, or q8 = q9 = 0 [default: start.pendulum of plant.toml]
    #[arg(long, value_name = "START")]
    pub start_pendulum: Option<PendulumStart>,
    /// What is different about the plant: a scenario of the settings, or the path of a .toml file
    #[arg(long, value_name = "NAME|FILE")]
    pub scenario: Option<String>,
}

impl PlantArgs {
    /// The settings, with the start that the options name.
    fn load(&self) -> Result<Config, Failure> {
        let mut config = self.process.load()?;
        if let Some(scenario) = &self.scenario {
            let purpose = config.use_scenario(scenario)?;
            info!(%scenario, "{purpose}");
        }
        if let Some(degrees) = &self.start {
            let degrees: [f64; NU] = degrees.as_slice().try_into().map_err(|_| {
                Failure::BadInput(format!("--start: {}", StartError::Length { got: degrees.len() }))
            })?;
            config.plant.start.q = degrees.map(f64::to_radians);
        }
        if let Some(pendulum) = self.start_pendulum {
            config.plant.start.pendulum = pendulum;
        }
        Ok(config)
    }
}

/// Runs the plant until SIGINT or SIGTERM.
///
/// # Errors
/// [`Failure::BadInput`] if the settings, the start pose or the domain cannot be used, [`Failure::Failed`] if shared
/// memory cannot be used or another plant serves the domain.
pub fn run(args: &PlantArgs) -> Result<(), Failure> {
    let config = args.load()?;
    let plant = Plant::new(&config).map_err(|e| Failure::BadInput(format!("start pose: {e}")))?;
    let domain = Domain::new(&args.process.domain).map_err(|e| Failure::BadInput(e.to_string()))?;
    let shutdown = shutdown_flag()?;
    let watchdog_cycles = config.plant.drive.watchdog_cycles;
    service::serve(args.clock, watchdog_cycles, plant, &domain, &shutdown)
        .map_err(|e| Failure::Failed(e.to_string()))
}
