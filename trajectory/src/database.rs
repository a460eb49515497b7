//! The trajectory database as a file.
//!
//! Little-endian words of 8 bytes. The header: magic, format version, dimensions, fingerprints, size of the grid,
//! shard, number of records, checksum. Then one record per pose of the grid, in its order: number of the pose,
//! outcome and, where that is a trajectory, its certificate, t_F, x_0, and (u_k, q_U,k, qd_U,k) at each knot; the arm's
//! states follow from u by (6b), which is exact for its double integrators. Each record ends with its checksum (xxh3).
//!
//! While a database is built its records are appended to a journal: the same file without the number of records.

use crate::{Certificate, KNOTS, N, Trajectory};
use upswing_model::{ActuatedVector, N_UNACTUATED, NQ, NU, NX, State};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 8] = b"upswing\0";
const VERSION: u64 = 2;
/// Words of the header, the checksum included.
const HEADER_WORDS: usize = 13;
const HEADER: usize = 8 * HEADER_WORDS;
/// Number of records of a journal.
const OPEN_END: u64 = u64::MAX;
/// Pose, outcome, checksum.
const SHORT_RECORD: usize = 3 * 8;
/// Certificate, t_F, x_0, knots.
const ENTRY_WORDS: usize = 6 + 1 + NX + KNOTS * (NU + 2 * N_UNACTUATED);
const LONG_RECORD: usize = SHORT_RECORD + 8 * ENTRY_WORDS;

/// One solved start.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The trajectory; its x_0 is the start.
    pub trajectory: Trajectory,
    /// Its figures.
    pub certificate: Certificate,
}

/// What became of one pose of the grid.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Left out by the rules of the grid: no rest position within the limits.
    Rejected,
    /// No trajectory was found.
    Failed,
    /// Solved.
    Solved(Box<Entry>),
}

/// One pose of the grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Number of the pose in the order of the grid, from 0.
    pub pose: u64,
    /// What became of it.
    pub outcome: Outcome,
}

/// What a database was made for, and which part of it a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heading {
    /// Fingerprint of the model.
    pub model: u64,
    /// Fingerprint of limits, weights and target of the optimisation.
    pub problem: u64,
    /// Fingerprint of the grid.
    pub grid: u64,
    /// Poses of the whole grid.
    pub poses: u64,
    /// Number of this shard, from 1.
    pub shard: u64,
    /// Number of shards; 1: the whole database.
    pub shards: u64,
}

/// Trajectories of one robot under one set of limits and weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Database {
    /// What it was made for.
    pub heading: Heading,
    /// One record per pose, in the order of the grid.
    pub records: Vec<Record>,
}

/// Why bytes are not a usable database.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DatabaseError {
    /// Too short or too long.
    #[error("expected {expected} bytes for {what}, got {got}: the file is truncated or was appended to")]
    Length {
        /// What the bytes should hold.
        what: String,
        /// Bytes that belong there.
        expected: usize,
        /// Bytes there.
        got: usize,
    },
    /// Another kind of file.
    #[error("not an upswing database: it begins with {got:02x?}")]
    Magic {
        /// The first bytes.
        got: Vec<u8>,
    },
    /// Written by another version, or for other dimensions.
    #[error("{what}: this build expects {expected}, the file has {got}; rebuild it with `upswing db build`")]
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
        /// Header or record.
        what: String,
        /// Recorded.
        expected: u64,
        /// Computed.
        got: u64,
    },
    /// A number that the format does not have.
    #[error("{what}: expected {expected}, got {got}")]
    Value {
        /// Which number.
        what: String,
        /// What it may be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// Made for another robot or other settings.
    #[error(
        "the database was made for another {what}: its fingerprint is {got:016x}, the settings give \
         {expected:016x}; rebuild it with `upswing db build`"
    )]
    Fingerprint {
        /// Model, problem or grid.
        what: &'static str,
        /// Of the settings.
        expected: u64,
        /// Of the file.
        got: u64,
    },
    /// No entries.
    #[error("the database is empty; build one with `upswing db build`")]
    Empty,
    /// Only a part.
    #[error("the file is shard {shard} of {shards}; join all of them with `upswing db merge`")]
    Shard {
        /// Its number.
        shard: u64,
        /// How many there are.
        shards: u64,
    },
}

impl Entry {
    /// An entry from a solver's trajectory. The arm's states are replaced by those that follow from x_0 and u by
    /// (6b), which differ by the solver's tolerance: what is certified is what the file holds.
    pub fn new(trajectory: &Trajectory, certify: impl FnOnce(&Trajectory) -> Certificate) -> Self {
        let trajectory = integrate_arm(trajectory.clone());
        let certificate = certify(&trajectory);
        Self { trajectory, certificate }
    }
}

/// Fills in q_A and qd_A of all knots but the first from u by (6b).
fn integrate_arm(mut t: Trajectory) -> Trajectory {
    let half_h = 0.5 * t.h();
    for k in 0..N {
        for i in 0..NU {
            let qd = t.x[k][NQ + i] + half_h * (t.u[k][i] + t.u[k + 1][i]);
            t.x[k + 1][i] = t.x[k][i] + half_h * (t.x[k][NQ + i] + qd);
            t.x[k + 1][NQ + i] = qd;
        }
    }
    t
}

impl Heading {
    /// The header of a file with so many records.
    fn encode(&self, records: u64) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let words = [
            VERSION,
            NX as u64,
            NU as u64,
            KNOTS as u64,
            self.model,
            self.problem,
            self.grid,
            self.poses,
            self.shard,
            self.shards,
            records,
        ];
        words.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        seal(&mut bytes);
        bytes
    }

    /// The bytes with which a journal begins.
    pub fn journal(&self) -> Vec<u8> {
        self.encode(OPEN_END)
    }

    fn decode(bytes: &[u8]) -> Result<(Self, u64), DatabaseError> {
        if bytes.is_empty() {
            return Err(DatabaseError::Empty);
        }
        if !bytes.starts_with(MAGIC) {
            return Err(DatabaseError::Magic { got: bytes.iter().take(MAGIC.len()).copied().collect() });
        }
        let dimensions = [
            ("format version", 1, VERSION),
            ("state dimension", 2, NX as u64),
            ("input dimension", 3, NU as u64),
            ("number of knots", 4, KNOTS as u64),
        ];
        // The version first: only then the length means something.
        for (what, i, expected) in dimensions {
            if bytes.len() >= (i + 1) * 8 && word(bytes, i) != expected {
                return Err(DatabaseError::Layout { what, expected, got: word(bytes, i) });
            }
        }
        if bytes.len() < HEADER {
            return Err(DatabaseError::Length {
                what: "the header".into(),
                expected: HEADER,
                got: bytes.len(),
            });
        }
        check(&bytes[..HEADER], || "the header".into())?;
        let [model, problem, grid, poses, shard, shards, records] =
            std::array::from_fn(|i| word(bytes, 5 + i));
        let heading = Self { model, problem, grid, poses, shard, shards };
        if shard == 0 || shard > shards {
            let expected = format!("1 to {shards}");
            return Err(DatabaseError::Value { what: "shard".into(), expected, got: shard.to_string() });
        }
        Ok((heading, records))
    }
}

impl Record {
    /// The bytes of the record.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = self.pose.to_le_bytes().to_vec();
        let outcome: u64 = match &self.outcome {
            Outcome::Rejected => 0,
            Outcome::Failed => 1,
            Outcome::Solved(_) => 2,
        };
        bytes.extend_from_slice(&outcome.to_le_bytes());
        if let Outcome::Solved(entry) = &self.outcome {
            let mut put = |v: f64| bytes.extend_from_slice(&v.to_le_bytes());
            entry.certificate.to_array().into_iter().for_each(&mut put);
            let t = &entry.trajectory;
            put(t.t_f);
            t.x[0].iter().for_each(|v| put(*v));
            for (x, u) in t.knots() {
                u.iter().for_each(|v| put(*v));
                for i in 0..N_UNACTUATED {
                    put(x[NU + i]);
                    put(x[NQ + NU + i]);
                }
            }
        }
        seal(&mut bytes);
        bytes
    }

    /// Reads the record at the beginning of `bytes`; its length comes with it.
    fn decode(bytes: &[u8], number: usize) -> Result<(Self, usize), DatabaseError> {
        let what = || format!("record {number}");
        let truncated = |expected| DatabaseError::Length { what: what(), expected, got: bytes.len() };
        if bytes.len() < SHORT_RECORD {
            return Err(truncated(SHORT_RECORD));
        }
        let (pose, kind) = (word(bytes, 0), word(bytes, 1));
        let length = match kind {
            0 | 1 => SHORT_RECORD,
            2 => LONG_RECORD,
            got => {
                let expected = "an outcome from 0 to 2".into();
                return Err(DatabaseError::Value { what: what(), expected, got: got.to_string() });
            }
        };
        let record = bytes.get(..length).ok_or_else(|| truncated(length))?;
        check(record, what)?;
        let outcome = match kind {
            0 => Outcome::Rejected,
            1 => Outcome::Failed,
            _ => Outcome::Solved(Box::new(decode_entry(&record[16..], what)?)),
        };
        Ok((Self { pose, outcome }, length))
    }
}

/// An entry, whose certificate may be any.
fn decode_entry(bytes: &[u8], what: impl Fn() -> String) -> Result<Entry, DatabaseError> {
    let mut values = bytes.chunks_exact(8).map(|c| f64::from_le_bytes(std::array::from_fn(|b| c[b])));
    let mut next = || values.next().unwrap_or(f64::NAN);
    let certificate = Certificate::from_array(std::array::from_fn(|_| next()));
    let t_f = next();
    let mut x = Box::new([State::zeros(); KNOTS]);
    let mut u = Box::new([ActuatedVector::zeros(); KNOTS]);
    x[0] = State::from_fn(|_, _| next());
    for k in 0..KNOTS {
        u[k] = ActuatedVector::from_fn(|_, _| next());
        for i in 0..N_UNACTUATED {
            x[k][NU + i] = next();
            x[k][NQ + NU + i] = next();
        }
    }
    let refuse = |name: &str, expected: String, got: f64| {
        Err(DatabaseError::Value { what: format!("{name} of {}", what()), expected, got: got.to_string() })
    };
    // A NaN is refused, too.
    if !(t_f > 0.0 && t_f <= Trajectory::LONGEST) {
        return refuse("t_F", format!("more than 0 and at most {} s", Trajectory::LONGEST), t_f);
    }
    let trajectory = integrate_arm(Trajectory { t_f, x, u });
    let numbers = trajectory.x.iter().flatten().chain(trajectory.u.iter().flatten());
    if let Some(got) = numbers.copied().find(|v| !v.is_finite()) {
        return refuse("the trajectory", "finite numbers".into(), got);
    }
    Ok(Entry { trajectory, certificate })
}

impl Database {
    /// The bytes of the file.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = self.heading.encode(self.records.len() as u64);
        self.records.iter().for_each(|r| bytes.extend(r.encode()));
        bytes
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`DatabaseError`] naming what does not fit; nothing of a damaged file is used.
    pub fn decode(bytes: &[u8]) -> Result<Self, DatabaseError> {
        let (heading, count) = Heading::decode(bytes)?;
        let mut records = Vec::new();
        let mut at = HEADER;
        // A journal has no number of records; the last one must be whole here, too.
        while if count == OPEN_END { at < bytes.len() } else { (records.len() as u64) < count } {
            let (record, length) = Record::decode(&bytes[at..], records.len())?;
            at += length;
            records.push(record);
        }
        if at != bytes.len() {
            let what = format!("{count} records");
            return Err(DatabaseError::Length { what, expected: at, got: bytes.len() });
        }
        Ok(Self { heading, records })
    }

    /// Reads a journal as far as it is whole: what a killed process left behind, and the length of that part.
    ///
    /// # Errors
    /// [`DatabaseError`] if not even the header is whole.
    pub fn recover(bytes: &[u8]) -> Result<(Self, usize), DatabaseError> {
        let (heading, _) = Heading::decode(bytes)?;
        let mut records = Vec::new();
        let mut at = HEADER;
        while let Ok((record, length)) = Record::decode(&bytes[at..], records.len()) {
            at += length;
            records.push(record);
        }
        Ok((Self { heading, records }, at))
    }

    /// The solved entries, in the order of the grid.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.records.iter().filter_map(|r| match &r.outcome {
            Outcome::Solved(entry) => Some(&**entry),
            _ => None,
        })
    }

    /// Takes the entries of a database that was made for this robot and these settings.
    ///
    /// # Errors
    /// [`DatabaseError::Fingerprint`] with both fingerprints, [`DatabaseError::Shard`] or [`DatabaseError::Empty`].
    pub fn entries_for(self, model: u64, problem: u64) -> Result<Vec<Entry>, DatabaseError> {
        let h = &self.heading;
        for (what, expected, got) in
            [("robot model", model, h.model), ("set of limits and weights", problem, h.problem)]
        {
            if expected != got {
                return Err(DatabaseError::Fingerprint { what, expected, got });
            }
        }
        if h.shards > 1 {
            return Err(DatabaseError::Shard { shard: h.shard, shards: h.shards });
        }
        let entries: Vec<Entry> = self
            .records
            .into_iter()
            .filter_map(|r| match r.outcome {
                Outcome::Solved(entry) => Some(*entry),
                _ => None,
            })
            .collect();
        if entries.is_empty() { Err(DatabaseError::Empty) } else { Ok(entries) }
    }
}

fn word(bytes: &[u8], i: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|b| bytes[i * 8 + b]))
}

/// Appends the checksum of the bytes.
fn seal(bytes: &mut Vec<u8>) {
    let checksum = xxh3_64(bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

/// Compares the checksum at the end of `bytes`.
fn check(bytes: &[u8], what: impl Fn() -> String) -> Result<(), DatabaseError> {
    let content = &bytes[..bytes.len() - 8];
    let (expected, got) = (word(bytes, bytes.len() / 8 - 1), xxh3_64(content));
    if expected == got { Ok(()) } else { Err(DatabaseError::Checksum { what: what(), expected, got }) }
}
