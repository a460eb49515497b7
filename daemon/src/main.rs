//! `upswingd`: the control daemon.

use clap::Parser;
use std::process::ExitCode;
use upswing_process::{ProcessArgs, finish, start_logging};

/// Runs the control daemon of upswing until SIGINT or SIGTERM.
#[derive(Parser)]
#[command(version, after_help = "Example:\n  upswingd --system /etc/upswing --domain upswing")]
struct Cli {
    #[command(flatten)]
    process: ProcessArgs,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging();
    finish(upswingd::run(&cli.process))
}
