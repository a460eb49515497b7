//! A database in its file: the index is in memory, entries are read and checked when they are used.

use super::{
    DatabaseError, DatabaseHeading, Entry, Header, KeyTree, OPEN_END, PoseRecord, SHORT_RECORD, VERSION,
};
use crate::Trajectory;
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::sync::OnceLock;
use upswing_model::Model;
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

/// Bytes of the index that are read at once.
const PART: usize = 1 << 18;

/// The bytes of a database: in memory, such as those embedded in a program, or in a file.
///
/// Files are read, not mapped: where a file becomes shorter or its disk fails, a read returns an error, a mapping kills the process.
#[derive(Debug)]
pub enum DatabaseSource {
    /// Bytes in memory.
    Memory(Cow<'static, [u8]>),
    /// An open file.
    File(File),
}

impl DatabaseSource {
    /// Number of bytes.
    ///
    /// # Errors
    /// [`DatabaseError::Unreadable`]
    pub fn length(&self) -> Result<u64, DatabaseError> {
        match self {
            Self::Memory(bytes) => Ok(bytes.len() as u64),
            Self::File(file) => {
                let length = file.metadata().map(|state| state.len());
                length.map_err(|e| DatabaseError::Unreadable { what: "its length".into(), cause: e.kind() })
            }
        }
    }

    /// Fills `bytes` from place `at`; `what` names them for the error.
    pub(super) fn read(
        &self,
        at: u64,
        bytes: &mut [u8],
        what: impl Fn() -> String,
    ) -> Result<(), DatabaseError> {
        let result = match self {
            Self::Memory(memory) => {
                let begin = usize::try_from(at).unwrap_or(usize::MAX);
                let part = memory.get(begin..).and_then(|rest| rest.get(..bytes.len()));
                part.map(|part| bytes.copy_from_slice(part)).ok_or(io::ErrorKind::UnexpectedEof)
            }
            Self::File(file) => file.read_exact_at(bytes, at).map_err(|e| e.kind()),
        };
        result.map_err(|cause| DatabaseError::Unreadable { what: what(), cause })
    }

    /// Writes all bytes to `out`.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn copy_to(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::Memory(bytes) => out.write_all(bytes),
            Self::File(file) => {
                let mut part = vec![0; PART];
                let mut at = 0;
                loop {
                    match file.read_at(&mut part, at) {
                        Ok(0) => return Ok(()),
                        Ok(n) => {
                            out.write_all(&part[..n])?;
                            at += n as u64;
                        }
                        Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                        Err(e) => return Err(e),
                    }
                }
            }
        }
    }
}

/// What a search needs to know of all entries, and the checksums of all records, in the order of the file.
#[derive(Debug, Default)]
pub struct Index {
    /// Checksums of the records.
    sums: Vec<u64>,
    /// t_F of the entries, s.
    durations: Vec<f64>,
    /// Keys of the entries.
    keys: Vec<f64>,
    /// Poses q_A in which the entries end, the keys of those that are run backwards, rad or m.
    ends: Vec<f64>,
}

impl Index {
    /// Adds the next record of the file, which has these bytes; entries come before the others.
    pub fn push(&mut self, record: &PoseRecord, bytes: &[u8]) {
        let content = bytes.len().saturating_sub(8);
        self.sums.push(xxh3_64(&bytes[..content]));
        if let Some(entry) = record.entry() {
            self.durations.push(entry.trajectory.t_f);
            self.keys.extend_from_slice(&entry.key);
            self.ends.extend_from_slice(&entry.trajectory.end().q_a());
        }
    }

    /// The bytes of the index, with which the file ends.
    pub fn encode(self, heading: &DatabaseHeading) -> Vec<u8> {
        let trees = [(heading.key, &self.keys), (heading.sizes.actuated(), &self.ends)]
            .map(|(width, keys)| KeyTree::new(width, keys));
        let mut bytes = Vec::new();
        let mut put = |word: u64| bytes.extend_from_slice(&word.to_le_bytes());
        self.sums.iter().for_each(|sum| put(*sum));
        self.durations.iter().for_each(|t_f| put(t_f.to_bits()));
        for tree in &trees {
            tree.numbers().iter().for_each(|number| put(u64::from(*number)));
            tree.points().iter().for_each(|v| put(v.to_bits()));
        }
        super::seal(&mut bytes);
        bytes
    }
}

/// Reads the words of an index and hashes them.
struct IndexReader<'a> {
    source: &'a DatabaseSource,
    at: u64,
    hash: Xxh3,
    part: Vec<u8>,
}

impl IndexReader<'_> {
    fn bytes(&mut self, length: usize) -> Result<&[u8], DatabaseError> {
        let part = &mut self.part[..length];
        self.source.read(self.at, part, || "the index".into())?;
        self.at += length as u64;
        Ok(part)
    }

    /// Visits the next `count` words, many at once.
    fn visit(&mut self, count: usize, mut visit: impl FnMut(&[[u8; 8]])) -> Result<(), DatabaseError> {
        let mut left = count;
        while left > 0 {
            let words = left.min(PART / 8);
            self.bytes(8 * words)?;
            let part = &self.part[..8 * words];
            self.hash.update(part);
            visit(part.as_chunks().0);
            left -= words;
        }
        Ok(())
    }

    /// The next `count` words, each converted from its bytes.
    fn words<T>(&mut self, count: usize, convert: impl Fn([u8; 8]) -> T) -> Result<Vec<T>, DatabaseError> {
        let mut values = Vec::with_capacity(count);
        self.visit(count, |part| values.extend(part.iter().map(|word| convert(*word))))?;
        Ok(values)
    }

    /// The next tree of `count` keys with `width` coordinates, an empty one unless it is `kept`; `None` if it is not one key for each entry.
    fn tree(&mut self, width: usize, count: usize, kept: bool) -> Result<Option<KeyTree>, DatabaseError> {
        let room = |length: usize| if kept { length } else { 0 };
        let mut numbers = Vec::with_capacity(room(count));
        let mut seen = vec![false; count];
        let mut good = true;
        self.visit(count, |part| {
            let values = part.iter().map(|word| u32::try_from(u64::from_le_bytes(*word)).unwrap_or(u32::MAX));
            good &= values.clone().all(|number| {
                seen.get_mut(number as usize).is_some_and(|seen| !std::mem::replace(seen, true))
            });
            numbers.extend(values.take(room(part.len())));
        })?;
        let mut points = Vec::with_capacity(room(count * width));
        self.visit(count * width, |part| {
            let values = part.iter().map(|word| f64::from_le_bytes(*word));
            good &= values.clone().fold(true, |good, v| good & v.is_finite());
            points.extend(values.take(room(part.len())));
        })?;
        Ok(good.then(|| KeyTree::arranged(width, numbers, points)))
    }
}

/// The index of a file, checked, without the trees that are not kept.
struct CheckedIndex {
    sums: Vec<u64>,
    durations: Vec<f64>,
    keys: KeyTree,
    ends: KeyTree,
    fingerprint: u64,
}

impl CheckedIndex {
    /// Reads and checks the index at `at` of a file with this header, whose numbers are not larger than the file.
    fn read(
        source: &DatabaseSource,
        header: &Header,
        at: u64,
        kept: [bool; 2],
    ) -> Result<Self, DatabaseError> {
        let (records, entries) = (header.records as usize, header.entries as usize);
        let mut reader = IndexReader { source, at, hash: Xxh3::new(), part: vec![0; PART] };
        let sums = reader.words(records, u64::from_le_bytes)?;
        let durations = reader.words(entries, f64::from_le_bytes)?;
        let keys = reader.tree(header.heading.key, entries, kept[0])?;
        let ends = reader.tree(header.heading.sizes.actuated(), entries, kept[1])?;
        let got = reader.hash.digest();
        let fingerprint = super::word(reader.bytes(8)?, 0);
        if fingerprint != got {
            return Err(DatabaseError::Checksum { what: "the index".into(), expected: fingerprint, got });
        }
        let refuse = |what: &str, expected: String| DatabaseError::Value {
            what: what.into(),
            expected,
            got: "others".into(),
        };
        let duration = |t_f: &f64| *t_f > 0.0 && *t_f <= Trajectory::LONGEST;
        if !durations.iter().all(duration) {
            let expected = format!("more than 0 and at most {} s", Trajectory::LONGEST);
            return Err(refuse("durations in the index", expected));
        }
        let whole =
            || refuse("keys in the index", format!("finite numbers, once for each of {entries} entries"));
        let (keys, ends) = (keys.ok_or_else(whole)?, ends.ok_or_else(whole)?);
        Ok(Self { sums, durations, keys, ends, fingerprint })
    }
}

/// Optimal trajectories of one robot under one set of limits and weights: the index in memory, the entries in the file.
#[derive(Debug)]
pub struct Database {
    source: DatabaseSource,
    header: Header,
    /// Checksums of the records.
    sums: Vec<u64>,
    /// t_F of the entries, s.
    durations: Vec<f64>,
    keys: KeyTree,
    /// Read when the first manoeuvre that runs entries backwards asks for it: as large as the keys.
    ends: OnceLock<KeyTree>,
    /// Checksum of the index.
    fingerprint: u64,
}

impl Header {
    pub(super) fn has_index(&self) -> bool {
        self.version == VERSION && self.records != OPEN_END
    }

    /// Place of record number `number` of a file with an index.
    fn place(&self, number: u64) -> u64 {
        let entries = number.min(self.entries);
        self.length + entries * self.heading.long_record() as u64 + (number - entries) * SHORT_RECORD as u64
    }

    /// Place of the index, and bytes of the file; `None` if they are beyond all numbers.
    fn extent(&self) -> Option<(u64, u64)> {
        let records = self.entries.checked_mul(self.heading.long_record() as u64)?;
        let others = (self.records - self.entries).checked_mul(SHORT_RECORD as u64)?;
        let index = self.length.checked_add(records)?.checked_add(others)?;
        let of_entry = (1 + 1 + self.heading.key + 1 + self.heading.sizes.actuated()) as u64;
        let words = self.entries.checked_mul(of_entry)?.checked_add(self.records)?.checked_add(1)?;
        Some((index, index.checked_add(words.checked_mul(8)?)?))
    }
}

impl Database {
    /// Reads and checks header and index. Records are checked when they are read.
    ///
    /// # Errors
    /// [`DatabaseError`] if header or index is damaged or of another version, or if the file has another length than they say.
    pub fn load(source: DatabaseSource) -> Result<Self, DatabaseError> {
        let header = Header::read(&source)?;
        if header.version != VERSION {
            return Err(DatabaseError::NoIndex);
        }
        if header.records == OPEN_END {
            return Err(DatabaseError::Journal);
        }
        let got = source.length()?;
        let (records, entries) = (header.records, header.entries);
        let (at, expected) = header.extent().unwrap_or((u64::MAX, u64::MAX));
        if expected != got {
            let what = format!("{records} records, of which {entries} are entries, and their index");
            return Err(DatabaseError::Length { what, expected, got });
        }
        // From here on no number is larger than the file.
        let index = CheckedIndex::read(&source, &header, at, [true, false])?;
        let CheckedIndex { sums, durations, keys, fingerprint, .. } = index;
        Ok(Self { source, header, sums, durations, keys, ends: OnceLock::new(), fingerprint })
    }

    /// The robot, settings and grid of the database.
    pub fn heading(&self) -> &DatabaseHeading {
        &self.header.heading
    }

    /// Number of entries, the poses with a trajectory.
    pub fn entries(&self) -> usize {
        self.durations.len()
    }

    /// Durations t_F of the entries, s.
    pub fn durations(&self) -> &[f64] {
        &self.durations
    }

    /// Keys of the entries.
    pub fn keys(&self) -> &KeyTree {
        &self.keys
    }

    /// Poses q_A in which the entries end, rad or m; the first call reads them.
    ///
    /// # Errors
    /// [`DatabaseError`] if they cannot be read or the index has changed since it was loaded.
    pub fn ends(&self) -> Result<&KeyTree, DatabaseError> {
        if let Some(ends) = self.ends.get() {
            return Ok(ends);
        }
        let at = self.header.place(self.header.records);
        let index = CheckedIndex::read(&self.source, &self.header, at, [false, true])?;
        let (expected, got) = (self.fingerprint, index.fingerprint);
        if expected != got {
            return Err(DatabaseError::Checksum { what: "the index".into(), expected, got });
        }
        Ok(self.ends.get_or_init(|| index.ends))
    }

    /// XXH3 hash of the index, and so of all records.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// The bytes of the file.
    pub fn into_source(self) -> DatabaseSource {
        self.source
    }

    /// Number of records, one per pose.
    pub fn len(&self) -> usize {
        self.sums.len()
    }

    /// Whether there are no records.
    pub fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    /// Reads record number `number` in the order of the file: the entries first.
    ///
    /// # Errors
    /// [`DatabaseError`] if there is none, or if it cannot be read or is damaged.
    pub fn record(&self, number: usize) -> Result<PoseRecord, DatabaseError> {
        let what = || format!("record {number}");
        let refuse =
            |what: String, expected: String, got: String| Err(DatabaseError::Value { what, expected, got });
        let Some(expected) = self.sums.get(number).copied() else {
            return refuse("record".into(), format!("one of {}", self.len()), number.to_string());
        };
        let solved = number < self.entries();
        let length = if solved { self.heading().long_record() } else { SHORT_RECORD };
        let mut bytes = vec![0; length];
        self.source.read(self.header.place(number as u64), &mut bytes, what)?;
        let (record, _) = PoseRecord::decode(&bytes, number as u64, self.heading())?;
        let got = super::word(&bytes, length / 8 - 1);
        if expected != got {
            return Err(DatabaseError::Checksum { what: what(), expected, got });
        }
        if record.entry().is_some() != solved {
            let expected = if solved { "a trajectory" } else { "no trajectory" };
            return refuse(what(), expected.into(), "the other".into());
        }
        Ok(record)
    }

    /// Reads entry number `number`.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn entry(&self, number: usize) -> Result<Entry, DatabaseError> {
        match self.record(number)?.outcome {
            super::PoseOutcome::Solved(entry) => Ok(*entry),
            _ => Err(DatabaseError::Value {
                what: "entry".into(),
                expected: format!("one of {}", self.entries()),
                got: number.to_string(),
            }),
        }
    }

    /// Reads all records, one after the other.
    pub fn records(&self) -> impl Iterator<Item = Result<PoseRecord, DatabaseError>> {
        (0..self.len()).map(|number| self.record(number))
    }

    /// Checks that plans can be made of the entries: the database is whole, has entries, and was made for the model, and for the problem
    /// with this fingerprint.
    ///
    /// # Errors
    /// Those of [`DatabaseHeading::check_origin`], [`DatabaseError::Shard`] or [`DatabaseError::Empty`].
    pub fn check_for(&self, model: &Model, problem: u64) -> Result<(), DatabaseError> {
        let h = self.heading();
        h.check_origin(model, problem)?;
        if h.shards > 1 {
            return Err(DatabaseError::Shard { shard: h.shard, shards: h.shards });
        }
        if self.entries() == 0 { Err(DatabaseError::Empty) } else { Ok(()) }
    }
}
