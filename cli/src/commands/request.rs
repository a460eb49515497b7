//! `upswing request`: sends an operator's request to a running system.

use super::CommonArgs;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use upswing_ipc::operator::{Operator, OperatorRequest};
use upswing_process::{Failure, shutdown_flag};

/// Sends a request to the running system.
///
/// Ctrl-C during planning cancels the request.
///
/// Example: upswing request enable && upswing request swing-up
#[derive(Clone, Debug, clap::Args)]
pub struct RequestArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The request
    #[arg(value_parser = requests())]
    pub what: OperatorRequest,
}

/// Returns the parser of the name of a request.
fn requests() -> impl TypedValueParser<Value = OperatorRequest> {
    let value = |request: OperatorRequest| PossibleValue::new(request.name()).help(request.purpose());
    let known = |name: String| OperatorRequest::from_name(&name).ok_or("no such request");
    PossibleValuesParser::new(OperatorRequest::ALL.map(value)).try_map(known)
}

/// Sends the request to the running system.
///
/// # Errors
/// [`Failure::Failed`] with the reason if the request is refused or not answered.
pub fn run(args: &RequestArgs) -> Result<(), Failure> {
    let node = args.common.join_existing()?;
    let interrupted = shutdown_flag()?;
    let operator = Operator::new(&node).map_err(Failure::failed)?;
    args.common.print(&operator.request(args.what, &interrupted).map_err(Failure::failed)?)
}
