//! The program `upswing`: the operator's command line.

use std::process::ExitCode;
use upswing::cli::{Cli, run};
use upswing_process::{finish, start_logging};

fn main() -> ExitCode {
    let cli = Cli::read();
    start_logging();
    finish(run(&cli))
}
