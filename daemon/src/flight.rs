//! Flight recorder: keeps the newest cycles in memory, and writes them to a file after a fault.
//!
//! A flight record is a sequence of 8-byte words, little-endian: [`MAGIC`], words per record, number of records, the records
//! (fields of [`Telemetry`] in their order, oldest first; the last is the cycle of the fault), then the XXH3 (64 bit) of
//! all bytes before it.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use upswing_config::RecorderSettings;
use upswing_ipc::Telemetry;
use xxhash_rust::xxh3::xxh3_64;

/// First word of a flight record: the type of the file, and the version of its records.
pub const MAGIC: u64 = u64::from_le_bytes(*b"upswfl04");
/// Extension of the file names.
const EXTENSION: &str = "flight";
const WORD: usize = 8;
const RECORD_WORDS: usize = size_of::<Telemetry>() / WORD;

/// Ring of the newest cycles; its memory is allocated once.
#[derive(Debug)]
pub struct FlightRecorder {
    ring: Vec<Telemetry>,
    capacity: usize,
    /// Index of the next cycle in the ring once it is full.
    next: usize,
}

impl FlightRecorder {
    /// Creates a recorder of the last `capacity` cycles, at least 1.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self { ring: Vec::with_capacity(capacity), capacity, next: 0 }
    }

    /// Adds a cycle, in place of the oldest if the ring is full.
    pub fn push(&mut self, record: &Telemetry) {
        if self.ring.len() < self.capacity {
            self.ring.push(*record);
        } else {
            self.ring[self.next] = *record;
            self.next = (self.next + 1) % self.capacity;
        }
    }

    /// The cycles in the ring, oldest first.
    pub fn records(&self) -> impl ExactSizeIterator<Item = &Telemetry> {
        let (newer, older) = self.ring.split_at(self.next);
        (0..self.ring.len()).map(move |i| older.get(i).unwrap_or_else(|| &newer[i - older.len()]))
    }

    /// Writes the cycles to a new file in the folder of the settings, and removes the oldest files beyond the number
    /// to keep. Returns the path of the file; `None` if the settings name no folder.
    ///
    /// # Errors
    /// The I/O error if the folder or the file cannot be written.
    pub fn save(&self, settings: &RecorderSettings) -> io::Result<Option<PathBuf>> {
        let Some(directory) = &settings.directory else { return Ok(None) };
        fs::create_dir_all(directory)?;
        let since = std::time::UNIX_EPOCH.elapsed().map_or(0, |time| time.as_millis());
        // Names sort by time.
        let path = directory.join(format!("{since:015}-{}.{EXTENSION}", std::process::id()));
        // The file gets its final name when it is complete: no reader sees a part of it.
        let unfinished = path.with_extension("part");
        let header = [MAGIC, RECORD_WORDS as u64, self.ring.len() as u64];
        let words = header.into_iter().chain(self.records().flat_map(Telemetry::words));
        let mut bytes: Vec<u8> = words.flat_map(u64::to_le_bytes).collect();
        bytes.extend(xxh3_64(&bytes).to_le_bytes());
        let mut file = fs::File::create(&unfinished)?;
        file.write_all(&bytes)?;
        file.sync_all()?;
        fs::rename(&unfinished, &path)?;
        // A file that cannot be removed is tried again at the next fault.
        let _ = remove_oldest(directory, settings.keep);
        Ok(Some(path))
    }
}

fn remove_oldest(directory: &Path, keep: usize) -> io::Result<()> {
    let mut files: Vec<PathBuf> = fs::read_dir(directory)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == EXTENSION))
        .collect();
    files.sort();
    let surplus = files.len().saturating_sub(keep);
    files[..surplus].iter().try_for_each(fs::remove_file)
}

/// Error of a file that cannot be read as a flight record.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// The file cannot be read.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file is of another type or version.
    #[error("not a flight record of this version: it begins with {got:016x}, expected {MAGIC:016x}")]
    Magic {
        /// First word of the file; 0 if it is empty.
        got: u64,
    },
    /// The header states a length that is not the length of the file.
    #[error("flight record of {got} bytes, its header states {expected}")]
    Size {
        /// Length by the header, bytes.
        expected: u64,
        /// Length of the file, bytes.
        got: u64,
    },
    /// The checksum does not match the contents.
    #[error("flight record damaged: checksum {got:016x}, its contents give {expected:016x}")]
    Checksum {
        /// Checksum of the contents.
        expected: u64,
        /// Checksum in the file.
        got: u64,
    },
}

/// Reads a file written by [`FlightRecorder::save`]; returns its cycles, oldest first.
///
/// # Errors
/// [`FlightError`] if the file cannot be read or is no valid flight record.
pub fn read(path: &Path) -> Result<Vec<Telemetry>, FlightError> {
    let bytes = upswing_config::read_file(path)?;
    let words: Vec<u64> = bytes.as_chunks::<WORD>().0.iter().map(|word| u64::from_le_bytes(*word)).collect();
    let word = |i: usize| words.get(i).copied().unwrap_or(0);
    if word(0) != MAGIC || word(1) != RECORD_WORDS as u64 {
        return Err(FlightError::Magic { got: word(0) });
    }
    let expected = word(2).saturating_mul(RECORD_WORDS as u64).saturating_add(4).saturating_mul(WORD as u64);
    let got = bytes.len() as u64;
    if got != expected {
        return Err(FlightError::Size { expected, got });
    }
    let (body, checksum) = (&bytes[..bytes.len() - WORD], word(words.len() - 1));
    let expected = xxh3_64(body);
    if checksum != expected {
        return Err(FlightError::Checksum { expected, got: checksum });
    }
    let records = &words[3..words.len() - 1];
    Ok(records.chunks_exact(RECORD_WORDS).filter_map(Telemetry::from_words).collect())
}
