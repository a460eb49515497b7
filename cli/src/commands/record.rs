//! `upswing record`: records every cycle of a running system in a file.

use super::{CommonArgs, spinner, time_bar, writable};
use crate::parse::WEEK;
use serde::Serialize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use upswing_planner::database::DatabaseFile;
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_record::{Recorder, Tally, Tap};

/// Pause between two reads of telemetry, whose buffer holds two seconds.
const PAUSE: Duration = Duration::from_millis(2);
/// Longest wait for the first cycle.
const PATIENCE: Duration = Duration::from_secs(10);

/// Records every cycle of the running system as MCAP, for Foxglove, PlotJuggler, Python and `upswing report`.
///
/// Ends after --seconds or on Ctrl-C. `upswing replay` needs a recording that began before the daemon. If the recording process is
/// killed, at most the last quarter of a second is lost.
///
/// Example: upswing record run.mcap --seconds 10
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Recording to write
    #[arg(value_name = "FILE.mcap")]
    pub file: Destination,
    /// Duration, s of the plant's time (0.001 to a week) [default: until Ctrl-C]
    #[arg(long, value_name = "S", value_parser = within(1e-3, WEEK))]
    pub seconds: Option<f64>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct RecordResult<'a> {
    file: &'a Path,
    bytes: u64,
    #[serde(flatten)]
    tally: Tally,
}

impl std::fmt::Display for RecordResult<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Tally { cycles, lost, seconds, restarts, .. } = self.tally;
        write!(f, "{}: {seconds:.3} s, {cycles} cycles, {lost} lost", self.file.display())?;
        if restarts > 0 {
            write!(f, ", {restarts} restarts of the daemon")?;
        }
        write!(f, ", {:.1} MB", self.bytes as f64 * 1e-6)
    }
}

/// Records the running system.
///
/// # Errors
/// [`Failure::BadInput`] if the file exists or cannot be created, [`Failure::Failed`] if no telemetry comes or the disk is
/// full.
pub fn run(args: &RecordArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    let output = writable("FILE.mcap", Some(&args.file), args.overwrite)?;
    let node = args.common.join_existing()?;
    let stop = shutdown_flag()?;
    let tap = Tap::new(&node).map_err(Failure::failed)?;
    let fingerprint = DatabaseFile::of(&config, 0)?.map(DatabaseFile::fingerprint).transpose();
    let database = fingerprint.map_err(Failure::bad_input)?.map(|of_file| ("database_fingerprint", of_file));
    let details = [("domain", args.common.process.domain.clone())].into_iter().chain(database);
    if let Some(output) = output {
        output.clear().map_err(Failure::bad_input)?;
    }
    let recorder = Recorder::create(&args.file, &config, details)?;
    let tally = record(args, &tap, recorder, &stop)?;
    let bytes = std::fs::metadata(&*args.file).map_or(0, |file| file.len());
    args.common.print(&RecordResult { file: &args.file, bytes, tally })
}

/// Records until the duration has passed, a signal comes, or [`PATIENCE`] has passed without a cycle.
fn record(args: &RecordArgs, tap: &Tap, mut recorder: Recorder, stop: &AtomicBool) -> Result<Tally, Failure> {
    let end = args.seconds.unwrap_or(f64::INFINITY);
    let bar = match args.seconds {
        Some(seconds) => time_bar(seconds, ""),
        None => spinner("recording; Ctrl-C ends it"),
    };
    let begin = Instant::now();
    while !stop.load(Ordering::Acquire) && recorder.tally().seconds < end {
        tap.drain(Some(&mut recorder), |_| {})?;
        let tally = recorder.tally();
        if tally.cycles == 0 && begin.elapsed() > PATIENCE {
            // The file has no cycles and is removed.
            drop(recorder);
            let _ = std::fs::remove_file(&*args.file);
            let domain = &args.common.process.domain;
            let waited = PATIENCE.as_secs();
            return Err(Failure::failed(format!(
                "no cycle came for {waited} s: is a daemon with a plant running in domain `{domain}`?"
            )));
        }
        bar.set_position((tally.seconds * 1e3) as u64);
        if args.seconds.is_some() {
            bar.set_message(format!("{} cycles, {} lost", tally.cycles, tally.lost));
        }
        std::thread::sleep(PAUSE);
    }
    bar.finish_and_clear();
    Ok(recorder.finish()?)
}
