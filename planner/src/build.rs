//! Builds trajectory databases: on all cores, resumable, in shards.
//!
//! The poses of a grid form lines along its last axis. A line is solved from one end to the other, each pose from the
//! usual guesses and from the solution before it; the cheapest solution is kept. Lines do not depend on each other,
//! so that neither the number of cores, nor an interruption, nor shards change a bit of the result.
//!
//! Every finished line is appended to a journal beside the output; a build that finds one goes on where it ends.

use crate::interior_point::{Options, Status};
use crate::offline::{Search, optimize, options, problem, problem_fingerprint};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, GridSettings};
use upswing_model::{N_ACTUATED, N_UNACTUATED, State};
use upswing_process::output::{Output, OutputError};
use upswing_trajectory::{
    Certificate, Database, DatabaseError, Entry, Heading, Margins, N, Outcome, Record, Trajectory,
};
use xxhash_rust::xxh3::Xxh3;

/// A part of the lines of a grid: those whose number, counted from 0, is `number - 1` modulo `of`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    pub number: u64,
    /// How many there are.
    pub of: u64,
}

impl Shard {
    /// Everything.
    pub const WHOLE: Self = Self { number: 1, of: 1 };
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

/// Why a build, merge or verification could not be done.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// A file cannot be read or written.
    #[error("cannot {action} {}: {cause}", path.display())]
    File {
        /// read, write, ...
        action: &'static str,
        /// Which.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// The result cannot be written, or may not replace what is there.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file is no database, or a damaged one.
    #[error("{}: {cause}", path.display())]
    Database {
        /// Which.
        path: PathBuf,
        /// Why.
        cause: DatabaseError,
    },
    /// A file belongs to something else.
    #[error("{}: {what} is {got:016x}, expected {expected:016x}; remove the file or use the settings it was made with", path.display())]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// Which fingerprint or number.
        what: &'static str,
        /// What it should be.
        expected: u64,
        /// What it is.
        got: u64,
    },
    /// Shards are missing.
    #[error("shards missing: {} of {of}", .missing.iter().map(u64::to_string).collect::<Vec<_>>().join(", "))]
    Missing {
        /// Their numbers.
        missing: Vec<u64>,
        /// How many there should be.
        of: u64,
    },
    /// All shards are there, but not all poses: one of them is not finished.
    #[error(
        "expected {poses} poses in the shards together, got {got}; finish the shards with `upswing db build`"
    )]
    Incomplete {
        /// How many the grid has.
        poses: u64,
        /// How many there are.
        got: u64,
    },
    /// The same pose with different contents.
    #[error("pose {pose} differs between {} and {}", first.display(), second.display())]
    Disagree {
        /// The pose.
        pose: u64,
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// Another process builds the same file.
    #[error("{} is being written by another build; wait for it or choose another output", .0.display())]
    Busy(PathBuf),
    /// A merge of nothing.
    #[error("no shards given")]
    Nothing,
}

/// Identifies a grid.
fn grid_fingerprint(grid: &GridSettings) -> u64 {
    let mut hash = Xxh3::new();
    for number in 0..grid.poses() {
        grid.pose(number).iter().for_each(|q| hash.update(&q.to_le_bytes()));
    }
    hash.update(&grid.max_rest_angle.to_le_bytes());
    hash.update(format!("{:?}", grid.start).as_bytes());
    hash.digest()
}

/// What a database of the settings' grid has in its header.
pub fn heading(config: &Config, shard: Shard) -> Heading {
    Heading {
        model: config.model.fingerprint(),
        problem: problem_fingerprint(config),
        grid: grid_fingerprint(&config.grid),
        poses: config.grid.poses() as u64,
        shard: shard.number,
        shards: shard.of,
    }
}

/// How a build ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Poses of this shard.
    pub poses: usize,
    /// Poses found in the journal or in the finished file.
    pub resumed: usize,
    /// Trajectories.
    pub solved: usize,
    /// Poses left out by the rules of the grid.
    pub rejected: usize,
    /// Numbers of the poses without a solution.
    pub failed: Vec<u64>,
    /// Poses left when the build was stopped; then there is a journal and no file.
    pub left: usize,
}

/// Poses of one line, in order.
type Line = Vec<usize>;

fn lines(grid: &GridSettings, shard: Shard) -> Vec<Line> {
    let length = grid.axes.last().map_or(1, |axis| axis.points);
    (0..grid.poses() / length)
        .filter(|line| *line as u64 % shard.of == shard.number - 1)
        .map(|line| (line * length..(line + 1) * length).collect())
        .collect()
}

/// The journal of an output file.
fn journal_path(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".journal");
    path.into()
}

/// Builds the database (or one shard of it) of the settings' grid into `output`. `progress` is told how many poses
/// are done; raising `stop` ends the build, the journal keeps what is finished. A finished file of the same build is left as it is.
///
/// # Errors
/// [`BuildError`] if a file cannot be used or belongs to other settings; nothing finished is lost.
pub fn build(
    config: &Config,
    shard: Shard,
    output: &Output,
    stop: &AtomicBool,
    progress: impl Fn(usize) + Sync,
) -> Result<Summary, BuildError> {
    let heading = heading(config, shard);
    let lines = lines(&config.grid, shard);
    let poses = lines.iter().map(Vec::len).sum();
    if let Some(finished) = finished(output.path(), &heading)? {
        progress(poses);
        return Ok(summary(&finished, poses, poses));
    }
    output.check()?;
    let path = journal_path(output.path());
    let (mut file, mut records) = open_journal(&path, &heading)?;
    // Journals joined by hand may hold a pose twice.
    records.sort_by_key(|r| r.pose);
    records.dedup_by_key(|r| r.pose);
    let done: HashSet<u64> = records.iter().map(|r| r.pose).collect();
    // A line is journaled at once: one that is there in part belongs to a process that was killed while writing.
    let whole = |line: &Line| line.iter().all(|pose| done.contains(&(*pose as u64)));
    let kept: HashSet<u64> = lines.iter().filter(|line| whole(line)).flatten().map(|p| *p as u64).collect();
    records.retain(|r| kept.contains(&r.pose));
    let resumed = records.len();
    progress(resumed);
    let results: Mutex<Result<Vec<Record>, BuildError>> = Mutex::new(Ok(records));
    let journal = Mutex::new(&mut file);
    lines.par_iter().filter(|line| !whole(line)).for_each(|line| {
        // Another line may have failed to be written.
        let halted = || stop.load(Ordering::Acquire) || results.lock().map_or(true, |r| r.is_err());
        let Some(solved) = solve_line(config, line, &halted, stop) else { return };
        let bytes: Vec<u8> = solved.iter().flat_map(Record::encode).collect();
        let written = journal.lock().map(|mut file| file.write_all(&bytes));
        if let Ok(mut results) = results.lock() {
            match (written, &mut *results) {
                (Ok(Ok(())), Ok(records)) => {
                    records.extend(solved);
                    progress(line.len());
                }
                (Ok(Err(cause)), Ok(_)) => {
                    *results = Err(BuildError::File { action: "write", path: path.clone(), cause });
                }
                _ => {}
            }
        }
    });
    // A poisoned lock means a panic, which has been passed on already.
    let mut records = results.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())?;
    records.sort_by_key(|r| r.pose);
    let database = Database { heading, records };
    let summary = summary(&database, poses, resumed);
    if summary.left == 0 {
        output.write(&database.encode())?;
        remove(&path)?;
    }
    Ok(summary)
}

/// The state from which a pose starts, unless the grid's rules leave it out.
fn start_of(config: &Config, pose: usize) -> Option<State> {
    let grid = &config.grid;
    let start = config.start_state(&grid.pose(pose), grid.start).ok();
    start.filter(|x| x.rows(N_ACTUATED, N_UNACTUATED).amax() <= grid.max_rest_angle)
}

/// Solves a line; `None` if it was halted.
fn solve_line(
    config: &Config,
    line: &Line,
    halted: &impl Fn() -> bool,
    stop: &AtomicBool,
) -> Option<Vec<Record>> {
    let stopped = || stop.load(Ordering::Acquire);
    let options = Options { cancelled: Some(&stopped), ..options(config) };
    let mut neighbour: Option<Trajectory> = None;
    let mut records = Vec::with_capacity(line.len());
    for pose in line {
        if halted() {
            return None;
        }
        let outcome = match start_of(config, *pose) {
            None => Outcome::Rejected,
            Some(start) => {
                let solution = optimize(config, start, Search::Best, neighbour.as_ref(), &options);
                // The best of some guesses need not be the best of all.
                if stopped() {
                    return None;
                }
                match solution.status {
                    Status::Solved => {
                        let entry = Entry::new(&solution.trajectory, |t| certify(config, t));
                        neighbour = Some(entry.trajectory.clone());
                        Outcome::Solved(Box::new(entry))
                    }
                    _ => Outcome::Failed,
                }
            }
        };
        records.push(Record { pose: *pose as u64, outcome });
    }
    Some(records)
}

/// The certificate of a trajectory under the settings' limits and weights.
pub fn certify(config: &Config, trajectory: &Trajectory) -> Certificate {
    let input_weight = config.planner.offline.input_weight;
    Certificate::of(trajectory, &config.model, &config.robot.planning, input_weight)
}

fn summary(database: &Database, poses: usize, resumed: usize) -> Summary {
    let mut s = Summary {
        poses,
        resumed,
        solved: 0,
        rejected: 0,
        failed: Vec::new(),
        left: poses.saturating_sub(database.records.len()),
    };
    for record in &database.records {
        match record.outcome {
            Outcome::Solved(_) => s.solved += 1,
            Outcome::Rejected => s.rejected += 1,
            Outcome::Failed => s.failed.push(record.pose),
        }
    }
    s
}

/// The finished file of exactly this build, if it is there. One of other settings is replaced in the end.
fn finished(output: &Path, heading: &Heading) -> Result<Option<Database>, BuildError> {
    match upswing_config::read_file(output) {
        Ok(bytes) => Ok(Database::decode(&bytes).ok().filter(|d| d.heading == *heading)),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(cause) => Err(BuildError::File { action: "read", path: output.to_owned(), cause }),
    }
}

/// Opens the journal for appending, with what is whole in it.
fn open_journal(path: &Path, heading: &Heading) -> Result<(File, Vec<Record>), BuildError> {
    let failed = |action| move |cause| BuildError::File { action, path: path.to_owned(), cause };
    let open = || {
        upswing_config::check_regular(path).map_err(failed("write"))?;
        let file = OpenOptions::new().create(true).append(true).open(path).map_err(failed("write"))?;
        // Held until the build ends; the kernel releases it if the process dies.
        match file.try_lock() {
            Ok(()) => Ok(file),
            Err(TryLockError::WouldBlock) => Err(BuildError::Busy(path.to_owned())),
            Err(TryLockError::Error(cause)) => Err(failed("lock")(cause)),
        }
    };
    let begin = |mut file: File| {
        file.write_all(&heading.journal()).map_err(failed("write"))?;
        Ok((file, Vec::new()))
    };
    let file = open()?;
    let bytes = upswing_config::read_file(path).map_err(failed("read"))?;
    if bytes.is_empty() {
        return begin(file);
    }
    // A journal killed within its header holds nothing.
    let Ok((journal, whole)) = Database::recover(&bytes) else {
        if bytes.len() >= heading.journal().len() {
            let cause = Database::recover(&bytes).err().unwrap_or(DatabaseError::Empty);
            return Err(BuildError::Database { path: path.to_owned(), cause });
        }
        file.set_len(0).map_err(failed("write"))?;
        return begin(file);
    };
    same_origin(path, &journal.heading, heading)?;
    for (what, expected, got) in
        [("shard", heading.shard, journal.heading.shard), ("shards", heading.shards, journal.heading.shards)]
    {
        if expected != got {
            return Err(BuildError::Foreign { path: path.to_owned(), what, expected, got });
        }
    }
    file.set_len(whole as u64).map_err(failed("write"))?;
    Ok((file, journal.records))
}

/// Refuses a file that was made for another robot, other settings or another grid.
fn same_origin(path: &Path, got: &Heading, expected: &Heading) -> Result<(), BuildError> {
    for (what, expected, got) in [
        ("fingerprint of the robot model", expected.model, got.model),
        ("fingerprint of limits and weights", expected.problem, got.problem),
        ("fingerprint of the grid", expected.grid, got.grid),
    ] {
        if expected != got {
            return Err(BuildError::Foreign { path: path.to_owned(), what, expected, got });
        }
    }
    Ok(())
}

/// Joins the shards of one build into `output`; the order of the files does not matter, and the result has the bytes
/// of a build in one piece. Says what it holds.
///
/// # Errors
/// [`BuildError`] for missing shards, files of different builds, and poses that differ between files.
pub fn merge(inputs: &[PathBuf], output: &Output) -> Result<Summary, BuildError> {
    // What is there may be the result of this merge.
    if let Err(e @ OutputError::Io { .. }) = output.check() {
        return Err(e.into());
    }
    let mut records: BTreeMap<u64, (Record, PathBuf)> = BTreeMap::new();
    let mut first: Option<Heading> = None;
    let mut present = BTreeSet::new();
    for path in inputs {
        let database = read(path)?;
        let expected = *first.get_or_insert(database.heading);
        same_origin(path, &database.heading, &expected)?;
        if expected.shards != database.heading.shards {
            let (expected, got) = (expected.shards, database.heading.shards);
            return Err(BuildError::Foreign { path: path.clone(), what: "number of shards", expected, got });
        }
        present.insert(database.heading.shard);
        for record in database.records {
            match records.get(&record.pose) {
                // Compared as bytes: NaN would differ from itself.
                Some((known, file)) if known.encode() != record.encode() => {
                    let (first, second) = (file.clone(), path.clone());
                    return Err(BuildError::Disagree { pose: record.pose, first, second });
                }
                Some(_) => {}
                None => {
                    records.insert(record.pose, (record, path.clone()));
                }
            }
        }
    }
    let heading = first.ok_or(BuildError::Nothing)?;
    let missing: Vec<u64> = (1..=heading.shards).filter(|i| !present.contains(i)).collect();
    if !missing.is_empty() {
        return Err(BuildError::Missing { missing, of: heading.shards });
    }
    let (poses, got) = (heading.poses, records.len() as u64);
    if got != poses {
        return Err(BuildError::Incomplete { poses, got });
    }
    let heading = Heading { shard: 1, shards: 1, ..heading };
    let database = Database { heading, records: records.into_values().map(|(r, _)| r).collect() };
    let bytes = database.encode();
    if !upswing_config::read_file(output.path()).is_ok_and(|present| present == bytes) {
        output.write(&bytes)?;
    }
    Ok(summary(&database, database.records.len(), 0))
}

/// Reads a database file.
///
/// # Errors
/// [`BuildError::File`] or [`BuildError::Database`].
pub fn read(path: &Path) -> Result<Database, BuildError> {
    let bytes = upswing_config::read_file(path).map_err(|cause| BuildError::File {
        action: "read",
        path: path.to_owned(),
        cause,
    })?;
    Database::decode(&bytes).map_err(|cause| BuildError::Database { path: path.to_owned(), cause })
}

/// A pose whose record is not what a build of these settings would have written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discrepancy {
    /// Its number.
    pub pose: u64,
    /// What is wrong.
    pub finding: Finding,
}

/// What is wrong with a record.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Finding {
    /// The figures are not those of the trajectory.
    #[error("recorded {recorded:?}, computed {computed:?}")]
    Certificate {
        /// In the file.
        recorded: Certificate,
        /// Computed from the trajectory.
        computed: Certificate,
    },
    /// The grid's rules make something else of the pose: no trajectory where one starts, or the other way round.
    #[error("the grid {} this pose, the file does not", if *leaves_out { "leaves out" } else { "has" })]
    Rule {
        /// Whether the rules leave the pose out.
        leaves_out: bool,
    },
    /// The trajectory starts elsewhere.
    #[error("starts {by:.2e} (rad or rad/s) from the grid's pose, in entry {row} of the state")]
    Start {
        /// Entry of x_0.
        row: usize,
        /// Distance.
        by: f64,
    },
    /// The trajectory does not end in the target (8).
    #[error("misses row {row} of the target (8) by {by:.2e} rad or rad/s")]
    End {
        /// Row of (8).
        row: usize,
        /// By how much.
        by: f64,
    },
    /// The trajectory jumps.
    #[error("defect (6b) of {got:.2e} rad or rad/s, expected at most {most:.0e}")]
    Defect {
        /// Largest one.
        got: f64,
        /// `replan.defect`.
        most: f64,
    },
    /// A limit is exceeded.
    #[error("exceeds a limit of {what} {at} by {by:.4} of half its range, expected at most {most}")]
    Limit {
        /// Position, velocity or torque.
        what: &'static str,
        /// At or between the knots.
        at: &'static str,
        /// Share of half the range.
        by: f64,
        /// The largest that is accepted.
        most: f64,
    },
    /// Followed without feedback, the end is missed by too much.
    #[error(
        "followed without feedback, misses its end by {got:.2} rad or rad/s, expected at most {FARTHEST_END}"
    )]
    EndError {
        /// By how much.
        got: f64,
    },
    /// A pose said to have no trajectory has one.
    #[error("recorded as without solution, but a trajectory of cost {cost:.5} is found")]
    Solvable {
        /// Its cost.
        cost: f64,
    },
}

/// Largest difference of two computations, rad or rad/s or relative: the libraries of two machines differ in the last digits
/// of sines, which an unstable pendulum amplifies.
const ROUNDING: f64 = 1e-6;
/// Largest end error, rad or rad/s. The trapezoidal rule is exact to h^2; the falling rod, which is left to itself for this
/// figure, amplifies that by some hundreds: 0.65 in the shipped database, 1.1 in that of the other arm in `examples/`. A
/// rod that ends hanging misses by pi.
const FARTHEST_END: f64 = 2.0;

/// Whether a database was built from the grid of the settings, so that [`verify`] can compare poses.
pub fn has_grid_of(config: &Config, database: &Database) -> bool {
    database.heading.grid == grid_fingerprint(&config.grid)
}

/// Computes everything again, in parallel, that the records claim: figures, start, target, limits, and that poses without
/// a trajectory have none. Starts are compared where the database [has the settings' grid](has_grid_of). Between knots a
/// limit may be exceeded by `replan.knot_margin`, which a replan leaves free for that.
pub fn verify(config: &Config, database: &Database, progress: impl Fn() + Sync) -> Vec<Discrepancy> {
    let compare_poses = has_grid_of(config, database);
    let judge = |record: &Record| {
        if compare_poses {
            let start = start_of(config, record.pose as usize);
            let leaves_out = start.is_none();
            if leaves_out != matches!(record.outcome, Outcome::Rejected) {
                return Err(Finding::Rule { leaves_out });
            }
            if let Some(start) = start {
                has_start(config, record, &start)?;
            }
        }
        match &record.outcome {
            Outcome::Solved(entry) => {
                let verdict = verify_entry(config, entry);
                progress();
                verdict
            }
            _ => Ok(()),
        }
    };
    let judged = database.records.par_iter().map(|record| (record.pose, judge(record)));
    judged.filter_map(|(pose, verdict)| verdict.err().map(|finding| Discrepancy { pose, finding })).collect()
}

/// Whether a record of a pose that starts in `start` does so, or rightly has no trajectory.
fn has_start(config: &Config, record: &Record, start: &State) -> Result<(), Finding> {
    match &record.outcome {
        Outcome::Solved(entry) => {
            let away = (entry.trajectory.x[0] - start).abs();
            let row = away.imax();
            if away[row] <= ROUNDING { Ok(()) } else { Err(Finding::Start { row, by: away[row] }) }
        }
        _ => {
            let solution = optimize(config, *start, Search::Best, None, &options(config));
            match solution.status {
                Status::Solved => Err(Finding::Solvable { cost: solution.cost }),
                _ => Ok(()),
            }
        }
    }
}

fn verify_entry(config: &Config, entry: &Entry) -> Result<(), Finding> {
    let (trajectory, recorded) = (&entry.trajectory, entry.certificate);
    let computed = certify(config, trajectory);
    if recorded.difference(&computed) > ROUNDING {
        return Err(Finding::Certificate { recorded, computed });
    }
    for (row, target) in problem(config, trajectory.x[0]).target.iter().enumerate() {
        let by = (target.coefficients.dot(&trajectory.x[N]) - target.value).abs();
        // A NaN fails, here and below.
        if !(by <= ROUNDING) {
            return Err(Finding::End { row, by });
        }
    }
    let most = config.planner.replan.defect;
    if !(computed.defect <= most) {
        return Err(Finding::Defect { got: computed.defect, most });
    }
    let knots = Margins::of(trajectory, &config.model, &config.robot.planning, 0);
    let between = config.planner.replan.knot_margin;
    for (what, at_knots, everywhere) in [
        ("position", knots.q.share, computed.margin_q),
        ("velocity", knots.qd.share, computed.margin_qd),
        ("torque", knots.tau.share, computed.margin_tau),
    ] {
        for (at, margin, most) in [("at a knot", at_knots, ROUNDING), ("between knots", everywhere, between)]
        {
            if !(margin >= -most) {
                return Err(Finding::Limit { what, at, by: -margin, most });
            }
        }
    }
    if !(computed.end_error <= FARTHEST_END) {
        return Err(Finding::EndError { got: computed.end_error });
    }
    Ok(())
}

fn remove(path: &Path) -> Result<(), BuildError> {
    std::fs::remove_file(path).map_err(|cause| BuildError::File {
        action: "remove",
        path: path.to_owned(),
        cause,
    })
}
