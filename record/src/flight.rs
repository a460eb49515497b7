//! Flight records of the daemon, read as recordings.

use super::Recorder;
use std::io::Read;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use upswing_process::{Failure, ProcessArgs};
use upswingd::flight;

/// A recording to read: a file, or what was made of a flight record.
pub struct RecordingFile {
    path: PathBuf,
    /// Vanishes with it.
    _folder: Option<TempDir>,
}

impl RecordingFile {
    /// The recording in a file. A flight record holds nothing but cycles: the settings are those of `process`.
    ///
    /// # Errors
    /// [`Failure::BadInput`] for a damaged flight record or unusable settings, [`Failure::Failed`] if there is no room for
    /// the recording that is made of it. What is no flight record is not looked at.
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
