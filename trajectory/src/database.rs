//! The file format of the trajectory database.
//!
//! A file consists of little-endian words of 8 bytes. The header holds: magic, format version, dimensions, fingerprints,
//! number of poses in the grid, shard, number of records, checksum. One record per pose of the grid follows, in the order
//! of the grid: number of the pose, outcome and, if a trajectory was found, its certificate, t_F, x_0, and
//! (u_k, q_U,k, qd_U,k) at each knot. The states of the actuated joints follow from u by (6b), which is exact for double
//! integrators. Each record ends with its checksum (XXH3, 64 bit).
//!
//! During a build, records are appended to a journal: the same file without the number of records.

use crate::{Certificate, KNOTS, N, Trajectory};
use upswing_model::{ActuatedVector, N_UNACTUATED, NU, NX, State, StateParts};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 8] = b"upswing\0";
const VERSION: u64 = 2;
/// Words of the header, including its checksum.
const HEADER_WORDS: usize = 13;
const HEADER: usize = 8 * HEADER_WORDS;
/// Number of records in the header of a journal, which is not known yet.
const OPEN_END: u64 = u64::MAX;
/// Bytes of a record without trajectory: pose, outcome, checksum.
const SHORT_RECORD: usize = 3 * 8;
/// Words of a trajectory: certificate, t_F, x_0, knots.
const ENTRY_WORDS: usize = 6 + 1 + NX + KNOTS * (NU + 2 * N_UNACTUATED);
/// Bytes of a record with a trajectory.
const LONG_RECORD: usize = SHORT_RECORD + 8 * ENTRY_WORDS;

/// The optimal trajectory from one start state.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DatabaseHeading {
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

/// Optimal trajectories of one robot under one set of limits and weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Database {
    /// The robot, settings and grid of the database.
    pub heading: DatabaseHeading,
    /// One record per pose, in the order of the grid.
    pub records: Vec<PoseRecord>,
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
        expected: usize,
        /// Number of bytes in the file.
        got: usize,
    },
    /// The file is of another kind.
    #[error("not an upswing database: it begins with {got:02x?}")]
    Magic {
        /// The first bytes of the file.
        got: Vec<u8>,
    },
    /// The file was written by another version, or for other dimensions.
    #[error("{what}: this build expects {expected}, the file has {got}; rebuild it with `upswing db build`")]
    Layout {
        /// Name of the number that differs.
        what: &'static str,
        /// The number of this build.
        expected: u64,
        /// The number in the file.
        got: u64,
    },
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
    /// from x_0 and u by (6b), as when the file is read; they differ by the tolerance of the solver.
    pub fn new(trajectory: &Trajectory, certify: impl FnOnce(&Trajectory) -> Certificate) -> Self {
        let trajectory = integrate_arm(trajectory.clone());
        let certificate = certify(&trajectory);
        Self { trajectory, certificate }
    }
}

/// Computes q_A and qd_A of all knots after the first from u by (6b).
fn integrate_arm(mut t: Trajectory) -> Trajectory {
    let half_h = 0.5 * t.h();
    for k in 0..N {
        let (q_a, qd_a) = (t.x[k].q_a(), t.x[k].qd_a());
        let next_qd_a = qd_a + (t.u[k] + t.u[k + 1]) * half_h;
        t.x[k + 1].q_a_mut().copy_from(&(q_a + (qd_a + next_qd_a) * half_h));
        t.x[k + 1].qd_a_mut().copy_from(&next_qd_a);
    }
    t
}

impl DatabaseHeading {
    /// Checks that the database was made for the model and the problem with these fingerprints.
    ///
    /// # Errors
    /// [`DatabaseError::Fingerprint`] with both fingerprints.
    pub fn check_origin(&self, model: u64, problem: u64) -> Result<(), DatabaseError> {
        let pairs =
            [("robot model", model, self.model), ("set of limits and weights", problem, self.problem)];
        match pairs.into_iter().find(|(_, expected, got)| expected != got) {
            Some((what, expected, got)) => Err(DatabaseError::Fingerprint { what, expected, got }),
            None => Ok(()),
        }
    }

    /// The bytes of the header of a file with this number of records.
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

impl PoseRecord {
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
            entry.certificate.to_array().into_iter().for_each(&mut put);
            let t = &entry.trajectory;
            put(t.t_f);
            t.x[0].iter().for_each(|v| put(*v));
            for (x, u) in t.knots() {
                u.iter().for_each(|v| put(*v));
                for (q, qd) in x.q_u().iter().zip(&x.qd_u()) {
                    put(*q);
                    put(*qd);
                }
            }
        }
        seal(&mut bytes);
        bytes
    }

    /// The record at the beginning of `bytes`, and its length in bytes.
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
            0 => PoseOutcome::Rejected,
            1 => PoseOutcome::Failed,
            _ => PoseOutcome::Solved(Box::new(decode_entry(&record[16..], what)?)),
        };
        Ok((Self { pose, outcome }, length))
    }
}

/// The entry in the bytes of a record after its outcome. The figures of its certificate may be any numbers.
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
            x[k].q_u_mut()[i] = next();
            x[k].qd_u_mut()[i] = next();
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

    /// The database in the bytes of a file.
    ///
    /// # Errors
    /// [`DatabaseError`] if a part of the file is damaged or of another version.
    pub fn decode(bytes: &[u8]) -> Result<Self, DatabaseError> {
        let (heading, count) = DatabaseHeading::decode(bytes)?;
        let mut records = Vec::new();
        let mut at = HEADER;
        // A journal has no number of records; its last record must be complete, too.
        while if count == OPEN_END { at < bytes.len() } else { (records.len() as u64) < count } {
            let (record, length) = PoseRecord::decode(&bytes[at..], records.len())?;
            at += length;
            records.push(record);
        }
        if at != bytes.len() {
            let what = format!("{count} records");
            return Err(DatabaseError::Length { what, expected: at, got: bytes.len() });
        }
        Ok(Self { heading, records })
    }

    /// The complete records of a journal, whose end a killed process may have left incomplete, and their length in bytes,
    /// including the header.
    ///
    /// # Errors
    /// [`DatabaseError`] if the header is damaged.
    pub fn recover(bytes: &[u8]) -> Result<(Self, usize), DatabaseError> {
        let (heading, _) = DatabaseHeading::decode(bytes)?;
        let mut records = Vec::new();
        let mut at = HEADER;
        while let Ok((record, length)) = PoseRecord::decode(&bytes[at..], records.len()) {
            at += length;
            records.push(record);
        }
        Ok((Self { heading, records }, at))
    }

    /// The solved entries, in the order of the grid.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.records.iter().filter_map(|r| match &r.outcome {
            PoseOutcome::Solved(entry) => Some(&**entry),
            _ => None,
        })
    }

    /// The entries of a database that was made for the model and the problem with these fingerprints.
    ///
    /// # Errors
    /// [`DatabaseError::Fingerprint`] with both fingerprints, [`DatabaseError::Shard`] or [`DatabaseError::Empty`].
    pub fn entries_for(self, model: u64, problem: u64) -> Result<Vec<Entry>, DatabaseError> {
        let h = &self.heading;
        h.check_origin(model, problem)?;
        if h.shards > 1 {
            return Err(DatabaseError::Shard { shard: h.shard, shards: h.shards });
        }
        let entries: Vec<Entry> = self
            .records
            .into_iter()
            .filter_map(|r| match r.outcome {
                PoseOutcome::Solved(entry) => Some(*entry),
                _ => None,
            })
            .collect();
        if entries.is_empty() { Err(DatabaseError::Empty) } else { Ok(entries) }
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
