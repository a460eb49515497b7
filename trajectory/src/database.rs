//! The trajectory database as a file.
//!
//! Little-endian: the header (magic, format version, dimensions, fingerprints, number of entries), then per entry
//! its cost, t_F, x_0..x_N and u_0..u_N, each entry followed by its checksum (xxh3); the header has one, too.

use crate::{KNOTS, Trajectory};
use upswing_model::{ActuatedVector, NU, NX, State};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 8] = b"upswing\0";
const VERSION: u64 = 1;
/// Magic, version, NX, NU, KNOTS, two fingerprints, count, checksum.
const HEADER: usize = 9 * 8;
const ENTRY: usize = (2 + KNOTS * (NX + NU) + 1) * 8;

/// One solved start.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// J (6a).
    pub cost: f64,
    /// The trajectory; its x_0 is the start.
    pub trajectory: Trajectory,
}

/// Trajectories of one robot under one set of limits and weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Database {
    /// Fingerprint of the model.
    pub model: u64,
    /// Fingerprint of limits, weights and target of the optimisation.
    pub problem: u64,
    /// The entries, in the order of the grid.
    pub entries: Vec<Entry>,
}

/// Why bytes are not a usable database.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DatabaseError {
    /// Too short or of an odd length.
    #[error(
        "expected {expected} bytes for {entries} entries, got {got}: the file is truncated or was appended to"
    )]
    Length {
        /// Bytes that the header promises.
        expected: usize,
        /// Bytes there.
        got: usize,
        /// Entries that the header promises.
        entries: u64,
    },
    /// Another kind of file.
    #[error("not an upswing database: it begins with {got:02x?}")]
    Magic {
        /// The first bytes.
        got: Vec<u8>,
    },
    /// Written by another version, or for other dimensions.
    #[error("{what}: this build expects {expected}, the file has {got}")]
    Layout {
        /// What differs.
        what: &'static str,
        /// Of this build.
        expected: u64,
        /// Of the file.
        got: u64,
    },
    /// A checksum does not match.
    #[error("{what} is damaged: checksum {expected:016x} is recorded, the bytes give {got:016x}")]
    Checksum {
        /// Header or entry.
        what: String,
        /// Recorded.
        expected: u64,
        /// Computed.
        got: u64,
    },
    /// Made for another robot or other settings.
    #[error(
        "the database was made for another {what}: its fingerprint is {got:016x}, the settings give \
         {expected:016x}; rebuild it with `upswing db build`"
    )]
    Fingerprint {
        /// Model or problem.
        what: &'static str,
        /// Of the settings.
        expected: u64,
        /// Of the file.
        got: u64,
    },
    /// No entries.
    #[error("the database is empty; build one with `upswing db build`")]
    Empty,
}

impl Database {
    /// The bytes of the file.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + ENTRY * self.entries.len());
        bytes.extend_from_slice(MAGIC);
        let header = [
            VERSION,
            NX as u64,
            NU as u64,
            KNOTS as u64,
            self.model,
            self.problem,
            self.entries.len() as u64,
        ];
        header.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        seal(&mut bytes, 0);
        for entry in &self.entries {
            let start = bytes.len();
            let mut put = |v: f64| bytes.extend_from_slice(&v.to_le_bytes());
            put(entry.cost);
            put(entry.trajectory.t_f);
            entry.trajectory.x.iter().for_each(|x| x.iter().for_each(|v| put(*v)));
            entry.trajectory.u.iter().for_each(|u| u.iter().for_each(|v| put(*v)));
            seal(&mut bytes, start);
        }
        bytes
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`DatabaseError`] naming what does not fit; nothing of a damaged file is used.
    pub fn decode(bytes: &[u8]) -> Result<Self, DatabaseError> {
        if bytes.is_empty() {
            return Err(DatabaseError::Empty);
        }
        if !bytes.starts_with(MAGIC) {
            return Err(DatabaseError::Magic { got: bytes.iter().take(MAGIC.len()).copied().collect() });
        }
        let truncated = |entries, expected| DatabaseError::Length { expected, got: bytes.len(), entries };
        if bytes.len() < HEADER {
            return Err(truncated(0, HEADER));
        }
        let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|b| bytes[i * 8 + b]));
        for (what, i, expected) in [
            ("format version", 1, VERSION),
            ("state dimension", 2, NX as u64),
            ("input dimension", 3, NU as u64),
            ("number of knots", 4, KNOTS as u64),
        ] {
            if word(i) != expected {
                return Err(DatabaseError::Layout { what, expected, got: word(i) });
            }
        }
        check(bytes, 0, HEADER, || "the header".into())?;
        let entries = word(7);
        let expected = usize::try_from(entries)
            .ok()
            .and_then(|n| n.checked_mul(ENTRY)?.checked_add(HEADER))
            .unwrap_or(usize::MAX);
        if bytes.len() != expected {
            return Err(truncated(entries, expected));
        }
        if entries == 0 {
            return Err(DatabaseError::Empty);
        }
        let decode_entry = |(i, chunk): (usize, &[u8])| {
            check(chunk, 0, ENTRY, || format!("entry {i}"))?;
            let mut values = chunk.chunks_exact(8).map(|c| f64::from_le_bytes(std::array::from_fn(|b| c[b])));
            let mut next = || values.next().unwrap_or(f64::NAN);
            let (cost, t_f) = (next(), next());
            let x = (0..KNOTS).map(|_| State::from_fn(|_, _| next())).collect();
            let u = (0..KNOTS).map(|_| ActuatedVector::from_fn(|_, _| next())).collect();
            Ok(Entry { cost, trajectory: Trajectory { t_f, x, u } })
        };
        let entries =
            bytes[HEADER..].chunks_exact(ENTRY).enumerate().map(decode_entry).collect::<Result<_, _>>()?;
        Ok(Self { model: word(5), problem: word(6), entries })
    }

    /// Refuses a database that was made for another robot or other settings.
    ///
    /// # Errors
    /// [`DatabaseError::Fingerprint`] with both fingerprints.
    pub fn check_made_for(&self, model: u64, problem: u64) -> Result<(), DatabaseError> {
        for (what, expected, got) in
            [("robot model", model, self.model), ("set of limits and weights", problem, self.problem)]
        {
            if expected != got {
                return Err(DatabaseError::Fingerprint { what, expected, got });
            }
        }
        Ok(())
    }
}

/// Appends the checksum of the bytes from `start` on.
fn seal(bytes: &mut Vec<u8>, start: usize) {
    let checksum = xxh3_64(&bytes[start..]);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

/// Compares the checksum at the end of `bytes[start..end]`.
fn check(bytes: &[u8], start: usize, end: usize, what: impl Fn() -> String) -> Result<(), DatabaseError> {
    let (content, sum) = bytes[start..end].split_at(end - start - 8);
    let expected = u64::from_le_bytes(std::array::from_fn(|b| sum[b]));
    let got = xxh3_64(content);
    if expected == got { Ok(()) } else { Err(DatabaseError::Checksum { what: what(), expected, got }) }
}
