//! Export of the embedded settings and the shipped database to a folder, for editing.

use crate::database::SHIPPED;
use std::path::Path;
use upswing_config::{Config, DATABASE};
use upswing_process::output::{OutputError, Overwrite};

/// Writes the embedded settings, with their comments, and the shipped database to the folder `dir`, which is created if it
/// does not exist.
///
/// # Errors
/// [`OutputError`] if one of the files exists and may not be replaced (no file is written then), or the folder is not writable.
pub fn export(dir: &Path, overwrite: Overwrite) -> Result<(), OutputError> {
    let files = || Config::files().chain([(DATABASE, SHIPPED)]).map(|(name, bytes)| (dir.join(name), bytes));
    for (path, _) in files().filter(|(path, _)| path.exists()) {
        overwrite.output(&path).check()?;
    }
    for (path, bytes) in files() {
        let folder = path.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder)
            .map_err(|cause| OutputError::Io { path: folder.to_owned(), cause })?;
        overwrite.output(&path).write(bytes)?;
    }
    Ok(())
}
