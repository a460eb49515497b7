//! `upswing monitor`: a running system, live.

use super::{CommonArgs, failed};
use crate::live::Live;
use crate::monitor::{self, Look};
use std::io::IsTerminal;
use upswing_config::process::{Failure, colours, shutdown_flag};

/// Shows a running system live: modes, rod, joints between their limits, cycle times, plans, faults.
///
/// In the terminal: e, u, d, h, r ask for enable, swing-up, swing-down, hold and reset once y confirms; s stops at
/// once; q ends the monitor. With --json: one look, as one document. Angles in deg on the screen, SI units in JSON.
///
/// Example: upswing monitor
#[derive(Clone, Debug, clap::Args)]
pub struct MonitorArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Shows the system.
///
/// # Errors
/// [`Failure::BadInput`] if there is no terminal or an option cannot be used, [`Failure::Failed`] if the domain cannot
/// be used.
pub fn run(args: &MonitorArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    if args.common.json {
        let mut live = Live::open(&args.common, &config)?;
        live.settle().map_err(failed)?;
        return args.common.print(&live.view());
    }
    if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
        return Err(Failure::BadInput(
            "expected a terminal on stdin and stdout, got a pipe or a file; use --json for one look, or --web".into(),
        ));
    }
    let stop = shutdown_flag()?;
    let mut live = Live::open(&args.common, &config)?;
    monitor::run(&mut live, Look { colours: colours(&std::io::stdout()) }, &stop).map_err(failed)
}
