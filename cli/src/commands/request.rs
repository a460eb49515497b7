//! `upswing request`: sends an operator's request to a running system.

use super::CommonArgs;
use crate::parse::{JointValue, given_values};
use upswing_ipc::operator::{Operator, OperatorRequest};
use upswing_ipc::{ManoeuvreRequest, NoName};
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
    /// `enable` (open the brakes and hold), `hold`, `stop`, `reset` (leave the mode Fault), or a manoeuvre of the system, as
    /// `swing-up`, which is planned from the current state, then started
    #[arg(value_name = "REQUEST", value_parser = request)]
    pub what: OperatorRequest,
    /// Where joints end in a manoeuvre whose target is given by the request, deg or m [default: where they are]
    #[arg(long, value_name = "JOINT=VALUE", num_args = 1..)]
    pub to: Vec<JointValue>,
}

fn request(name: &str) -> Result<OperatorRequest, NoName> {
    OperatorRequest::from_name(name)
}

/// Sends the request to the running system.
///
/// # Errors
/// [`Failure::BadInput`] for values that the request does not take, [`Failure::Failed`] with the reason if the request is refused or not
/// answered.
pub fn run(args: &RequestArgs) -> Result<(), Failure> {
    let request = match args.what {
        _ if args.to.is_empty() => args.what,
        OperatorRequest::Manoeuvre(manoeuvre) => {
            let config = args.common.process.load()?;
            let (_, given) = given_values(&config, Some(manoeuvre.name.as_str()), &args.to)?;
            let request = ManoeuvreRequest::new(manoeuvre.name.as_str(), &given);
            OperatorRequest::Manoeuvre(request.map_err(Failure::bad_input)?)
        }
        command => return Err(Failure::BadInput(format!("--to: `{command}` has no target"))),
    };
    let node = args.common.join_existing()?;
    let interrupted = shutdown_flag()?;
    let operator = Operator::new(&node).map_err(Failure::failed)?;
    args.common.print(&operator.request(request, &interrupted).map_err(Failure::failed)?)
}
