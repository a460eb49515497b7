//! Conversion of flight records of the daemon to recordings.

use super::Recorder;
use std::io::Read;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use upswing_process::{Failure, ProcessArgs};
use upswingd::flight;

/// A recording to read: a file, or a temporary file converted from a flight record.
pub struct RecordingFile {
    path: PathBuf,
    /// Temporary folder of a converted flight record, deleted on drop.
    _folder: Option<TempDir>,
}

impl RecordingFile {
    /// Opens the recording at `path`; converts a flight record, which holds cycles only, with the settings of `process`.
    ///
    /// # Errors
    /// [`Failure::BadInput`] for a damaged flight record or unusable settings, [`Failure::Failed`] if the temporary
    /// recording cannot be written. Other files are not read here.
    pub fn open(path: &Path, process: &ProcessArgs) -> Result<Self, Failure> {
        if !is_flight_record(path) {
            return Ok(Self { path: path.to_owned(), _folder: None });
        }
        let cycles = flight::read(path).map_err(|e| Failure::BadInput(format!("{}: {e}", path.display())))?;
        let failed = |e: std::io::Error| Failure::Failed(format!("cannot make a temporary folder: {e}"));
        let folder = tempfile::tempdir().map_err(failed)?;
        let recording = folder.path().join("flight.mcap");
        let details = [("flight_record", path.display().to_string())];
        let mut recorder = Recorder::create(&recording, &process.load()?, details)?;
        recorder.write(&cycles)?;
        recorder.finish()?;
        Ok(Self { path: recording, _folder: Some(folder) })
    }

    /// The file to read.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn is_flight_record(path: &Path) -> bool {
    let mut word = [0; 8];
    upswing_config::open_file(path).and_then(|mut file| file.read_exact(&mut word)).is_ok()
        && u64::from_le_bytes(word) == flight::MAGIC
}
