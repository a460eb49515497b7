//! `upswing replay`: runs a recording through the controller and compares the commands.

use super::{CommonArgs, writable};
use serde::Serialize;
use std::path::{Path, PathBuf};
use upswing_config::Config;
use upswing_process::Failure;
use upswing_process::output::{Destination, OutputFile, Overwrite};
use upswing_record::replay::{Difference, RecordedRun, Replay, replay, settings};
use upswing_record::{Message, Recorder, RecordingError};

/// Replays a recording through the controller and compares every number of every cycle, bit for bit.
///
/// The controller gets the recorded measurements, orders and plans, with the recorded settings. Exit code 1: a number
/// differs. --keep writes a small recording of the inputs and of the modes and faults that the present controller computes with the
/// settings of --system; in tests/recordings it is a regression test.
///
/// Example: upswing replay run.mcap --keep tests/recordings/lost-encoder.mcap
#[derive(Clone, Debug, clap::Args)]
pub struct ReplayArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Recording that began before the daemon
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Small recording to write
    #[arg(long, value_name = "FILE.mcap")]
    pub keep: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct ReplayResult<'a> {
    success: bool,
    file: &'a Path,
    steps: u64,
    compared: u64,
    difference: &'a Option<Difference>,
    decision: &'a Option<Difference>,
    kept: Option<&'a Path>,
}

impl std::fmt::Display for ReplayResult<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} steps, {} cycles compared: ", self.file.display(), self.steps, self.compared)?;
        match (self.difference, self.decision) {
            (None, _) => write!(f, "the same, bit for bit")?,
            (Some(number), decision) => {
                write!(f, "first difference in {}", text(number))?;
                match decision {
                    None => write!(f, "; modes and faults are the same")?,
                    Some(decision) => write!(f, "; modes or faults differ first in {}", text(decision))?,
                }
            }
        }
        match self.kept {
            Some(file) => write!(f, "; kept in {}", file.display()),
            None => Ok(()),
        }
    }
}

fn text(difference: &Difference) -> String {
    let Difference { cycle, field, recorded, replayed } = difference;
    format!("cycle {cycle}: {field} was {recorded}, is {replayed}")
}

/// Replays the recording.
///
/// # Errors
/// [`Failure::BadInput`] if the file cannot be replayed, [`Failure::Failed`] if a number differs.
pub fn run(args: &ReplayArgs) -> Result<(), Failure> {
    let kept = writable("--keep", args.keep.as_ref(), args.overwrite)?;
    let recorded = RecordedRun::read(&args.file)?;
    let bad = |e: &dyn std::fmt::Display| Failure::BadInput(format!("{}: {e}", args.file.display()));
    let result =
        settings(&recorded.recording).and_then(|config| replay(&recorded, &config)).map_err(|e| bad(&e))?;
    if let Some(file) = &kept {
        let config = args.common.process.load()?;
        let today = replay(&recorded, &config).map_err(|e| bad(&e))?;
        keep(file, &config, &recorded, &today)?;
    }
    let success = result.difference.is_none();
    args.common.print(&ReplayResult {
        success,
        file: &args.file,
        steps: result.steps,
        compared: result.compared,
        difference: &result.difference,
        decision: &result.decision,
        kept: args.keep.as_deref(),
    })?;
    if success { Ok(()) } else { Err(Failure::failed("the replay differs from the recording")) }
}

/// Writes a recording of all inputs, and of those replayed cycles that are first, last, or change mode or fault.
fn keep(file: &OutputFile, config: &Config, recorded: &RecordedRun, replay: &Replay) -> Result<(), Failure> {
    file.clear().map_err(|e| Failure::BadInput(format!("--keep: {e}")))?;
    let details = [("kept", env!("CARGO_PKG_VERSION").to_owned())];
    let write = || -> Result<_, RecordingError> {
        let mut recorder = Recorder::create(file.path(), config, details)?;
        for input in &recorded.inputs {
            match input {
                Message::Step(step) => recorder.write_steps(std::slice::from_ref(step))?,
                Message::Plan(plan) => recorder.write_plan(plan)?,
                Message::Cycle(_) => {}
            }
        }
        let cycles = &replay.cycles;
        for (i, cycle) in cycles.iter().enumerate() {
            let same =
                |other: &upswing_ipc::Telemetry| (other.mode, other.fault) == (cycle.mode, cycle.fault);
            let (before, last) = (i.checked_sub(1).map(|i| &cycles[i]), i + 1 == cycles.len());
            if last || !before.is_some_and(same) {
                recorder.write(std::slice::from_ref(cycle))?;
            }
        }
        recorder.finish()
    };
    write()?;
    Ok(())
}
