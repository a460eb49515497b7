//! Commands of the `upswing` program, one module each.
//!
//! For a command `NAME`, `NameArgs` holds its options, `run` runs it, and `NameResult` is its output: one JSON document with
//! `--json`, otherwise text. A command that runs until Ctrl-C prints `NameStarted` instead.

pub(crate) mod bench;
pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod db;
pub(crate) mod demo;
pub mod disturb;
pub mod doctor;
pub(crate) mod export;
mod json;
pub(crate) mod metrics;
pub(crate) mod model;
pub(crate) mod monitor;
pub(crate) mod montecarlo;
pub(crate) mod optimize;
pub(crate) mod plan;
mod progress;
pub(crate) mod record;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod request;
pub(crate) mod soak;
pub(crate) mod status;
pub(crate) mod system;
mod system_list;

pub(crate) use json::TrajectoryJson;

use progress::{byte_bar, progress_bar, spinner, time_bar};
use serde::Serialize;
use std::path::Path;
use upswing_ipc::{
    CallError, Clock, ControlRequest, Domain, IpcError, Node, RequestPayload as _, TempDomain,
};
use upswing_process::output::{Destination, OutputError, OutputFile, Overwrite};
use upswing_process::{Failure, ProcessArgs};
use upswing_rig::session::{SessionError, SessionOptions};

/// Options of every command except the three processes.
#[derive(Clone, Debug, clap::Args)]
pub struct CommonArgs {
    /// Options of every process.
    #[command(flatten)]
    pub process: ProcessArgs,
    /// Print one JSON document on stdout instead of text
    #[arg(long)]
    pub json: bool,
}

impl CommonArgs {
    /// Prints a result as JSON with --json, else as text.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the result cannot be written as JSON.
    pub fn print(&self, result: &(impl Serialize + std::fmt::Display)) -> Result<(), Failure> {
        print(self.json, result)
    }

    /// Joins the domain as a client, which does not create it.
    ///
    /// # Errors
    /// [`Failure`] for an invalid name, an unusable domain, or a domain without processes.
    pub fn join_existing(&self) -> Result<Node, Failure> {
        let domain = self.domain()?;
        if !domain.exists() {
            return Err(Failure::failed(CallError::no_server(ControlRequest::SERVICE, &domain)));
        }
        domain.join("cli").map_err(Failure::failed)
    }

    /// Joins the domain, and creates it if it does not exist, to wait for its processes.
    ///
    /// # Errors
    /// [`Failure`] for an invalid name or an unusable domain.
    pub fn join(&self) -> Result<Node, Failure> {
        self.domain()?.join("cli").map_err(Failure::failed)
    }

    fn domain(&self) -> Result<Domain, Failure> {
        Domain::new(&self.process.domain).map_err(Failure::bad_input)
    }
}

/// Creates a private domain for a system that this process starts, and the options of its session, with a folder for logs. The
/// plant starts at the positions `start` of the actuated joints, deg or m, comma-separated.
///
/// # Errors
/// [`Failure::BadInput`] for an invalid name, [`Failure::Failed`] if the folder cannot be created.
fn own_system(
    common: &CommonArgs,
    what: &str,
    clock: Clock,
    start: String,
    scenario: Option<String>,
) -> Result<(TempDomain, SessionOptions), Failure> {
    let domain = TempDomain::new(&format!("{}-{what}", common.process.domain)).map_err(Failure::bad_input)?;
    let name = domain.name().to_owned();
    let logs = std::env::temp_dir().join(&name);
    std::fs::create_dir_all(&logs)
        .map_err(|e| Failure::failed(format!("cannot create {}: {e}", logs.display())))?;
    let system = common.process.system.clone();
    Ok((domain, SessionOptions { system, domain: name, clock, start: Some(start), scenario, logs }))
}

/// Converts the error of a session: invalid inputs to [`Failure::BadInput`]; other messages name the folder `logs`.
fn session_failure(e: &SessionError, logs: &Path) -> Failure {
    match e {
        SessionError::Interrupted => {
            // An interrupted session needs no logs.
            let _ = std::fs::remove_dir_all(logs);
            Failure::failed(e)
        }
        SessionError::Ended { status, .. } if status.code() == Some(2) => Failure::bad_input(e),
        SessionError::Ipc(IpcError::Taken { .. }) => {
            Failure::failed(format!("{e}; another system may use this domain"))
        }
        e => Failure::failed(format!("{e}; logs in {}", logs.display())),
    }
}

/// Prints a result as JSON or as text.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub(crate) fn print(json: bool, result: &(impl Serialize + std::fmt::Display)) -> Result<(), Failure> {
    if json { print_json(result) } else { print_line(result) }
}

/// Prints one JSON document on stdout.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub(crate) fn print_json(result: &impl Serialize) -> Result<(), Failure> {
    print_line(&serde_json::to_string(result).map_err(Failure::failed)?)
}

/// Prints a line on stdout; a closed pipe (`| head`) is not a failure.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub(crate) fn print_line(line: &impl std::fmt::Display) -> Result<(), Failure> {
    use std::io::Write;
    match writeln!(std::io::stdout(), "{line}") {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::failed(e)),
        _ => Ok(()),
    }
}

/// Returns the output file of an option, after a check before the work begins that it can be written.
fn writable(
    option: &str,
    destination: Option<&Destination>,
    overwrite: Overwrite,
) -> Result<Option<OutputFile>, Failure> {
    let output = destination.map(|path| overwrite.output(path));
    match output.as_ref().map_or(Ok(()), OutputFile::check) {
        Ok(()) => Ok(output),
        Err(e @ OutputError::Exists { .. }) => Err(Failure::BadInput(format!("{option}: {e}"))),
        Err(e) => Err(Failure::BadInput(format!("{option}: {e}; choose a place that can be written"))),
    }
}
