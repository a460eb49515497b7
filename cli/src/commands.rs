//! The commands of the `upswing` program, one module each.

pub mod completions;
pub mod config;
pub mod db;
pub mod demo;
pub mod disturb;
pub mod doctor;
pub mod export;
pub mod model;
pub mod montecarlo;
pub mod optimize;
pub mod plan;
pub mod record;
pub mod report;
pub mod request;
pub mod status;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use upswing_config::process::{Failure, ProcessArgs};
use upswing_ipc::{Domain, Node};
use upswing_trajectory::Trajectory;

/// Options of every command but the processes.
#[derive(Clone, Debug, clap::Args)]
pub struct CommonArgs {
    /// Options that all processes have.
    #[command(flatten)]
    pub process: ProcessArgs,
    /// Print one JSON document on stdout instead of text
    #[arg(long)]
    pub json: bool,
}

impl CommonArgs {
    /// Prints a result: as JSON where asked for, else as text.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the result cannot be written as JSON.
    pub fn print(&self, result: &(impl Serialize + std::fmt::Display)) -> Result<(), Failure> {
        print(self.json, result)
    }

    /// Joins the domain.
    ///
    /// # Errors
    /// [`Failure`] for a bad name or an unusable domain.
    pub fn connect(&self) -> Result<Node, Failure> {
        let domain = Domain::new(&self.process.domain).map_err(|e| Failure::BadInput(e.to_string()))?;
        domain.connect("cli").map_err(failed)
    }
}

/// Prints a result as JSON or as text.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub fn print(json: bool, result: &(impl Serialize + std::fmt::Display)) -> Result<(), Failure> {
    if json { print_json(result) } else { print_line(result) }
}

/// Prints one JSON document on stdout.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub fn print_json(result: &impl Serialize) -> Result<(), Failure> {
    print_line(&serde_json::to_string(result).map_err(failed)?)
}

/// Prints a line on stdout; a reader that has gone away (`| head`) is no failure.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub fn print_line(line: &impl std::fmt::Display) -> Result<(), Failure> {
    use std::io::Write;
    match writeln!(std::io::stdout(), "{line}") {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(failed(e)),
        _ => Ok(()),
    }
}

/// "Ran, but the answer is no."
pub fn failed(e: impl std::fmt::Display) -> Failure {
    Failure::Failed(e.to_string())
}

/// A bar with an estimate of the time left; draws nothing where stderr is not a terminal.
fn progress_bar(length: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    let template = format!("{{bar:40}} {{human_pos}}/{{human_len}} {what}, {{eta}} left");
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style);
    }
    bar
}

/// A trajectory as JSON: t_F in s, x (KNOTS x NX) in rad and rad/s, u (KNOTS x NU) in rad/s^2.
#[derive(Clone, Debug, Serialize)]
pub struct TrajectoryJson {
    /// t_F, s.
    pub t_f: f64,
    /// x_k
    pub x: Vec<Vec<f64>>,
    /// u_k
    pub u: Vec<Vec<f64>>,
}

impl From<&Trajectory> for TrajectoryJson {
    fn from(t: &Trajectory) -> Self {
        Self {
            t_f: t.t_f,
            x: t.x.iter().map(|x| x.iter().copied().collect()).collect(),
            u: t.u.iter().map(|u| u.iter().copied().collect()).collect(),
        }
    }
}
