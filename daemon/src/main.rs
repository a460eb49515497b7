//! `upswingd`: the control daemon.

use clap::Parser;
use std::process::ExitCode;
use upswing_config::process::finish;
use upswingd::DaemonArgs;

/// Runs the control daemon of upswing until SIGINT or SIGTERM
#[derive(Parser)]
#[command(version, after_help = "Example:\n  upswingd --config /etc/upswing --domain upswing")]
struct Args {
    #[command(flatten)]
    daemon: DaemonArgs,
}

fn main() -> ExitCode {
    finish(upswingd::run(Args::parse().daemon))
}
