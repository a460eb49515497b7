//! `upswing-plant`: the plant process, see [`upswing_plant::run`].

use clap::Parser;
use std::process::ExitCode;
use upswing_plant::{PlantArgs, run};
use upswing_process::{finish, start_logging};

/// Simulates robot, pendulum, drives, encoders and brakes.
#[derive(Parser)]
#[command(name = "upswing-plant", version)]
struct Cli {
    #[command(flatten)]
    plant: PlantArgs,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging();
    finish(run(&cli.plant))
}
