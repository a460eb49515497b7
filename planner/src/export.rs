//! Export of a system to a folder, for editing.

use crate::database::DatabaseFile;
use std::path::Path;
use upswing_config::{Config, ConfigError};
use upswing_process::output::{OutputError, Overwrite};
use upswing_trajectory::DatabaseSource;

/// The files of a system could not be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A file of the system cannot be read.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file exists and may not be replaced, or the folder is not writable.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Writes the files of a system, settings in full and with their comments, and its databases to the folder `dir`, which is created if it
/// does not exist.
///
/// # Errors
/// [`ExportError`]; if one of the files exists and may not be replaced, no file is written.
pub fn export(config: &Config, dir: &Path, overwrite: Overwrite) -> Result<(), ExportError> {
    let memory = |(name, bytes)| (name, DatabaseSource::Memory(bytes));
    let mut files: Vec<_> = config.files()?.into_iter().map(memory).collect();
    for manoeuvre in 0..config.manoeuvres.len() {
        if let Some(database) = DatabaseFile::of(config, manoeuvre)? {
            files.push((DatabaseFile::name(config, manoeuvre), database.source));
        }
    }
    let files: Vec<_> = files.iter().map(|(name, bytes)| (dir.join(name), bytes)).collect();
    for (path, _) in files.iter().filter(|(path, _)| path.exists()) {
        overwrite.output(path).check()?;
    }
    for (path, bytes) in files {
        let folder = path.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder)
            .map_err(|cause| OutputError::Io { path: folder.to_owned(), cause })?;
        let mut pending = overwrite.output(&path).begin()?;
        bytes.copy_to(&mut pending).map_err(|cause| OutputError::Io { path, cause })?;
        pending.finish()?;
    }
    Ok(())
}
