//! The file format of the trajectory database.
//!
//! A file consists of little-endian words of 8 bytes: the header, the records, the index.
//!
//! - The header holds: magic, format version, number of its bytes, n, n_A, N, length of the keys, fingerprints, number of poses in the grid,
//!   shard, number of records, number of entries, names of the joints, checksum. A name is its number of bytes, and the bytes, filled up
//!   to a whole word with zeros; names and vectors have the order [A, U].
//! - There is one record per pose of the grid: first those with a trajectory, the entries, then the others, both in the order of the grid.
//!   A record holds: number of the pose, outcome and, if a trajectory was found, its key, its certificate, t_F, x_0, and
//!   (u_k, q_U,k, qd_U,k) at each knot. The states of the actuated joints follow from u by (6b), which is exact for double integrators.
//!   Each record ends with its checksum.
//! - The index holds what a search needs ([`Index`]). It is in memory while a database is in use; entries are read when they are used.
//!
//! Checksums are XXH3, 64 bit. The index holds those of all records: its own checksum is that of the whole contents.
//!
//! During a build, records are appended to a journal: a header without the number of records, and records in any order.

mod keys;
mod scan;
mod stored;

pub use keys::{KeyTree, Neighbour};
pub use scan::{RecordScan, read_record};
pub use stored::{Database, DatabaseSource, Index};

use crate::{Certificate, INTERVALS, Trajectory};
use upswing_model::{ActuatedVector, MOST_JOINTS, Model, Sizes, State};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 8] = b"upswing\0";
const VERSION: u64 = 4;
/// The version whose files have the same records, in the order of the grid, a header without the number of entries, and no index.
const WITHOUT_INDEX: u64 = 3;
/// Words of the header before the names of the joints; one fewer in version [`WITHOUT_INDEX`].
const FIXED_WORDS: u64 = 15;
/// Largest header, bytes: some sixty thousand bytes for each name.
const LARGEST_HEADER: u64 = 1 << 20;
/// Number of records in the header of a journal, which is not known yet.
const OPEN_END: u64 = u64::MAX;
/// Bytes of a record without trajectory: pose, outcome, checksum.
const SHORT_RECORD: usize = 3 * 8;

/// The optimal trajectory from one start state.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// What a search compares: the start pose q_A, then what else the entry was made for.
    pub key: Vec<f64>,
    /// The trajectory; its x_0 is the start state.
    pub trajectory: Trajectory,
    /// The certificate of the trajectory.
    pub certificate: Certificate,
}

/// The result for one pose of the grid.
#[derive(Clone, Debug, PartialEq)]
pub enum PoseOutcome {
    /// The grid leaves the pose out, because the pendulum has no rest position within the limits there.
    Rejected,
    /// The optimisation found no trajectory.
    Failed,
    /// The optimisation found a trajectory.
    Solved(Box<Entry>),
}

/// One pose of the grid with its result.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseRecord {
    /// Number of the pose in the order of the grid, from 0.
    pub pose: u64,
    /// The result for this pose.
    pub outcome: PoseOutcome,
}

/// The robot, the settings and the grid that a database was made for, and the part of it that a file holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatabaseHeading {
    /// Numbers of joints of the robot.
    pub sizes: Sizes,
    /// Names of the joints in the order of the vectors, [A, U].
    pub joints: Vec<String>,
    /// N, the number of intervals of every trajectory.
    pub intervals: usize,
    /// Length of the key of every entry, n_A or more.
    pub key: usize,
    /// Fingerprint of the model.
    pub model: u64,
    /// Fingerprint of the limits, weights and target of the optimisation.
    pub problem: u64,
    /// Fingerprint of the grid.
    pub grid: u64,
    /// Number of poses in the whole grid.
    pub poses: u64,
    /// Number of this shard, from 1.
    pub shard: u64,
    /// Number of shards; 1: the file holds the whole database.
    pub shards: u64,
}

/// The whole contents of a database in memory: of a small one.
#[derive(Clone, Debug, PartialEq)]
pub struct DatabaseContents {
    /// The robot, settings and grid of the database.
    pub heading: DatabaseHeading,
    /// One record per pose, in the order of the grid.
    pub records: Vec<PoseRecord>,
}

/// The header of a file.
#[derive(Clone, Debug)]
struct Header {
    heading: DatabaseHeading,
    version: u64,
    /// Number of records; [`OPEN_END`] in a journal.
    records: u64,
    /// Number of records with a trajectory; 0 where it is not known.
    entries: u64,
    /// Bytes of the header.
    length: u64,
}

/// Why a file is not a usable database.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DatabaseError {
    /// The file is too short or too long.
    #[error("expected {expected} bytes for {what}, got {got}: the file is truncated or was appended to")]
    Length {
        /// The part that the bytes should hold.
        what: String,
        /// Expected number of bytes.
        expected: u64,
        /// Number of bytes in the file.
        got: u64,
    },
    /// A part of the file cannot be read.
    #[error("cannot read {what}: {cause}")]
    Unreadable {
        /// The part.
        what: String,
        /// The error of the operating system.
        cause: std::io::ErrorKind,
    },
    /// The file is of another kind.
    #[error("not an upswing database: it begins with {got:02x?}")]
    Magic {
        /// The first bytes of the file.
        got: Vec<u8>,
    },
    /// The file was written by another version.
    #[error("{what}: this build expects {expected}, the file has {got}; rebuild it with `upswing db build`")]
    Layout {
        /// Name of the number that differs.
        what: &'static str,
        /// The number of this build.
        expected: u64,
        /// The number in the file.
        got: u64,
    },
    /// The file was written before databases had an index.
    #[error(
        "format version: this build expects {VERSION}, the file has {WITHOUT_INDEX}; convert it with `upswing db merge --output NEW FILE`"
    )]
    NoIndex,
    /// The file is the journal of a build.
    #[error("the file is the journal of a build that is not finished: run its `upswing db build` again")]
    Journal,
    /// A checksum does not match.
    #[error("{what} is damaged: checksum {expected:016x} is recorded, the bytes give {got:016x}")]
    Checksum {
        /// The header, or a record by its number.
        what: String,
        /// The checksum in the file.
        expected: u64,
        /// The checksum of the bytes.
        got: u64,
    },
    /// A number is outside the range that the format allows.
    #[error("{what}: expected {expected}, got {got}")]
    Value {
        /// Name of the number.
        what: String,
        /// The range that is allowed.
        expected: String,
        /// The number in the file.
        got: String,
    },
    /// The database was made for a robot with other joints.
    #[error(
        "the database was made for another robot: its joints are {}, those of the settings are {}; rebuild it with `upswing db build`",
        .got.join(", "), .expected.join(", ")
    )]
    Joints {
        /// Names of the joints of the model, [A, U].
        expected: Vec<String>,
        /// Names of the joints in the file, [A, U].
        got: Vec<String>,
    },
    /// The database was made for a robot with other motors.
    #[error(
        "the database was made for another robot: {got} of its joints have a motor, of those of the settings {expected}; rebuild it with \
         `upswing db build`"
    )]
    Motors {
        /// n_A of the model.
        expected: usize,
        /// n_A in the file.
        got: usize,
    },
    /// The database was made for another robot or other settings.
    #[error(
        "the database was made for another {what}: its fingerprint is {got:016x}, the settings give \
         {expected:016x}; rebuild it with `upswing db build`"
    )]
    Fingerprint {
        /// The robot model, or the limits and weights.
        what: &'static str,
        /// The fingerprint of the settings.
        expected: u64,
        /// The fingerprint in the file.
        got: u64,
    },
    /// The database has no entries.
    #[error("the database is empty; build one with `upswing db build`")]
    Empty,
    /// The file holds only a part of a database.
    #[error("the file is shard {shard} of {shards}; join all of them with `upswing db merge`")]
    Shard {
        /// Number of the shard, from 1.
        shard: u64,
        /// Number of shards.
        shards: u64,
    },
}

impl Entry {
    /// The entry of a trajectory that a solver found. The states of the actuated joints are replaced by those that follow
    /// from x_0 and u by (6b), as when the file is read; they differ by the tolerance of the solver. The key is the start pose.
    pub fn new(trajectory: &Trajectory, certify: impl FnOnce(&Trajectory) -> Certificate) -> Self {
        let trajectory = integrate_arm(trajectory.clone());
        let certificate = certify(&trajectory);
        Self { key: trajectory.start().q_a().to_vec(), trajectory, certificate }
    }
}

/// Computes q_A and qd_A of all knots after the first from u by (6b).
fn integrate_arm(mut t: Trajectory) -> Trajectory {
    let half_h = 0.5 * t.h();
    for k in 0..t.intervals() {
        let (q_a, qd_a) = (t.x[k].q_a(), t.x[k].qd_a());
        let next_qd_a = qd_a + (t.u[k] + t.u[k + 1]) * half_h;
        t.x[k + 1].q_a_mut().copy_from_slice(&(q_a + (qd_a + next_qd_a) * half_h));
        t.x[k + 1].qd_a_mut().copy_from_slice(&next_qd_a);
    }
    t
}

impl DatabaseHeading {
    /// Names of the joints of a model in the order of its vectors, [A, U].
    pub fn joints_of(model: &Model) -> Vec<String> {
        (0..model.sizes().joints()).map(|c| model.joint_name(c).to_owned()).collect()
    }

    /// Checks that the database was made for the model, and for the problem with this fingerprint.
    ///
    /// # Errors
    /// [`DatabaseError::Joints`], [`DatabaseError::Motors`] or [`DatabaseError::Fingerprint`] with what both have.
    pub fn check_origin(&self, model: &Model, problem: u64) -> Result<(), DatabaseError> {
        let expected = Self::joints_of(model);
        if expected != self.joints {
            return Err(DatabaseError::Joints { expected, got: self.joints.clone() });
        }
        let (expected, got) = (model.sizes().actuated(), self.sizes.actuated());
        if expected != got {
            return Err(DatabaseError::Motors { expected, got });
        }
        let pairs = [
            ("robot model", model.fingerprint(), self.model),
            ("set of limits and weights", problem, self.problem),
        ];
        match pairs.into_iter().find(|(_, expected, got)| expected != got) {
            Some((what, expected, got)) => Err(DatabaseError::Fingerprint { what, expected, got }),
            None => Ok(()),
        }
    }

    /// The bytes of the header of a file with these numbers of records, and of entries among them.
    pub fn encode(&self, records: u64, entries: u64) -> Vec<u8> {
        let names: usize = self.joints.iter().map(|name| 1 + name.len().div_ceil(8)).sum();
        let mut bytes = MAGIC.to_vec();
        let words = [
            VERSION,
            8 * (FIXED_WORDS + names as u64 + 1),
            self.sizes.joints() as u64,
            self.sizes.actuated() as u64,
            self.intervals as u64,
            self.key as u64,
            self.model,
            self.problem,
            self.grid,
            self.poses,
            self.shard,
            self.shards,
            records,
            entries,
        ];
        words.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        for name in &self.joints {
            bytes.extend_from_slice(&(name.len() as u64).to_le_bytes());
            bytes.extend_from_slice(name.as_bytes());
            bytes.resize(bytes.len().next_multiple_of(8), 0);
        }
        seal(&mut bytes);
        bytes
    }

    /// The bytes with which a journal begins.
    pub fn journal(&self) -> Vec<u8> {
        self.encode(OPEN_END, 0)
    }
    /// Bytes of a record with a trajectory: key, certificate, t_F, x_0, knots.
    fn long_record(&self) -> usize {
        let knot = self.sizes.actuated() + 2 * self.sizes.unactuated();
        SHORT_RECORD + 8 * (self.key + 6 + 1 + self.sizes.state() + (self.intervals + 1) * knot)
    }
}

impl Header {
    /// Reads the header at the beginning of a file.
    fn read(source: &DatabaseSource) -> Result<Self, DatabaseError> {
        let size = source.length()?;
        if size == 0 {
            return Err(DatabaseError::Empty);
        }
        let what = || "the header".to_owned();
        let truncated = |expected| DatabaseError::Length { what: what(), expected, got: size };
        let mut start = [0; 24];
        let start = &mut start[..size.min(24) as usize];
        source.read(0, start, what)?;
        if !start.starts_with(MAGIC) {
            return Err(DatabaseError::Magic { got: start.iter().take(MAGIC.len()).copied().collect() });
        }
        // The version first: only then the length means something.
        let version = if start.len() >= 16 { word(start, 1) } else { VERSION };
        let fixed = match version {
            VERSION => FIXED_WORDS,
            WITHOUT_INDEX => FIXED_WORDS - 1,
            got => return Err(DatabaseError::Layout { what: "format version", expected: VERSION, got }),
        };
        let least = 8 * (fixed + 1);
        if size < least {
            return Err(truncated(least));
        }
        let value = |what: &str, expected: String, got: u64| DatabaseError::Value {
            what: what.into(),
            expected,
            got: got.to_string(),
        };
        let length = word(start, 2);
        if !(least..=LARGEST_HEADER).contains(&length) || !length.is_multiple_of(8) {
            let expected = format!("{least} to {LARGEST_HEADER}, whole words");
            return Err(value("length of the header", expected, length));
        }
        if size < length {
            return Err(truncated(length));
        }
        let mut header = vec![0; length as usize];
        source.read(0, &mut header, what)?;
        check(&header, what)?;

        let [joints, actuated, intervals, key] = std::array::from_fn(|i| word(&header, 3 + i));
        let small = |v: u64| usize::try_from(v).unwrap_or(usize::MAX);
        let sizes = Sizes::new(small(joints), small(actuated)).ok_or_else(|| {
            let expected = format!("fewer than the {joints} joints, which are at most {MOST_JOINTS}");
            value("number of motors", expected, actuated)
        })?;
        if !INTERVALS.contains(&small(intervals)) {
            let expected = format!("{} to {}", INTERVALS.start(), INTERVALS.end());
            return Err(value("number of intervals", expected, intervals));
        }
        let keys = sizes.actuated()..=sizes.actuated() + sizes.state();
        if !keys.contains(&small(key)) {
            let expected = format!("{} to {}", keys.start(), keys.end());
            return Err(value("length of the keys", expected, key));
        }
        let [model, problem, grid, poses, shard, shards, records] =
            std::array::from_fn(|i| word(&header, 7 + i));
        if shard == 0 || shard > shards {
            return Err(value("shard", format!("1 to {shards}"), shard));
        }
        let entries = if version == VERSION { word(&header, 14) } else { 0 };
        if entries > records.min(u64::from(u32::MAX)) {
            return Err(value("number of entries", format!("at most the {records} records"), entries));
        }
        let joints = decode_names(&header[8 * fixed as usize..length as usize - 8], sizes.joints())?;
        let (intervals, key) = (small(intervals), small(key));
        let heading =
            DatabaseHeading { sizes, joints, intervals, key, model, problem, grid, poses, shard, shards };
        Ok(Self { heading, version, records, entries, length })
    }
}

/// The `count` names of joints that fill `bytes`, which are whole words.
fn decode_names(mut bytes: &[u8], count: usize) -> Result<Vec<String>, DatabaseError> {
    let refuse = |got: String| DatabaseError::Value {
        what: "names of the joints".into(),
        expected: format!("{count} names in UTF-8"),
        got,
    };
    let mut names = Vec::with_capacity(count);
    for i in 0..count {
        let missing = || refuse(format!("{i} names"));
        let (length, rest) = bytes.split_first_chunk().ok_or_else(missing)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let name = rest.get(..length).ok_or_else(missing)?;
        let name = std::str::from_utf8(name).map_err(|e| refuse(format!("name {}: {e}", i + 1)))?;
        names.push(name.to_owned());
        // In range: `rest` is whole words and has at least `length` bytes.
        bytes = &rest[length.next_multiple_of(8)..];
    }
    if bytes.is_empty() { Ok(names) } else { Err(refuse(format!("{} bytes more", bytes.len()))) }
}

impl PoseRecord {
    /// The entry, if the optimisation found a trajectory.
    pub fn entry(&self) -> Option<&Entry> {
        match &self.outcome {
            PoseOutcome::Solved(entry) => Some(entry),
            _ => None,
        }
    }

    /// The bytes of the record.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = self.pose.to_le_bytes().to_vec();
        let outcome: u64 = match &self.outcome {
            PoseOutcome::Rejected => 0,
            PoseOutcome::Failed => 1,
            PoseOutcome::Solved(_) => 2,
        };
        bytes.extend_from_slice(&outcome.to_le_bytes());
        if let PoseOutcome::Solved(entry) = &self.outcome {
            let mut put = |v: f64| bytes.extend_from_slice(&v.to_le_bytes());
            entry.key.iter().for_each(|v| put(*v));
            entry.certificate.to_array().into_iter().for_each(&mut put);
            let t = &entry.trajectory;
            put(t.t_f);
            t.start().iter().for_each(|v| put(*v));
            for (x, u) in t.knots() {
                u.iter().for_each(|v| put(*v));
                for (q, qd) in x.q_u().iter().zip(x.qd_u().iter()) {
                    put(*q);
                    put(*qd);
                }
            }
        }
        seal(&mut bytes);
        bytes
    }

    /// The record at the beginning of `bytes`, and its length in bytes.
    fn decode(bytes: &[u8], number: u64, heading: &DatabaseHeading) -> Result<(Self, usize), DatabaseError> {
        let what = || format!("record {number}");
        let truncated = |expected: usize| DatabaseError::Length {
            what: what(),
            expected: expected as u64,
            got: bytes.len() as u64,
        };
        if bytes.len() < SHORT_RECORD {
            return Err(truncated(SHORT_RECORD));
        }
        let (pose, kind) = (word(bytes, 0), word(bytes, 1));
        let length = match kind {
            0 | 1 => SHORT_RECORD,
            2 => heading.long_record(),
            got => {
                let expected = "an outcome from 0 to 2".into();
                return Err(DatabaseError::Value { what: what(), expected, got: got.to_string() });
            }
        };
        let record = bytes.get(..length).ok_or_else(|| truncated(length))?;
        check(record, what)?;
        let outcome = match kind {
            0 => PoseOutcome::Rejected,
            1 => PoseOutcome::Failed,
            _ => PoseOutcome::Solved(Box::new(decode_entry(&record[16..], heading, what)?)),
        };
        Ok((Self { pose, outcome }, length))
    }
}

/// The entry in the bytes of a record after its outcome. The figures of its certificate may be any numbers.
fn decode_entry(
    bytes: &[u8],
    heading: &DatabaseHeading,
    what: impl Fn() -> String,
) -> Result<Entry, DatabaseError> {
    let mut values = bytes.chunks_exact(8).map(|c| f64::from_le_bytes(std::array::from_fn(|b| c[b])));
    let mut next = || values.next().unwrap_or(f64::NAN);
    let (sizes, knots) = (heading.sizes, heading.intervals + 1);
    let key: Vec<f64> = (0..heading.key).map(|_| next()).collect();
    let certificate = Certificate::from_array(std::array::from_fn(|_| next()));
    let t_f = next();
    let mut x = vec![State::zeros(sizes); knots];
    let mut u = Vec::with_capacity(knots);
    x[0] = State::from_fn(sizes, |_| next());
    for x in &mut x {
        u.push(ActuatedVector::from_fn(sizes, |_| next()));
        for i in 0..sizes.unactuated() {
            x.q_u_mut()[i] = next();
            x.qd_u_mut()[i] = next();
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
    let numbers = trajectory.knots().flat_map(|(x, u)| x.iter().chain(u.iter()));
    if let Some(got) = numbers.copied().find(|v| !v.is_finite()) {
        return refuse("the trajectory", "finite numbers".into(), got);
    }
    let start = trajectory.start().q_a();
    if let Some(i) = (0..start.len()).find(|i| key[*i] != start[*i]) {
        return refuse("the key", format!("the start pose, {}", start[i]), key[i]);
    }
    if let Some(got) = key.iter().copied().find(|v| !v.is_finite()) {
        return refuse("the key", "finite numbers".into(), got);
    }
    Ok(Entry { key, trajectory, certificate })
}

impl DatabaseContents {
    /// The bytes of the file.
    pub fn encode(&self) -> Vec<u8> {
        let mut index = Index::default();
        let (entries, others): (Vec<_>, Vec<_>) = self.records.iter().partition(|r| r.entry().is_some());
        let mut bytes = self.heading.encode(self.records.len() as u64, entries.len() as u64);
        for record in entries.into_iter().chain(others) {
            let encoded = record.encode();
            index.push(record, &encoded);
            bytes.extend(encoded);
        }
        bytes.extend(index.encode(&self.heading));
        bytes
    }

    /// The contents of a database.
    ///
    /// # Errors
    /// [`DatabaseError`] if a record is damaged.
    pub fn of(database: &Database) -> Result<Self, DatabaseError> {
        let mut records: Vec<PoseRecord> = database.records().collect::<Result<_, _>>()?;
        records.sort_by_key(|record| record.pose);
        Ok(Self { heading: database.heading().clone(), records })
    }

    /// The contents of the file with these bytes.
    ///
    /// # Errors
    /// [`DatabaseError`] if a part of the file is damaged or of another version.
    pub fn decode(bytes: Vec<u8>) -> Result<Self, DatabaseError> {
        Self::of(&Database::load(DatabaseSource::Memory(bytes.into()))?)
    }

    /// The entries, in the order of the grid.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.records.iter().filter_map(PoseRecord::entry)
    }
}

/// Word number `i` of the bytes.
fn word(bytes: &[u8], i: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|b| bytes[i * 8 + b]))
}

/// Appends the checksum of the bytes to them.
fn seal(bytes: &mut Vec<u8>) {
    let checksum = xxh3_64(bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

/// Checks the checksum at the end of `bytes`; `what` names the part for the error.
fn check(bytes: &[u8], what: impl Fn() -> String) -> Result<(), DatabaseError> {
    let content = &bytes[..bytes.len() - 8];
    let (expected, got) = (word(bytes, bytes.len() / 8 - 1), xxh3_64(content));
    if expected == got { Ok(()) } else { Err(DatabaseError::Checksum { what: what(), expected, got }) }
}
