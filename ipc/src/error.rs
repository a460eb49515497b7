//! Errors of domains, services and requests; their texts say what to do.

use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// The error of a lower layer (operating system or iceoryx2), kept for its message.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;

/// Why a domain, a node, a service or a port cannot be used.
#[derive(Debug, Error)]
pub enum IpcError {
    /// The directory of the domain, or a file in it, cannot be used.
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
    /// The directory of the domain belongs to another user, or is not a directory.
    #[error(
        "`{path}` is not a directory of user id {expected}; use the same user for every process of a domain, or \
         another domain"
    )]
    Foreign {
        /// The path.
        path: PathBuf,
        /// The user id of this process.
        expected: u32,
    },
    /// The file system of shared memory is too full.
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
    /// A limit of the operating system on this process is too low.
    #[error("this process may have only {allowed} {what}, {needed} are needed; raise that limit ({setting})")]
    Limit {
        /// The limited quantity, for example "open files".
        what: &'static str,
        /// The limit.
        allowed: u64,
        /// The lowest limit that is enough.
        needed: u64,
        /// The settings that raise it.
        setting: &'static str,
    },
    /// The node, with which a process joins a domain, cannot be created.
    #[error(
        "cannot join domain `{domain}` as `{role}`: {cause}; roles have at most 128 ASCII characters; check the free \
         space of /dev/shm and that all processes of the domain run as the same user"
    )]
    Join {
        /// Name of the domain.
        domain: String,
        /// Role of the process.
        role: String,
        /// Why it failed.
        cause: Cause,
    },
    /// The nodes or services of the domain cannot be listed.
    #[error("cannot list the {what} of domain `{domain}`: {cause}; check the permissions of its directory")]
    List {
        /// "nodes" or "services".
        what: &'static str,
        /// Name of the domain.
        domain: String,
        /// Why it failed.
        cause: Cause,
    },
    /// The service can neither be opened nor created.
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
    #[error(
        "service `{service}` has another payload than `{expected}`; run the same version of all processes"
    )]
    Layout {
        /// Name of the service.
        service: String,
        /// Type of the payload that was expected.
        expected: &'static str,
    },
    /// Live processes have all ports of this kind that the service allows.
    #[error(
        "service `{service}` already has its {max} {port}(s) in live processes (pid {}); stop one of them, or use \
         another domain", .holders.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
    )]
    Taken {
        /// Name of the service.
        service: String,
        /// Kind of port, for example "server".
        port: &'static str,
        /// The largest number of such ports.
        max: usize,
        /// Ids of the processes that have them.
        holders: Vec<u32>,
    },
    /// A port of the service cannot be created.
    #[error("cannot create a {port} of service `{service}`: {cause}; check the free space of /dev/shm")]
    Port {
        /// Name of the service.
        service: String,
        /// Kind of port, for example "publisher".
        port: &'static str,
        /// Why it failed.
        cause: Cause,
    },
    /// A sample, request or response cannot be sent.
    #[error("cannot send over service `{service}`: {cause}; restart this process if it persists")]
    Send {
        /// Name of the service.
        service: &'static str,
        /// Why it failed.
        cause: Cause,
    },
    /// A sample, request or response cannot be received.
    #[error("cannot receive from service `{service}`: {cause}; restart this process if it persists")]
    Receive {
        /// Name of the service.
        service: &'static str,
        /// Why it failed.
        cause: Cause,
    },
}

/// Why a request got no response.
#[derive(Debug, Error)]
pub enum CallError {
    /// No process serves this service.
    #[error(
        "no {} in domain `{domain}`: start it with `upswing {} --domain {domain}`, or name another domain; running: {}",
        server_of(.service), server_of(.service),
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
    /// The server exited, or dropped the request, before it responded.
    #[error("the server of `{service}` exited without an answer; see its log, then repeat the request")]
    ServerGone {
        /// Name of the service.
        service: &'static str,
    },
    /// The server is alive but did not respond in time; the request is withdrawn.
    #[error("no answer from `{service}` within {waited:?}; see the log of that process, or allow more time")]
    Timeout {
        /// Name of the service.
        service: &'static str,
        /// How long the client waited.
        waited: Duration,
    },
    /// The caller of [`crate::Client::call_while`] stopped waiting; the request is cancelled.
    #[error("the request to `{service}` was cancelled before an answer")]
    Interrupted {
        /// Name of the service.
        service: &'static str,
    },
    /// The request cannot be sent or the response not received.
    #[error(transparent)]
    Ipc(#[from] IpcError),
}

/// Name of the process that serves `service`.
fn server_of(service: &'static str) -> &'static str {
    match service {
        "control" => "daemon",
        other => other,
    }
}
