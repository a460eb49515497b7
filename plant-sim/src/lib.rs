//! The simulated robot: dynamics (1), drives, encoders, brakes and faults.
//!
//! [`Plant`] is the simulation: deterministic, without clock or shared memory, usable with a controller in the same process.
//! [`run`] is the plant process, which steps a [`Plant`] on one of the clocks `wall`, `paced` and `lockstep`
//! ([`upswing_ipc::PlantPacing`] implements their rules).
//!
//! | module | contents |
//! |---|---|
//! | `plant` | the plant: state, measurement and step |
//! | `mechanism` | the chain: dynamics, friction, stops, brakes, external loads, integration |
//! | `drives`, `encoders`, `faults` | actuators, sensors, and their faults |
//! | `start` | check of requested states |
//! | `service`, `commands`, `requests` | the process: its loop, the daemon's commands, the `plant` service |
//!
//! On every clock the drives close the brakes when no command has arrived for `drive.watchdog_cycles` cycles. A cycle in
//! which a fault withholds the measurement from the daemon does not wait for a command.
//!
//! A cycle is complete when its measurement is answered and the state has moved on. The `plant` service reports the last
//! complete cycle and the true state that the next measurement will show. A paused plant therefore has no unanswered
//! measurement, and a request to the plant or to the daemon takes effect in the next cycle.

mod commands;
mod drives;
mod encoders;
mod faults;
mod mechanism;
mod plant;
mod requests;
mod service;
mod start;

pub use faults::SetEventError;
pub use plant::Plant;
pub use start::StateError;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use tracing::info;
use upswing_config::{Config, PendulumStart};
use upswing_ipc::{Clock, Domain};
use upswing_process::{Failure, ProcessArgs, shutdown_flag};

/// Parser of a clock's name for command lines; shell completions list the names.
pub fn clock_parser() -> impl TypedValueParser<Value = Clock> {
    PossibleValuesParser::new(Clock::ALL.iter().map(|clock| clock.name()))
        .try_map(|name| name.parse::<Clock>())
}

/// Options of the plant process.
#[derive(Clone, Debug, clap::Args)]
pub struct PlantArgs {
    /// Options of every process.
    #[command(flatten)]
    pub process: ProcessArgs,
    /// Clock: wall (real time), paced (real time, but waits for the daemon), lockstep (advances on request)
    #[arg(long, value_name = "CLOCK", default_value = "paced", value_parser = clock_parser())]
    pub clock: Clock,
    /// Start positions of the actuated joints, deg or m [default: start.q_deg of plant.toml]
    #[arg(long, value_name = "Q1,Q2,..", value_delimiter = ',', allow_hyphen_values = true)]
    pub start: Option<Vec<f64>>,
    /// Start of the unactuated joints: their rest position, or 0 [default: start.pendulum of plant.toml]
    #[arg(long, value_name = "START")]
    pub start_pendulum: Option<PendulumStart>,
    /// Scenario of the plant: a name, or the path of a .toml file
    #[arg(long, value_name = "NAME|FILE")]
    pub scenario: Option<String>,
}

impl PlantArgs {
    /// The settings, with scenario and start of the options.
    fn load(&self) -> Result<Config, Failure> {
        let mut config = self.process.load()?;
        if let Some(scenario) = &self.scenario {
            let purpose = config.use_scenario(scenario)?;
            info!(%scenario, "{purpose}");
        }
        if let Some(start) = &self.start {
            config.plant.start.q = config
                .plant_model
                .actuated_from_shown(start)
                .map_err(|e| Failure::BadInput(format!("--start: {e}")))?;
        }
        if let Some(pendulum) = self.start_pendulum {
            config.plant.start.pendulum = pendulum;
        }
        Ok(config)
    }
}

/// Runs the plant process until SIGINT or SIGTERM.
///
/// # Errors
/// [`Failure::BadInput`] if the settings, the start pose or the domain cannot be used, [`Failure::Failed`] if shared
/// memory cannot be used or another plant serves the domain.
pub fn run(args: &PlantArgs) -> Result<(), Failure> {
    let config = args.load()?;
    let plant = Plant::new(&config).map_err(|e| Failure::BadInput(format!("start pose: {e}")))?;
    let domain = Domain::new(&args.process.domain).map_err(Failure::bad_input)?;
    let shutdown = shutdown_flag()?;
    let watchdog_cycles = config.plant.drive.watchdog_cycles;
    service::serve(args.clock, watchdog_cycles, plant, &domain, &shutdown).map_err(Failure::failed)
}
