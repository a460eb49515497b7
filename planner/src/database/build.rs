//! Build of a trajectory database: on all cores, resumable, in shards.
//!
//! The poses of a grid form lines along its last axis. A line is solved from one end to the other, each pose from the
//! initial guesses of [`optimize_entry()`] and from the solution of the pose before it; the cheapest solution is kept. Passes from the other
//! end and back follow ([`improve_line()`]): of several families of solutions the guesses find the best one at some poses only. Lines do not
//! depend on each other, so that neither the number of cores, nor an interruption, nor shards change a bit of the result.
//!
//! Every finished line is appended to a journal beside the output; a build that finds a journal continues after its last line.

use super::assemble::{RecordFile, RecordPlace, summary, write};
use super::{BuildError, BuildSummary, DatabaseFile, Task, certify, heading, poses, same_origin};
use crate::offline::{optimize_entry, options, problem_with_margin};
use crate::replan::key;
use rayon::prelude::*;
use std::collections::HashSet;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, Manoeuvre};
use upswing_model::State;
use upswing_ocp::interior_point::{self, NlpOptions, NlpStatus};
use upswing_ocp::multistart::SAME;
use upswing_ocp::problem::Problem;
use upswing_process::output::OutputFile;
use upswing_process::shard::{Shard, open_journal};
use upswing_trajectory::{
    DatabaseError, DatabaseHeading, DatabaseSource, Entry, PoseOutcome, PoseRecord, RecordScan, Trajectory,
};

/// Numbers of the poses of one line of the grid, in order.
type GridLine = Vec<usize>;

fn lines(manoeuvre: &Manoeuvre, shard: Shard) -> Vec<GridLine> {
    let length = manoeuvre.grid.axes.last().map_or(1, |axis| axis.points);
    (0..poses(manoeuvre) / length)
        .filter(|line| shard.contains(*line as u64))
        .map(|line| (line * length..(line + 1) * length).collect())
        .collect()
}

/// Path of the journal of an output file.
fn journal_path(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".journal");
    path.into()
}

/// Builds the database (or one shard of it) of manoeuvre number `manoeuvre` of the settings into `output`. `progress` gets the number of
/// poses finished since its last call. Raising `stop` stops the build; the journal keeps the finished lines. A finished file of
/// the same build is not changed.
///
/// # Errors
/// [`BuildError`] if a file cannot be used or belongs to other settings; no finished line is lost.
pub fn build(
    config: &Config,
    manoeuvre: usize,
    shard: Shard,
    output: &OutputFile,
    stop: &AtomicBool,
    progress: impl Fn(usize) + Sync,
) -> Result<BuildSummary, BuildError> {
    let heading = heading(config, manoeuvre, shard);
    let lines = lines(&config.manoeuvres[manoeuvre], shard);
    let poses = lines.iter().map(Vec::len).sum();
    if let Some(finished) = finished(output.path(), &heading)? {
        progress(poses);
        return Ok(summary(&finished, poses, poses));
    }
    output.check()?;
    let path = journal_path(output.path());
    let mut journal = Journal::open(&path, &heading)?;
    let records = &mut journal.records;
    // Journals joined by hand may hold a pose twice.
    records.sort_by_key(|r| r.pose);
    records.dedup_by_key(|r| r.pose);
    let done: HashSet<u64> = records.iter().map(|r| r.pose).collect();
    // Each line is journaled in one write: a partial line is left by a process that was killed while writing it.
    let whole = |line: &GridLine| line.iter().all(|pose| done.contains(&(*pose as u64)));
    let kept: HashSet<u64> = lines.iter().filter(|line| whole(line)).flatten().map(|p| *p as u64).collect();
    records.retain(|r| kept.contains(&r.pose));
    let resumed = records.len();
    progress(resumed);
    let journal: Mutex<Result<Journal, BuildError>> = Mutex::new(Ok(journal));
    // One by one, because lines take very different times: a core that is done takes the next one.
    lines.par_iter().with_max_len(1).filter(|line| !whole(line)).for_each(|line| {
        // Stop, too, if the write of another line failed.
        let halted = || stop.load(Ordering::Acquire) || journal.lock().map_or(true, |j| j.is_err());
        let Some(solved) = solve_line(config, manoeuvre, line, &halted, stop) else { return };
        // A poisoned lock means a panic, which rayon propagates.
        let Ok(mut guarded) = journal.lock() else { return };
        let Ok(journal) = &mut *guarded else { return };
        match journal.append(&solved) {
            Ok(()) => progress(line.len()),
            Err(cause) => {
                *guarded = Err(BuildError::File { action: "write", path: path.clone(), cause });
            }
        }
    });
    let Journal { file, mut records, .. } =
        journal.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())?;
    records.sort_by_key(|r| r.pose);
    let summary = summary(&records, poses, resumed);
    if summary.left == 0 {
        write(&heading, &[file], &records, output)?;
        remove(&path)?;
    }
    Ok(summary)
}

/// Solves the poses of a line; `None` if the build was stopped or failed meanwhile.
fn solve_line(
    config: &Config,
    manoeuvre: usize,
    line: &GridLine,
    halted: &impl Fn() -> bool,
    stop: &AtomicBool,
) -> Option<Vec<PoseRecord>> {
    let stopped = || stop.load(Ordering::Acquire);
    let options = NlpOptions { cancelled: Some(&stopped), ..options(config) };
    let mut neighbour: Option<Trajectory> = None;
    let mut records = Vec::with_capacity(line.len());
    for number in line {
        if halted() {
            return None;
        }
        let outcome = match Task::of(config, manoeuvre, *number) {
            None => PoseOutcome::Rejected,
            Some(Task { start, given, target }) => {
                let solution = optimize_entry(config, target, start, neighbour.as_slice(), &options);
                // An interrupted search has tried some guesses only: its best solution need not be the best of all.
                if stopped() {
                    return None;
                }
                match solution.status {
                    NlpStatus::Solved => {
                        let entry = entry(config, &solution.trajectory, &given);
                        neighbour = Some(entry.trajectory.clone());
                        PoseOutcome::Solved(Box::new(entry))
                    }
                    _ => PoseOutcome::Failed,
                }
            }
        };
        records.push(PoseRecord { pose: *number as u64, outcome });
    }
    improve_line(config, manoeuvre, &mut records, &options)?;
    Some(records)
}

/// The entry of a solution from a start, with its given values, rad or m.
fn entry(config: &Config, solution: &Trajectory, given: &[f64]) -> Entry {
    let entry = Entry::new(solution, |t| certify(config, t));
    Entry { key: key(entry.trajectory.start(), given), ..entry }
}

/// Optimises poses of a line from the solution of a pose next to them that is cheaper and of another family, from the last
/// pose to the first and back, until none becomes cheaper; poses without a solution from any solution. `None` if the build was stopped
/// meanwhile.
pub fn improve_line(
    config: &Config,
    manoeuvre: usize,
    line: &mut [PoseRecord],
    options: &NlpOptions<'_>,
) -> Option<()> {
    let there: Vec<usize> = (0..line.len()).collect();
    let back: Vec<usize> = there.iter().rev().copied().collect();
    // The poses from which those next to them have not been optimised.
    let mut new = vec![true; line.len()];
    while new.contains(&true) {
        let mut improved = vec![false; line.len()];
        for pass in [&back, &there] {
            for pair in pass.windows(2) {
                let (from, to) = (pair[0], pair[1]);
                if (new[from] || improved[from])
                    && let Some(better) = improved_from(config, manoeuvre, &line[from], &line[to], options)?
                {
                    line[to].outcome = PoseOutcome::Solved(Box::new(better));
                    improved[to] = true;
                }
            }
        }
        new = improved;
    }
    Some(())
}

/// The entry of a pose optimised from the solution of the pose next to it; `Some(None)` if it is not worth the attempt or not cheaper than
/// that of `record`, `None` if the build was stopped.
fn improved_from(
    config: &Config,
    manoeuvre: usize,
    neighbour: &PoseRecord,
    record: &PoseRecord,
    options: &NlpOptions<'_>,
) -> Option<Option<Entry>> {
    let PoseOutcome::Solved(neighbour) = &neighbour.outcome else { return Some(None) };
    let Some(Task { start, given, target }) = Task::of(config, manoeuvre, record.pose as usize) else {
        return Some(None);
    };
    let problem = problem_with_margin(config, target, start);
    let guess = problem.shifted(&neighbour.trajectory);
    let cost = match &record.outcome {
        PoseOutcome::Solved(entry)
            if neighbour.certificate.cost < entry.certificate.cost
                && moves_otherwise(&problem, &guess, &entry.trajectory) =>
        {
            entry.certificate.cost
        }
        PoseOutcome::Failed => f64::INFINITY,
        _ => return Some(None),
    };
    let solution = interior_point::solve(&problem, &guess, options);
    if solution.status == NlpStatus::Interrupted {
        return None;
    }
    let cheaper = solution.status == NlpStatus::Solved && solution.cost < cost * (1.0 - SAME);
    Some(cheaper.then(|| entry(config, &solution.trajectory, &given)))
}

/// Whether two trajectories from the same start belong to different families of solutions.
fn moves_otherwise(problem: &Problem<'_>, one: &Trajectory, other: &Trajectory) -> bool {
    /// Of the range of a joint, or of a turn. In the default database half of the entries differ from the shifted ones next to them by less
    /// than 0.09; those that became cheaper by an entry next to them differed from one by 0.34 or more.
    const APART: f64 = 0.3;
    let limits = &problem.limits;
    let apart = |(x, y): (&State, &State)| {
        (0..problem.sizes().joints()).any(|i| {
            let range = (limits.q_max[i] - limits.q_min[i]).min(std::f64::consts::TAU);
            (x[i] - y[i]).abs() > APART * range
        })
    };
    one.x.iter().zip(&other.x).any(apart)
}

/// The places of the records of the finished database at `output` if its header is that of this build and its records are undamaged. A file
/// of other settings is replaced at the end.
fn finished(output: &Path, heading: &DatabaseHeading) -> Result<Option<Vec<RecordPlace>>, BuildError> {
    let database = match DatabaseFile::open(output).map(DatabaseFile::load) {
        Err(BuildError::File { cause, .. }) if cause.kind() == std::io::ErrorKind::NotFound => {
            return Ok(None);
        }
        Err(e) => return Err(e),
        Ok(Ok(database)) if database.heading() == heading => database,
        Ok(_) => return Ok(None),
    };
    let place = |record: Result<PoseRecord, _>| record.map(|record| RecordPlace::new(&record, 0, 0));
    let records: Result<Vec<_>, DatabaseError> = database.records().map(place).collect();
    Ok(records.ok())
}

/// The journal of a build, locked until the build ends.
struct Journal {
    out: File,
    /// The same file, for reading.
    file: RecordFile,
    /// Bytes in the file.
    length: u64,
    /// Its records.
    records: Vec<RecordPlace>,
}

impl Journal {
    /// Opens the journal for appending, locks it, and reads its complete records.
    fn open(path: &Path, heading: &DatabaseHeading) -> Result<Self, BuildError> {
        let failed = |action| move |cause| BuildError::File { action, path: path.to_owned(), cause };
        let mut out = open_journal(path)?;
        let source = DatabaseSource::File(out.try_clone().map_err(failed("read"))?);
        let file = RecordFile { source, origin: path.display().to_string() };
        let beginning = heading.journal();
        let length = file.source.length().map_err(file.failed())?;
        let mut scan = match RecordScan::new(&file.source) {
            Ok(scan) => scan,
            // A journal that ends within its header, because the process was killed, holds no records.
            Err(_) if length < beginning.len() as u64 => {
                out.set_len(0).and_then(|()| out.write_all(&beginning)).map_err(failed("write"))?;
                let (length, records) = (beginning.len() as u64, Vec::new());
                return Ok(Self { out, file, length, records });
            }
            Err(cause) => return Err(file.failed()(cause)),
        };
        let got = scan.heading();
        same_origin(path, got, heading)?;
        for (what, expected, got) in
            [("shard", heading.shard, got.shard), ("shards", heading.shards, got.shards)]
        {
            if expected != got {
                return Err(BuildError::Foreign { path: path.to_owned(), what, expected, got });
            }
        }
        // The first record that is not whole was being written by a process that was killed.
        let records = scan.by_ref().map_while(Result::ok);
        let records = records.map(|(at, record)| RecordPlace::new(&record, 0, at)).collect();
        let length = scan.at();
        out.set_len(length).map_err(failed("write"))?;
        Ok(Self { out, file, length, records })
    }

    /// Appends records, in one write.
    fn append(&mut self, records: &[PoseRecord]) -> std::io::Result<()> {
        let mut bytes = Vec::new();
        let begin = self.records.len();
        for record in records {
            self.records.push(RecordPlace::new(record, 0, self.length + bytes.len() as u64));
            bytes.extend(record.encode());
        }
        self.out.write_all(&bytes).inspect_err(|_| self.records.truncate(begin))?;
        self.length += bytes.len() as u64;
        Ok(())
    }
}

fn remove(path: &Path) -> Result<(), BuildError> {
    std::fs::remove_file(path).map_err(|cause| BuildError::File {
        action: "remove",
        path: path.to_owned(),
        cause,
    })
}
