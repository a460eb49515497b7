//! `upswing report`: writes a recording as an HTML page.

use super::{CommonArgs, byte_bar};
use crate::parse::window;
use serde::Serialize;
use std::path::{Path, PathBuf};
use upswing_process::Failure;
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_record::{Message, RecordingError, RecordingFile, scan};
use upswing_view::page::{self, PageData, RecordingDigest};
use upswing_view::picture::figures;

/// Writes one HTML page that shows a recording in any browser, without network: the robot in motion with play, pause and
/// scrub, positions, velocities and torques, modes, cycle times, summary and settings.
///
/// Example: upswing demo --record run.mcap && upswing report run.mcap --svg
#[derive(Clone, Debug, clap::Args)]
pub struct ReportArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Recording, or flight record of the daemon, which is shown with the settings of --system
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Page to write [default: the recording's name with .html]
    #[arg(long, value_name = "FILE.html")]
    pub output: Option<Destination>,
    /// Begin, s after the first cycle
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = within(0.0, 1e9))]
    pub from: f64,
    /// End, s after the first cycle [default: the end of the recording]
    #[arg(long, value_name = "S", value_parser = within(0.0, 1e9))]
    pub to: Option<f64>,
    /// Also write each figure as SVG, beside the page
    #[arg(long)]
    pub svg: bool,
    /// Also write each figure as PNG, beside the page; needs a sans-serif font on this machine
    #[arg(long)]
    pub png: bool,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct ReportResult {
    page: PathBuf,
    figures: Vec<PathBuf>,
    cut: Option<String>,
    damage: Option<String>,
}

impl std::fmt::Display for ReportResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.page.display())?;
        self.figures.iter().try_for_each(|figure| write!(f, "\n{}", figure.display()))?;
        if let Some(why) = &self.cut {
            write!(f, "\nthe recording ends early ({why})")?;
        }
        self.damage.iter().try_for_each(|damage| write!(f, "\nthe recording is damaged: {damage}"))
    }
}

/// Writes the page and the figures of a recording.
///
/// # Errors
/// [`Failure::BadInput`] if the recording cannot be read, [`Failure::Failed`] if a file cannot be written.
pub fn run(args: &ReportArgs) -> Result<(), Failure> {
    let unreadable = |cause| RecordingError::Read { path: args.file.clone(), cause };
    upswing_config::open_file(&args.file).map_err(unreadable)?;
    let page = args.output.as_deref().map_or_else(|| args.file.with_extension("html"), Path::to_path_buf);
    let page = args.overwrite.output(&page);
    let checked = page.check().and_then(|()| figures::check(&page, args.svg, args.png));
    checked.map_err(Failure::bad_input)?;
    let mut digest = None;
    let bar = byte_bar();
    let progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let window = window(args.from, args.to)?;
    let source = RecordingFile::open(&args.file, &args.common.process)?;
    let recording = scan(source.path(), window, progress, |head, message| -> Result<(), Failure> {
        let Message::Cycle(cycle) = message else { return Ok(()) };
        let digest = match &mut digest {
            Some(digest) => digest,
            none => none.insert(RecordingDigest::new(&args.file, head)?),
        };
        digest.take(&cycle);
        Ok(())
    });
    bar.finish_and_clear();
    let recording = recording?;
    // Cannot fail: a recording has at least one cycle.
    let digest = digest.ok_or_else(|| Failure::failed("no cycle"))?;
    let data = PageData::new(&args.file, &recording, &digest)?;
    let mut file = page.begin().map_err(Failure::failed)?;
    let written = page::write(&data, &mut file);
    written.map_err(|e| Failure::failed(format!("cannot write {}: {e}", page.path().display())))?;
    file.finish().map_err(Failure::failed)?;
    let figures = if args.svg || args.png {
        figures::draw(&page, &digest, args.svg, args.png).map_err(Failure::failed)?
    } else {
        Vec::new()
    };
    let page = page.path().to_owned();
    args.common.print(&ReportResult { page, figures, cut: recording.cut, damage: recording.damage })
}
