//! `upswing export`: writes a recording as a CSV table.

use super::{CommonArgs, byte_bar, writable};
use crate::parse::window;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use upswing_process::Failure;
use upswing_process::number::{whole, within};
use upswing_process::output::{Destination, Overwrite, PendingFile};
use upswing_record::cycle::CycleNumber;
use upswing_record::{Message, RecordingFile, scan};

/// Writes the cycles of a recording as CSV: one line per cycle, one column per number, in SI units.
///
/// Example: upswing export run.mcap --csv run.csv --from 0.5 --to 3 --every 8
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Recording, or flight record of the daemon
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// CSV file to write
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Destination,
    /// Begin, s after the first cycle
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = within(0.0, 1e9))]
    pub from: f64,
    /// End, s after the first cycle [default: the end of the recording]
    #[arg(long, value_name = "S", value_parser = within(0.0, 1e9))]
    pub to: Option<f64>,
    /// Write only each n-th cycle
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole(1, u32::MAX))]
    pub every: u32,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct ExportResult<'a> {
    csv: &'a Path,
    lines: usize,
    columns: usize,
    cut: Option<String>,
    damage: Option<String>,
}

impl std::fmt::Display for ExportResult<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} cycles, {} columns", self.csv.display(), self.lines, self.columns)?;
        if let Some(why) = &self.cut {
            write!(f, "; the recording ends early ({why})")?;
        }
        self.damage.iter().try_for_each(|damage| write!(f, "; the recording is damaged: {damage}"))
    }
}

/// Writes the cycles of a recording as CSV.
///
/// # Errors
/// [`Failure::BadInput`] if the recording cannot be read, [`Failure::Failed`] if the table cannot be written.
pub fn run(args: &ExportArgs) -> Result<(), Failure> {
    let window = window(args.from, args.to)?;
    let output = writable("--csv", Some(&args.csv), args.overwrite)?;
    let unwritable = |e: std::io::Error| Failure::failed(format!("cannot write {}: {e}", args.csv.display()));
    // Opened at the first cycle: a file that is no recording thus does not overwrite the table.
    let mut table = None;
    let (mut seen, mut lines) = (0, 0);
    let mut numbers = Vec::new();
    let bar = byte_bar();
    let progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let source = RecordingFile::open(&args.file, &args.common.process)?;
    let recording = scan(source.path(), window, progress, |recording, message| -> Result<(), Failure> {
        let Message::Cycle(cycle) = message else { return Ok(()) };
        if let (None, Some(output)) = (&table, &output) {
            let file = table.insert(output.begin().map_err(Failure::failed)?);
            numbers = CycleNumber::all(&recording.model(source.path())?);
            writeln!(file, "{}", columns(&numbers).join(",")).map_err(unwritable)?;
        }
        let Some(file) = &mut table else { return Ok(()) };
        let mut write = || -> std::io::Result<()> {
            if seen % args.every as usize == 0 {
                let words: Vec<u64> = cycle.words().collect();
                let texts: Vec<String> = numbers.iter().map(|number| number.text(&words)).collect();
                writeln!(file, "{}", texts.join(","))?;
                lines += 1;
            }
            seen += 1;
            Ok(())
        };
        write().map_err(unwritable)
    });
    bar.finish_and_clear();
    let recording = recording?;
    table.map_or(Ok(()), PendingFile::finish).map_err(Failure::failed)?;
    args.common.print(&ExportResult {
        csv: &args.csv,
        lines,
        columns: numbers.len(),
        cut: recording.cut,
        damage: recording.damage,
    })
}

/// Names of the columns with joints and units, like `q_joint_1_rad` and `t_plan_s`.
fn columns(numbers: &[CycleNumber]) -> Vec<String> {
    let suffix = |unit: &str| match unit {
        "" => String::new(),
        unit => format!("_{}", unit.replace(' ', "").replace("/s^2", "_s2").replace('/', "_")),
    };
    let name = |number: &CycleNumber| {
        // Names like `t_ns` already contain the unit.
        let unit = if number.field.ends_with("_ns") { String::new() } else { suffix(number.unit) };
        let joint = number.joint.as_ref().map_or_else(String::new, |joint| format!("_{joint}"));
        format!("{}{joint}{unit}", number.field)
    };
    numbers.iter().map(name).collect()
}
