//! `upswing record`: every cycle of a running system in a file.

use super::{CommonArgs, failed};
use crate::recording::{Recorder, RecordingError, Tally, Tap};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use upswing_config::process::{Failure, shutdown_flag};

/// Pause between two looks for telemetry; its buffer lasts for two seconds.
const PAUSE: Duration = Duration::from_millis(2);
/// How long to wait for a first cycle.
const PATIENCE: Duration = Duration::from_secs(10);

/// Records every cycle of the running system as MCAP, for Foxglove, PlotJuggler, Python and `upswing report`.
///
/// Ends after --seconds or on Ctrl-C. Begun before the daemon, it can be replayed (`upswing replay`). A file whose recording was killed is readable up to its last quarter of a second.
///
/// Example: upswing record run.mcap --seconds 10
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The new file; an existing one is not overwritten
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// How long to record, s of the plant's time [default: until Ctrl-C]
    #[arg(long)]
    pub seconds: Option<f64>,
}

#[derive(Serialize)]
struct Answer<'a> {
    file: &'a Path,
    bytes: u64,
    #[serde(flatten)]
    tally: Tally,
}

impl std::fmt::Display for Answer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Tally { cycles, lost, seconds, restarts, .. } = self.tally;
        write!(f, "{}: {seconds:.3} s, {cycles} cycles, {lost} lost", self.file.display())?;
        if restarts > 0 {
            write!(f, ", {restarts} restarts of the daemon")?;
        }
        write!(f, ", {:.1} MB", self.bytes as f64 * 1e-6)
    }
}

/// Records.
///
/// # Errors
/// [`Failure::BadInput`] if the file exists or cannot be made, [`Failure::Failed`] if no telemetry comes or the disk is
/// full.
pub fn run(args: &RecordArgs) -> Result<(), Failure> {
    if args.seconds.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
        let got = args.seconds.unwrap_or_default();
        return Err(Failure::BadInput(format!("--seconds: expected a number above 0, got {got}")));
    }
    let config = args.common.process.load()?;
    let node = args.common.connect()?;
    let stop = shutdown_flag()?;
    let tap = Tap::new(&node).map_err(failed)?;
    let details = [("domain", args.common.process.domain.clone())];
    let recorder = Recorder::create(&args.file, &config, details).map_err(failure)?;
    let tally = record(args, &tap, recorder, &stop)?;
    let bytes = std::fs::metadata(&args.file).map_or(0, |file| file.len());
    args.common.print(&Answer { file: &args.file, bytes, tally })
}

/// A file that cannot be used is the user's to mend; a disk that is full is not.
pub(super) fn failure(e: RecordingError) -> Failure {
    match e {
        RecordingError::Write { .. } | RecordingError::Ipc(_) => failed(e),
        _ => Failure::BadInput(e.to_string()),
    }
}

fn record(args: &RecordArgs, tap: &Tap, mut recorder: Recorder, stop: &AtomicBool) -> Result<Tally, Failure> {
    let end = args.seconds.unwrap_or(f64::INFINITY);
    let bar = progress(args.seconds);
    let begin = Instant::now();
    while !stop.load(Ordering::Acquire) && recorder.tally().seconds < end {
        tap.drain(Some(&mut recorder), |_| {}).map_err(failure)?;
        let tally = recorder.tally();
        if tally.cycles == 0 && begin.elapsed() > PATIENCE {
            // Nothing in it that anybody would miss.
            drop(recorder);
            let _ = std::fs::remove_file(&args.file);
            let domain = &args.common.process.domain;
            let waited = PATIENCE.as_secs();
            return Err(failed(format!(
                "no cycle came for {waited} s: is a daemon with a plant running in domain `{domain}`?"
            )));
        }
        bar.set_position((tally.seconds * 1e3) as u64);
        bar.set_message(format!("{} cycles, {} lost", tally.cycles, tally.lost));
        std::thread::sleep(PAUSE);
    }
    bar.finish_and_clear();
    recorder.finish().map_err(failure)
}

/// Recorded time; draws nothing where stderr is not a terminal.
fn progress(seconds: Option<f64>) -> ProgressBar {
    let (bar, template) = match seconds {
        Some(seconds) => (ProgressBar::new((seconds * 1e3) as u64), "{bar:40} {msg}, {eta} left"),
        None => (ProgressBar::new_spinner(), "{spinner} {msg}, Ctrl-C ends the recording"),
    };
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
