//! The flight recorder: the cycles before a fault, in memory at all times, in a file after a fault.
//!
//! A file is a sequence of 8-byte words, little-endian: [`MAGIC`], words of one record, number of records, the records
//! (fields of [`Telemetry`] in their order, oldest first; the last is the cycle of the fault), then the XXH3 (64 bit) of
//! all bytes before it.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use upswing_config::RecorderSettings;
use upswing_ipc::Telemetry;
use xxhash_rust::xxh3::xxh3_64;

/// The first word: what the file is, and the version of its records.
pub const MAGIC: u64 = u64::from_le_bytes(*b"upswfl03");
/// Ending of the names of its files.
const EXTENSION: &str = "flight";
const WORD: usize = 8;
const RECORD_WORDS: usize = size_of::<Telemetry>() / WORD;

/// The newest cycles; memory is taken once.
#[derive(Debug)]
pub struct FlightRecorder {
    ring: Vec<Telemetry>,
    capacity: usize,
    /// Where the next cycle goes once the ring is full.
    next: usize,
}

impl FlightRecorder {
    /// A recorder of the last `capacity` cycles, at least 1.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self { ring: Vec::with_capacity(capacity), capacity, next: 0 }
    }

    /// Keeps a cycle, instead of the oldest if there is no more room.
    pub fn push(&mut self, record: &Telemetry) {
        if self.ring.len() < self.capacity {
            self.ring.push(*record);
        } else {
            self.ring[self.next] = *record;
            self.next = (self.next + 1) % self.capacity;
        }
    }

    /// The kept cycles, oldest first.
    pub fn records(&self) -> impl ExactSizeIterator<Item = &Telemetry> {
        let (newer, older) = self.ring.split_at(self.next);
        (0..self.ring.len()).map(move |i| older.get(i).unwrap_or_else(|| &newer[i - older.len()]))
    }

    /// Writes the kept cycles to a new file in the folder of the settings and removes the oldest files there are too
    /// many of; the path of the file, `None` if the settings name no folder.
    ///
    /// # Errors
    /// If the folder or the file cannot be written.
    pub fn save(&self, settings: &RecorderSettings) -> io::Result<Option<PathBuf>> {
        let Some(directory) = &settings.directory else { return Ok(None) };
        fs::create_dir_all(directory)?;
        let since = std::time::UNIX_EPOCH.elapsed().map_or(0, |time| time.as_millis());
        // Names sort by time.
        let path = directory.join(format!("{since:015}-{}.{EXTENSION}", std::process::id()));
        // Complete or not there: a reader never sees half a file under the final name.
        let unfinished = path.with_extension("part");
        let header = [MAGIC, RECORD_WORDS as u64, self.ring.len() as u64];
        let words = header.into_iter().chain(self.records().flat_map(Telemetry::words));
        let mut bytes: Vec<u8> = words.flat_map(u64::to_le_bytes).collect();
        bytes.extend(xxh3_64(&bytes).to_le_bytes());
        let mut file = fs::File::create(&unfinished)?;
        file.write_all(&bytes)?;
        file.sync_all()?;
        fs::rename(&unfinished, &path)?;
        // What cannot be removed is tried again at the next fault.
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

/// Why a file is no flight record.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// It cannot be read.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Another kind of file, or another version.
    #[error("not a flight record of this version: it begins with {got:016x}, expected {MAGIC:016x}")]
    Magic {
        /// The first word; 0 if there is none.
        got: u64,
    },
    /// The sizes in it disagree with the size of the file.
    #[error("flight record of {got} bytes, its header states {expected}")]
    Size {
        /// By the header.
        expected: u64,
        /// Of the file.
        got: u64,
    },
    /// The contents are not those that were written.
    #[error("flight record damaged: checksum {got:016x}, its contents give {expected:016x}")]
    Checksum {
        /// Of the contents.
        expected: u64,
        /// In the file.
        got: u64,
    },
}

/// Reads a file that [`FlightRecorder::save`] wrote: its cycles, oldest first.
///
/// # Errors
/// [`FlightError`] for whatever is no such file.
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
