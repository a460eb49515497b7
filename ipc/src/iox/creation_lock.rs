//! The lock of a domain under which one process at a time creates, lists or cleans up.

use super::layout::{Layout, open_regular_file};
use super::leftovers;
use std::fs::{File, Metadata, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Longest wait for the lock. Its holders need milliseconds, on a loaded machine some hundred.
const PATIENCE: Duration = Duration::from_secs(2);
/// Pause between two attempts to lock, and number of attempts between two looks at the process that holds the lock.
const PAUSE: Duration = Duration::from_micros(500);
const ATTEMPTS_PER_LOOK: u32 = 16;
/// Inode of the lock for which this process waited in vain; 0: none. The process does not wait for that lock again until it
/// has acquired it once.
static NOT_GIVEN_BACK: AtomicU64 = AtomicU64::new(0);

/// The creation lock of a domain, held until dropped. Not reentrant.
///
/// While it is held, nobody else creates services or nodes; so its holder can tell the files of a killed process from
/// those of a process at work, and removes the former.
pub(crate) struct CreationLock {
    _file: File,
}

impl CreationLock {
    /// Acquires the creation lock and removes the unfinished files of killed processes.
    ///
    /// `None` if the process that holds the lock is stopped (by a debugger, by Ctrl-Z) or does not give the lock back in
    /// time: nobody waits for a stopped process, and each process waits only once for a lock that is not given back.
    /// Without the lock, creation is no safer than iceoryx2 makes it.
    pub(crate) fn acquire(layout: &Layout) -> Option<Self> {
        Self::acquire_while(layout, &|| true)
    }

    /// As [`Self::acquire`], but waits only as long as `keep_waiting` returns true.
    pub(crate) fn acquire_while(layout: &Layout, keep_waiting: &dyn Fn() -> bool) -> Option<Self> {
        let lock = Self { _file: lock_file(layout, keep_waiting)? };
        leftovers::remove(layout);
        Some(lock)
    }
}

fn lock_file(layout: &Layout, keep_waiting: &dyn Fn() -> bool) -> Option<File> {
    let file = open_regular_file(&layout.creation_lock()).ok()?;
    let state = file.metadata().ok()?;
    let not_given_back = || NOT_GIVEN_BACK.load(Ordering::Relaxed) == state.ino();
    let start = Instant::now();
    let mut attempts = 0_u32;
    loop {
        match file.try_lock() {
            Ok(()) => {
                if not_given_back() {
                    NOT_GIVEN_BACK.store(0, Ordering::Relaxed);
                }
                return Some(file);
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(_)) => return None,
        }
        let look = attempts.is_multiple_of(ATTEMPTS_PER_LOOK);
        if not_given_back() || !keep_waiting() || (look && holder_is_stopped(&state)) {
            return None;
        }
        if start.elapsed() > PATIENCE {
            NOT_GIVEN_BACK.store(state.ino(), Ordering::Relaxed);
            return None;
        }
        attempts += 1;
        std::thread::sleep(PAUSE);
    }
}

/// Whether the process that holds the lock of a file is stopped: proc_locks(5), and the state in proc_pid_stat(5).
fn holder_is_stopped(file: &Metadata) -> bool {
    let (major, minor) = (libc::major(file.dev()), libc::minor(file.dev()));
    let id = format!("{major:02x}:{minor:02x}:{}", file.ino());
    let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
    let holder = locks.lines().find_map(|line| {
        let fields: Vec<_> = line.split_whitespace().collect();
        (fields.get(1) == Some(&"FLOCK") && fields.get(5) == Some(&id.as_str())).then(|| fields[4].to_owned())
    });
    let stat = holder.and_then(|pid| std::fs::read_to_string(format!("/proc/{pid}/stat")).ok());
    let state = stat.as_ref().and_then(|stat| stat.rsplit_once(')')).map(|(_, rest)| rest.trim_start());
    state.is_some_and(|rest| rest.starts_with(['T', 't']))
}
