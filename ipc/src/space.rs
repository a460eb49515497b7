//! Room in shared memory. iceoryx2 maps files that are sparse: a process that touches a page of one for which there is
//! no room dies of SIGBUS. So what is created is reserved at once, and what does not fit is an error then.

use crate::domain::Domain;
use crate::error::IpcError;
use std::fs::OpenOptions;
use std::io::{Error, ErrorKind, Result};
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// What creation itself touches before it can be reserved, and connections that come and go later, bytes.
const SLACK: u64 = 2 << 20;

impl Domain {
    /// What a system of three processes and as many clients as there may be reserves of [`Domain::free_memory`], bytes.
    pub const MEMORY: u64 = 128 << 20;

    /// Bytes that are free in the file system of shared memory.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn free_memory() -> Result<u64> {
        // SAFETY: all-zero is a valid value; the path ends with a zero; the call fills the struct.
        unsafe {
            let mut state: libc::statvfs = std::mem::zeroed();
            match libc::statvfs(c"/dev/shm".as_ptr(), &raw mut state) {
                0 => Ok(state.f_bavail * state.f_frsize),
                _ => Err(Error::last_os_error()),
            }
        }
    }

    /// Runs `create` where there is room for it, and reserves what it created.
    pub(crate) fn with_room<T>(
        &self,
        create: impl FnOnce() -> std::result::Result<T, IpcError>,
    ) -> std::result::Result<T, IpcError> {
        let full = |needed| {
            let free = Self::free_memory().unwrap_or(0);
            IpcError::Full { needed, free, system: Self::MEMORY }
        };
        if Self::free_memory().is_ok_and(|free| free < SLACK) {
            return Err(full(SLACK));
        }
        let created = create()?;
        for path in self.memory() {
            match reserve(&path) {
                Err((needed, e)) if e.kind() == ErrorKind::StorageFull => return Err(full(needed)),
                // Gone meanwhile, or unfinished work of another process: nobody here uses it.
                _ => {}
            }
        }
        Ok(created)
    }
}

/// Gives a file all the pages that it may use; the error comes with the bytes that were missing.
fn reserve(path: &Path) -> std::result::Result<(), (u64, Error)> {
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
