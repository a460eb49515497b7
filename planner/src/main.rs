//! The planner process.

use clap::Parser;
use std::process::ExitCode;
use upswing_planner::service::run;
use upswing_process::{ProcessArgs, finish, start_logging};

/// Plans swing-ups on request: selects the nearest database entry, adapts it by constrained QPs, computes gains.
///
/// Example: upswing-planner --system /etc/upswing --domain robot
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(flatten)]
    process: ProcessArgs,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging();
    finish(run(&cli.process))
}
