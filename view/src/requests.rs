//! Requests that the monitor and the live page offer.

use upswing_config::Config;
use upswing_ipc::ManoeuvreRequest;
use upswing_ipc::operator::OperatorRequest;

/// The manoeuvres of the settings whose target needs no values, then the commands.
pub fn offered(config: &Config) -> Vec<OperatorRequest> {
    let complete = config.manoeuvres.iter().filter(|manoeuvre| manoeuvre.given().next().is_none());
    let request = |name: &str| ManoeuvreRequest::new(name, &[]).ok().map(OperatorRequest::Manoeuvre);
    let manoeuvres = complete.filter_map(|manoeuvre| request(&manoeuvre.name));
    manoeuvres.chain(OperatorRequest::COMMANDS).collect()
}
