//! `upswing disturb`: injects faults and pushes into the simulated plant of a running system.

use super::CommonArgs;
use serde::Serialize;
use std::time::Duration;
use upswing_config::Push;
use upswing_ipc::{PlantKind, PlantRequest};
use upswing_model::Model;
use upswing_process::Failure;
use upswing_process::number::whole;
use upswing_rig::fault_args::FaultArgs;

/// Longest wait for the answer of the plant.
const PATIENCE: Duration = Duration::from_secs(10);

/// Injects faults into the simulated plant, or pushes the pendulum.
///
/// Example: upswing disturb fault encoder-stuck --joint pendulum_2 && upswing disturb push --impulse 0.02,0,0
#[derive(Clone, Debug, clap::Args)]
pub struct DisturbArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The disturbance
    #[command(subcommand)]
    pub command: DisturbCommand,
}

/// Disturbances of the plant.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum DisturbCommand {
    /// Inject a fault
    ///
    /// Example: upswing disturb fault encoder-jump --joint pendulum_2 --amount 0.1
    Fault(FaultArgs),
    /// Push the tip of the rod
    ///
    /// Example: upswing disturb push --impulse 0.02,0,0
    Push {
        /// Force times its duration, world frame (z up), N s
        #[arg(
            long,
            value_name = "X,Y,Z",
            value_delimiter = ',',
            required = true,
            allow_hyphen_values = true
        )]
        impulse: Vec<f64>,
        /// Duration of the push, cycles
        #[arg(long, default_value_t = 80, value_parser = whole(0, u64::MAX))]
        cycles: u64,
        /// Cycle of the plant in which it begins [default: the next one]
        #[arg(long, value_name = "CYCLE", value_parser = whole(0, u64::MAX))]
        from: Option<u64>,
    },
    /// Remove all faults
    ///
    /// Example: upswing disturb clear
    Clear,
}

#[derive(Serialize)]
struct DisturbResult {
    success: bool,
    cycle: u64,
}

impl std::fmt::Display for DisturbResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "accepted after cycle {}", self.cycle)
    }
}

/// Sends the disturbance to the plant.
///
/// # Errors
/// [`Failure::BadInput`] for invalid arguments, [`Failure::Failed`] with the reason if the plant refuses or does not answer.
pub fn run(args: &DisturbArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    let request = request(&args.command, &config.model)?;
    let plant = args.common.join_existing()?.client::<PlantRequest>().map_err(Failure::failed)?;
    let answer = plant.call(&request, PATIENCE).map_err(Failure::failed)?;
    if answer.accepted == 0 {
        let reason = answer.reason.as_str().unwrap_or("no reason given");
        return Err(Failure::failed(format!("the plant refused: {reason}")));
    }
    args.common.print(&DisturbResult { success: true, cycle: answer.seq })
}

fn request(command: &DisturbCommand, model: &Model) -> Result<PlantRequest, Failure> {
    match command {
        DisturbCommand::Fault(fault) => fault.request(model).map_err(Failure::bad_input),
        DisturbCommand::Push { impulse, cycles, from } => {
            let impulse = impulse.as_slice().try_into().map_err(|_| {
                Failure::BadInput(format!(
                    "--impulse: expected 3 numbers, X,Y,Z in N s, got {}",
                    impulse.len()
                ))
            })?;
            let push = Push { from: from.unwrap_or_default(), cycles: *cycles, impulse };
            push.check().map_err(Failure::bad_input)?;
            Ok(PlantRequest {
                seq: push.from,
                cycles: push.cycles,
                impulse,
                ..PlantRequest::new(PlantKind::Push)
            })
        }
        DisturbCommand::Clear => Ok(PlantRequest::new(PlantKind::ClearFaults)),
    }
}
