//! The settings that iceoryx2 keeps once per process: its log level and its global configuration.

use super::layout::{Layout, open_regular_file};
use crate::error::IpcError;
use iceoryx2::prelude::{Config, FilePath, LogLevel, SemanticString, set_log_level};
use std::os::unix::fs::FileExt;
use std::sync::{Mutex, PoisonError};

/// Sets log level and global configuration of iceoryx2, at the first call in a process. To be called under the creation lock,
/// before the first node.
///
/// Every call of this crate passes its configuration, except inside iceoryx2: the clean-up after a process that was killed
/// before its node was complete falls back to the global one. Unless that is set, iceoryx2 would look for it in the working
/// directory. In a process with several domains the first one stays set.
///
/// # Errors
/// [`IpcError::Root`] if the settings cannot be written into the domain's directory or read back.
pub(crate) fn set(layout: &Layout) -> Result<(), IpcError> {
    static SET: Mutex<bool> = Mutex::new(false);
    let mut set = SET.lock().unwrap_or_else(PoisonError::into_inner);
    if *set {
        return Ok(());
    }
    set_log_level(LogLevel::Error);
    let path = layout.settings();
    let root = layout.root.display();
    let settings = format!("[global]\nroot-path = \"{root}\"\nprefix = \"{}\"\n", layout.prefix);
    let failed = |action| {
        let path = path.clone();
        move |cause| IpcError::Root { action, path, cause }
    };
    // In place, not by a draft that a killed process would leave: under the lock nobody else reads it.
    let written = open_regular_file(&path).and_then(|file| {
        file.set_len(0)?;
        file.write_all_at(settings.as_bytes(), 0)
    });
    written.map_err(failed("write"))?;
    let iox_path = FilePath::new(path.as_os_str().as_encoded_bytes())
        .map_err(|e| failed("name")(std::io::Error::other(format!("{e:?}"))))?;
    Config::setup_global_config_from_file(&iox_path).map_err(|e| failed("load")(std::io::Error::other(e)))?;
    *set = true;
    Ok(())
}
