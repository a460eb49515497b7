//! Reservation of shared memory. iceoryx2 maps sparse files: a process that touches a page for which there is no room dies
//! of SIGBUS. So files are reserved as soon as they are created, and a lack of room is an error then.

use super::layout::Layout;
use crate::error::IpcError;
use std::fs::OpenOptions;
use std::io::{Error, ErrorKind};
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Shared memory of a system of three processes and the largest number of clients, bytes.
pub(crate) const SYSTEM: u64 = 128 << 20;
/// Room that is left for creation itself, which is reserved only afterwards, and for connections that come and go later,
/// bytes.
const SLACK: u64 = 2 << 20;

/// Bytes that are free in the file system of shared memory.
///
/// # Errors
/// Of the operating system.
pub(crate) fn free_memory() -> std::io::Result<u64> {
    // SAFETY: all-zero is a valid value; the path ends with a zero; the call fills the struct.
    unsafe {
        let mut state: libc::statvfs = std::mem::zeroed();
        match libc::statvfs(c"/dev/shm".as_ptr(), &raw mut state) {
            0 => Ok(state.f_bavail * state.f_frsize),
            _ => Err(Error::last_os_error()),
        }
    }
}

/// Runs `create` and reserves the shared memory that it created.
///
/// # Errors
/// [`IpcError::Full`] if there is no room for it, before or after; those of `create`.
pub(crate) fn reserving<T>(
    layout: &Layout,
    create: impl FnOnce() -> Result<T, IpcError>,
) -> Result<T, IpcError> {
    let full = |needed| IpcError::Full { needed, free: free_memory().unwrap_or(0), system: SYSTEM };
    if free_memory().is_ok_and(|free| free < SLACK) {
        return Err(full(SLACK));
    }
    let created = create()?;
    for path in layout.memory() {
        match reserve(&path) {
            Err((needed, e)) if e.kind() == ErrorKind::StorageFull => return Err(full(needed)),
            // Removed meanwhile, or unfinished work of another process: nobody here uses it.
            _ => {}
        }
    }
    Ok(created)
}

/// Reserves all pages of a file; the error comes with the bytes that were missing.
fn reserve(path: &Path) -> Result<(), (u64, Error)> {
    /// Unit of `st_blocks`.
    const BLOCK: u64 = 512;
    let file = OpenOptions::new().write(true).open(path).map_err(|e| (0, e))?;
    let state = file.metadata().map_err(|e| (0, e))?;
    let missing = state.len().saturating_sub(state.blocks() * BLOCK);
    if missing == 0 {
        return Ok(());
    }
    let length = libc::off_t::try_from(state.len()).unwrap_or(libc::off_t::MAX);
    // SAFETY: an open file; its contents stay.
    match unsafe { libc::fallocate(file.as_raw_fd(), 0, 0, length) } {
        0 => Ok(()),
        _ => Err((missing, Error::last_os_error())),
    }
}
