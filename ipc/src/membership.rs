//! Membership of processes in a domain: a shared lock on the domain's directory. The last member that leaves removes all
//! files of the domain.

use crate::domain::Domain;
use crate::error::IpcError;
use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::time::{Duration, Instant};

/// Number of attempts to enter a directory that others remove at the same time.
const ENTER_ATTEMPTS: usize = 100;
/// How long a removal waits for the last members to leave, and the pause between attempts.
const REMOVAL_PATIENCE: Duration = Duration::from_millis(100);
const PAUSE: Duration = Duration::from_millis(1);

/// A shared lock on the directory of a domain: nobody removes the domain while it is held. Whoever drops the last one
/// removes the domain.
pub(crate) struct Membership {
    lock: File,
    domain: Domain,
}

impl Membership {
    /// Becomes a member of `domain`, whose directory is created if it is missing.
    ///
    /// # Errors
    /// [`IpcError::Root`] or [`IpcError::Foreign`] if the directory cannot be used.
    pub(crate) fn begin(domain: &Domain) -> Result<Self, IpcError> {
        for _ in 0..ENTER_ATTEMPTS {
            let lock = open_directory(domain)?;
            lock.lock_shared().map_err(|cause| root_error(domain, "lock", cause))?;
            // The directory may have been removed before it was locked: then the lock is on a removed directory.
            if is_current(domain, &lock) {
                return Ok(Self { lock, domain: domain.clone() });
            }
        }
        Err(root_error(domain, "hold", ErrorKind::NotFound.into()))
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        // A shared lock becomes an exclusive one unless there is another member. What cannot be removed is left to the next
        // member.
        if self.lock.try_lock().is_ok() {
            let _ = remove(&self.domain, &self.lock);
        }
    }
}

impl Domain {
    /// Removes all files of the domain if no process uses it, and returns whether there are none now. Needed only where the
    /// last process was killed.
    ///
    /// # Errors
    /// [`IpcError::Root`] or [`IpcError::Foreign`] if a file cannot be removed, [`IpcError::List`] if the nodes of the
    /// domain cannot be listed.
    pub fn remove_if_unused(&self) -> Result<bool, IpcError> {
        if !self.exists() && self.layout().memory().next().is_none() {
            return Ok(true);
        }
        let directory = open_directory(self)?;
        let start = Instant::now();
        loop {
            match directory.try_lock() {
                Ok(()) => break,
                // A process that is being started holds the locks of its parent for an instant.
                Err(TryLockError::WouldBlock) if start.elapsed() < REMOVAL_PATIENCE => {
                    std::thread::sleep(PAUSE);
                }
                Err(TryLockError::WouldBlock) => return Ok(false),
                Err(TryLockError::Error(cause)) => return Err(root_error(self, "lock", cause)),
            }
        }
        remove(self, &directory)
    }
}

/// Removes all files of `domain`, whose directory this process has locked exclusively as `directory`, unless programs in
/// other languages, which do not lock it, live in the domain; returns whether it did.
fn remove(domain: &Domain, directory: &File) -> Result<bool, IpcError> {
    if !is_current(domain, directory) || domain.has_live_nodes()? {
        return Ok(false);
    }
    for path in domain.layout().memory() {
        ignore_missing(std::fs::remove_file(&path)).map_err(|cause| IpcError::Root {
            action: "remove",
            path,
            cause,
        })?;
    }
    ignore_missing(std::fs::remove_dir_all(domain.root()))
        .map_err(|cause| root_error(domain, "remove", cause))?;
    Ok(true)
}

/// Opens the directory of the domain, creates it if it is missing, and makes sure that only this user can enter it.
fn open_directory(domain: &Domain) -> Result<File, IpcError> {
    let root = domain.root();
    let failed = |action| move |cause| root_error(domain, action, cause);
    for _ in 0..ENTER_ATTEMPTS {
        match DirBuilder::new().mode(0o700).create(&root) {
            Err(e) if e.kind() != ErrorKind::AlreadyExists => return Err(failed("create")(e)),
            _ => {}
        }
        let link = match root.symlink_metadata() {
            Err(e) if e.kind() == ErrorKind::NotFound => continue,
            other => other.map_err(failed("inspect"))?,
        };
        // SAFETY: no arguments, cannot fail.
        let expected = unsafe { libc::geteuid() };
        if !link.is_dir() || link.uid() != expected {
            return Err(IpcError::Foreign { path: root, expected });
        }
        let directory = match File::open(&root) {
            Err(e) if e.kind() == ErrorKind::NotFound => continue,
            other => other.map_err(failed("open"))?,
        };
        if link.mode() & 0o077 != 0 {
            directory.set_permissions(Permissions::from_mode(0o700)).map_err(failed("restrict"))?;
        }
        if is_current(domain, &directory) {
            return Ok(directory);
        }
    }
    Err(root_error(domain, "enter", ErrorKind::NotFound.into()))
}

/// Whether `directory` is still the one at the path of the domain.
fn is_current(domain: &Domain, directory: &File) -> bool {
    match (directory.metadata(), domain.root().symlink_metadata()) {
        (Ok(opened), Ok(named)) => (opened.dev(), opened.ino()) == (named.dev(), named.ino()),
        _ => false,
    }
}

fn root_error(domain: &Domain, action: &'static str, cause: std::io::Error) -> IpcError {
    IpcError::Root { action, path: domain.root(), cause }
}

fn ignore_missing(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
