//! Shards, the parts of a long computation that are computed apart, and the journals to which they append what is finished.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// A share of numbered pieces of work: those whose number, counted from 0, is `number - 1` modulo `of`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, from 1.
    pub number: u64,
    /// Number of shards.
    pub of: u64,
}

impl Shard {
    /// All of the work.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Whether the shard contains piece number `piece`, from 0.
    pub fn contains(self, piece: u64) -> bool {
        piece % self.of == self.number - 1
    }

    /// Checks that every one of `of` shards is `present`.
    ///
    /// # Errors
    /// [`MissingShards`]
    pub fn check_all(present: &BTreeSet<u64>, of: u64) -> Result<(), MissingShards> {
        let missing: Vec<u64> = (1..=of).filter(|number| !present.contains(number)).collect();
        if missing.is_empty() { Ok(()) } else { Err(MissingShards { missing, of }) }
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected i/n with 1 <= i <= n, got `{text}`");
        let (number, of) = text.split_once('/').ok_or_else(wrong)?;
        let (number, of) = (number.parse().map_err(|_| wrong())?, of.parse().map_err(|_| wrong())?);
        if number >= 1 && number <= of { Ok(Self { number, of }) } else { Err(wrong()) }
    }
}

/// Error: a merge without the files of all shards.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("shards missing: {} of {of}", .missing.iter().map(u64::to_string).collect::<Vec<_>>().join(", "))]
pub struct MissingShards {
    /// Numbers of the missing shards, from 1.
    pub missing: Vec<u64>,
    /// Number of shards.
    pub of: u64,
}

/// Error of opening a journal.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// Another process writes to it.
    #[error("{} is being written by another process; wait for it or choose another output", .0.display())]
    Busy(PathBuf),
    /// The file cannot be used.
    #[error("cannot {action} {}: {cause}", path.display())]
    File {
        /// Verb of the operation: write, lock.
        action: &'static str,
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
}

/// Opens the journal at `path` for reading and appending, and locks it; the kernel releases the lock when the file is closed or the process
/// dies.
///
/// # Errors
/// [`JournalError`] if another process has it, or if it cannot be used.
pub fn open_journal(path: &Path) -> Result<File, JournalError> {
    let failed = |action| move |cause| JournalError::File { action, path: path.to_owned(), cause };
    upswing_config::check_regular(path).map_err(failed("write"))?;
    let file = OpenOptions::new().create(true).read(true).append(true).open(path);
    let file = file.map_err(failed("write"))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(JournalError::Busy(path.to_owned())),
        Err(TryLockError::Error(cause)) => Err(failed("lock")(cause)),
    }
}
