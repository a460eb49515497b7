//! `upswing status`: prints the state of the daemon.

use super::CommonArgs;
use upswing_ipc::operator::Operator;
use upswing_process::Failure;
use upswing_view::live::DaemonStatus;

/// Shows the mode of the running daemon, its plan, faults and overruns; times in us.
///
/// Example: upswing status --json
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Requests the daemon's status and prints it.
///
/// # Errors
/// [`Failure::Failed`] if no daemon answers.
pub fn run(args: &StatusArgs) -> Result<(), Failure> {
    let node = args.common.join_existing()?;
    let answer = Operator::new(&node).and_then(|operator| operator.status()).map_err(Failure::failed)?;
    args.common.print(&DaemonStatus::new(&answer))
}
