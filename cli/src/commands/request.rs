//! `upswing request`: what an operator asks of a running system.

use super::{CommonArgs, failed};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use upswing_ipc::operator::{Action, Operator};
use upswing_process::{Failure, shutdown_flag};

/// Asks the running system to do something.
///
/// Ctrl-C withdraws a request that is still being planned.
///
/// Example: upswing request enable && upswing request swing-up
#[derive(Clone, Debug, clap::Args)]
pub struct RequestArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// What to do
    #[arg(value_parser = actions())]
    pub what: Action,
}

/// Reads the name of an action.
fn actions() -> impl TypedValueParser<Value = Action> {
    let value = |action: Action| PossibleValue::new(action.name()).help(action.purpose());
    let known = |name: String| Action::from_name(&name).ok_or("no such action");
    PossibleValuesParser::new(Action::ALL.map(value)).try_map(known)
}

/// Sends the request.
///
/// # Errors
/// [`Failure::Failed`] with the reason if it is refused or nobody answers.
pub fn run(args: &RequestArgs) -> Result<(), Failure> {
    let node = args.common.connect()?;
    let interrupted = shutdown_flag()?;
    let operator = Operator::new(&node).map_err(failed)?;
    args.common.print(&operator.request(args.what, &interrupted).map_err(failed)?)
}
