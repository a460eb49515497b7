//! What can go wrong with a service, and what to do about it.

use crate::domain::Domain;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// The error of a lower layer (operating system or iceoryx2), kept for its message.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;

/// A node, a service or a port could not be used.
#[derive(Debug, Error)]
pub enum IpcError {
    /// The directory of the domain could not be used.
    #[error(
        "cannot {action} `{path}` of the domain: {cause}; check its permissions and the free space of /dev/shm"
    )]
    Root {
        /// What was attempted, for example "create".
        action: &'static str,
        /// The directory or file.
        path: PathBuf,
        /// Why it failed.
        cause: std::io::Error,
    },
    /// The directory of the domain is somebody else's.
    #[error(
        "`{path}` is not a directory of user id {expected}; use the same user for every process of a domain, or \
         another domain"
    )]
    Foreign {
        /// The path.
        path: PathBuf,
        /// The user id that it should belong to.
        expected: u32,
    },
    /// No room for what a process needs.
    #[error(
        "/dev/shm is too full: {needed} more bytes are needed now, {free} are free; remove what is not needed there, or \
         enlarge it (mount -o remount,size=...; a whole system takes up to {system} bytes)"
    )]
    Full {
        /// Bytes that did not fit.
        needed: u64,
        /// Bytes that are free.
        free: u64,
        /// Bytes of a whole system.
        system: u64,
    },
    /// The operating system lets this process have too little of something.
    #[error("this process may have only {allowed} {what}, {needed} are needed; raise that limit ({setting})")]
    Limit {
        /// Of what.
        what: &'static str,
        /// How much it may have.
        allowed: u64,
        /// How much it needs.
        needed: u64,
        /// Where that is set.
        setting: &'static str,
    },
    /// The node could not be created.
    #[error(
        "cannot join domain `{domain}` as `{role}`: {cause}; roles have at most 128 ASCII characters; check the free \
         space of /dev/shm and that all processes of the domain run as the same user"
    )]
    Connect {
        /// Name of the domain.
        domain: String,
        /// Role of the process.
        role: String,
        /// Why it failed.
        cause: Cause,
    },
    /// The nodes or services of the domain could not be listed.
    #[error("cannot list the {what} of domain `{domain}`: {cause}; check the permissions of its directory")]
    List {
        /// "nodes" or "services".
        what: &'static str,
        /// Name of the domain.
        domain: String,
        /// Why it failed.
        cause: Cause,
    },
    /// The service could neither be opened nor created.
    #[error(
        "cannot open service `{service}`: {cause}; if a process of another version holds it, stop all processes of \
         the domain"
    )]
    Open {
        /// Name of the service.
        service: String,
        /// Why it failed.
        cause: Cause,
    },
    /// The service exists with another payload.
    #[error("service `{service}` does not carry `{expected}`; run the same version of all processes")]
    Layout {
        /// Name of the service.
        service: String,
        /// The payload that was expected.
        expected: &'static str,
    },
    /// All places of this kind are taken by live processes.
    #[error(
        "service `{service}` already has its {max} {port}(s) in live processes (pid {}); stop one of them, or use \
         another domain", .holders.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
    )]
    Taken {
        /// Name of the service.
        service: String,
        /// Kind of end, for example "server".
        port: &'static str,
        /// How many there can be.
        max: usize,
        /// Ids of the processes that have them.
        holders: Vec<u32>,
    },
    /// An end of the service could not be created.
    #[error("cannot create a {port} of service `{service}`: {cause}; check the free space of /dev/shm")]
    Port {
        /// Name of the service.
        service: String,
        /// Kind of end, for example "publisher".
        port: &'static str,
        /// Why it failed.
        cause: Cause,
    },
    /// A sample, request or answer could not be sent.
    #[error("cannot send over service `{service}`: {cause}; restart this process if it persists")]
    Send {
        /// Name of the service.
        service: &'static str,
        /// Why it failed.
        cause: Cause,
    },
    /// Receiving failed.
    #[error("cannot receive from service `{service}`: {cause}; restart this process if it persists")]
    Receive {
        /// Name of the service.
        service: &'static str,
        /// Why it failed.
        cause: Cause,
    },
}

/// A request got no answer.
#[derive(Debug, Error)]
pub enum CallError {
    /// The process that serves does not run.
    #[error(
        "no {} in domain `{domain}`: start it with `upswing {} --domain {domain}`, or name another domain; running: {}",
        server(.service), server(.service),
        if .others.is_empty() { "none".to_owned() } else { .others.join(", ") }
    )]
    NoServer {
        /// Name of the service.
        service: &'static str,
        /// Name of the domain.
        domain: String,
        /// Other domains in which processes run.
        others: Vec<String>,
    },
    /// The server went away, or dropped the request, before it answered.
    #[error("the server of `{service}` went away without an answer; see its log, then ask again")]
    ServerGone {
        /// Name of the service.
        service: &'static str,
    },
    /// The server lives but did not answer in time; the request is withdrawn.
    #[error("no answer from `{service}` within {waited:?}; see the log of that process, or allow more time")]
    Timeout {
        /// Name of the service.
        service: &'static str,
        /// How long the call waited.
        waited: Duration,
    },
    /// The caller gave up waiting; the request is withdrawn.
    #[error("gave up waiting for `{service}`; the request is withdrawn")]
    Interrupted {
        /// Name of the service.
        service: &'static str,
    },
    /// The request could not be sent or the answer not received.
    #[error(transparent)]
    Ipc(#[from] IpcError),
}

impl CallError {
    /// Nobody serves `service` in `domain`.
    pub fn no_server(service: &'static str, domain: &Domain) -> Self {
        Self::NoServer { service, domain: domain.name().to_owned(), others: domain.others() }
    }
}

/// The process that serves `service`.
fn server(service: &'static str) -> &'static str {
    match service {
        "control" => "daemon",
        other => other,
    }
}
