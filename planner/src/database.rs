//! The trajectory database: [`build()`] it, [`merge()`] its shards, [`verify()`] its records, and describe it
//! ([`DatabaseOverview`]). The file format and the search of entries are those of [`upswing_trajectory::Database`].

mod assemble;
mod build;
mod merge;
mod overview;
mod stored;
mod verify;

pub use build::{build, improve_line};
pub use merge::merge;
pub use overview::{DatabaseOverview, JointCoverage};
pub use stored::{DatabaseFile, SHIPPED};
pub use verify::{Discrepancy, RecordFlaw, verify};

use crate::offline::{problem_fingerprint, target};
use crate::replan::Planner;
use std::path::{Path, PathBuf};
use upswing_config::{Config, ConfigError, Manoeuvre};
use upswing_model::thresholds::SAME_START;
use upswing_model::{ActuatedVector, Posture, State};
use upswing_ocp::kkt::TargetRow;
use upswing_process::output::OutputError;
use upswing_process::shard::{JournalError, MissingShards, Shard};
use upswing_trajectory::{Certificate, Database, DatabaseError, DatabaseHeading, Trajectory};
use xxhash_rust::xxh3::Xxh3;

/// Error of a build, merge or verification of a database.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// A file cannot be read or written.
    #[error("cannot {action} {}: {cause}", path.display())]
    File {
        /// Verb of the operation: read, write, ...
        action: &'static str,
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// The result cannot be written, or may not replace an existing file.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file is no database or a damaged database.
    #[error("{origin}: {cause}")]
    Database {
        /// Path of the file.
        origin: String,
        /// Error of the decoder.
        cause: DatabaseError,
    },
    /// A file was made for another robot, other settings, another grid or another shard.
    #[error("{}: {what} is {got:016x}, expected {expected:016x}; remove the file or use the settings it was made with", path.display())]
    Foreign {
        /// Path of the file.
        path: PathBuf,
        /// Name of the fingerprint or number that differs.
        what: &'static str,
        /// Expected value.
        expected: u64,
        /// Value in the file.
        got: u64,
    },
    /// Shards are missing.
    #[error(transparent)]
    Missing(#[from] MissingShards),
    /// All shards are present, but not all poses: a shard is not finished.
    #[error(
        "expected {poses} poses in the shards together, got {got}; finish the shards with `upswing db build`"
    )]
    Incomplete {
        /// Number of poses of the grid.
        poses: u64,
        /// Number of poses in the shards.
        got: u64,
    },
    /// Two files have different records of the same pose.
    #[error("pose {pose} differs between {} and {}", first.display(), second.display())]
    Disagree {
        /// Number of the pose.
        pose: u64,
        /// Path of one file.
        first: PathBuf,
        /// Path of the other file.
        second: PathBuf,
    },
    /// The journal cannot be opened, or another process is building the same file.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A merge without input files.
    #[error("no shards given")]
    Nothing,
}

/// Result of a build or merge: numbers of poses by outcome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildSummary {
    /// Number of poses of this shard.
    pub poses: usize,
    /// Number of poses found in the journal or in the finished file.
    pub resumed: usize,
    /// Number of poses with a trajectory.
    pub solved: usize,
    /// Number of poses left out by the rules of the grid.
    pub rejected: usize,
    /// Numbers of the poses without a solution.
    pub failed: Vec<u64>,
    /// Number of poses without a record when the build was stopped; if not 0, there is a journal and no file.
    pub left: usize,
}

/// Number of poses in the database of a manoeuvre: of its starts, times that of the values that requests give.
pub fn poses(manoeuvre: &Manoeuvre) -> usize {
    manoeuvre.grid.poses() * manoeuvre.given().map(|axis| axis.points).product::<usize>()
}

/// Start pose q_A and given values (rad or m) of pose `number` of a database, counted from 0; the starts vary faster than the given
/// values, the last ones of both fastest.
pub fn pose(manoeuvre: &Manoeuvre, number: usize) -> (ActuatedVector, Vec<f64>) {
    let starts = manoeuvre.grid.poses();
    let mut left = number / starts;
    let axes: Vec<_> = manoeuvre.given().collect();
    let mut given = vec![0.0; axes.len()];
    for (value, axis) in given.iter_mut().zip(&axes).rev() {
        *value = axis.position(left % axis.points);
        left /= axis.points;
    }
    (manoeuvre.grid.pose(number % starts), given)
}

/// The header of the database of a manoeuvre (or of one shard) for the robot, the optimisation problem and the grid of the settings.
pub(crate) fn heading(config: &Config, manoeuvre: usize, shard: Shard) -> DatabaseHeading {
    let (sizes, settings) = (config.model.sizes(), &config.manoeuvres[manoeuvre]);
    DatabaseHeading {
        sizes,
        joints: DatabaseHeading::joints_of(&config.model),
        intervals: config.planner.offline.intervals,
        key: sizes.actuated() + settings.given().count(),
        model: config.model.fingerprint(),
        problem: problem_fingerprint(config, manoeuvre),
        grid: grid_fingerprint(settings),
        poses: poses(settings) as u64,
        shard: shard.number,
        shards: shard.of,
    }
}

/// XXH3 hash of the grid of a manoeuvre: poses with given values, largest rest angle, and posture at the start.
fn grid_fingerprint(manoeuvre: &Manoeuvre) -> u64 {
    let mut hash = Xxh3::new();
    for number in 0..poses(manoeuvre) {
        let (q_a, given) = pose(manoeuvre, number);
        q_a.iter().chain(&given).for_each(|q| hash.update(&q.to_le_bytes()));
    }
    let grid = &manoeuvre.grid;
    hash.update(&grid.max_rest_angle.to_le_bytes());
    // The names that the format of the file has for the postures.
    hash.update(match manoeuvre.start {
        Posture::Hanging => b"Rest".as_slice(),
        Posture::Standing => b"Standing",
    });
    hash.digest()
}

/// Whether a database was built from the grid of the manoeuvre in the settings, so that [`verify()`] can compare poses.
pub fn has_grid_of(config: &Config, manoeuvre: usize, database: &Database) -> bool {
    database.heading().grid == grid_fingerprint(&config.manoeuvres[manoeuvre])
}

/// Checks that a database was made for the robot model, the limits, the weights and the manoeuvre of the settings; its grid may be
/// another.
///
/// # Errors
/// Those of [`DatabaseHeading::check_origin`].
pub fn check_origin(config: &Config, manoeuvre: usize, database: &Database) -> Result<(), DatabaseError> {
    database.heading().check_origin(&config.model, problem_fingerprint(config, manoeuvre))
}

/// Refuses a file that was made for another robot, other settings or another grid.
fn same_origin(path: &Path, got: &DatabaseHeading, expected: &DatabaseHeading) -> Result<(), BuildError> {
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

/// Opens a database file.
///
/// # Errors
/// [`BuildError::File`] or [`BuildError::Database`].
pub fn read(path: &Path) -> Result<Database, BuildError> {
    DatabaseFile::open(path)?.load()
}

/// What a pose of a database is to be solved for.
struct Task {
    /// rad, rad/s
    start: State,
    /// Values that a request would give, rad or m.
    given: Vec<f64>,
    target: Vec<TargetRow>,
}

impl Task {
    /// The task of pose `number` of manoeuvre number `manoeuvre`; `None` if the pose is left out: by the rules of the grid, or because the
    /// manoeuvre would end where it begins.
    fn of(config: &Config, manoeuvre: usize, number: usize) -> Option<Self> {
        let settings = &config.manoeuvres[manoeuvre];
        let (q_a, given) = pose(settings, number);
        let start = settings.start_state(&config.model, &config.robot.planning, &q_a)?;
        let target = target(config, manoeuvre, &given).ok()?;
        let moves = target.iter().any(|row| row.residual(&start).abs() > SAME_START);
        moves.then_some(Self { start, given, target })
    }
}

/// The state at rest with the actuated joints at `q_a` (rad or m) from which manoeuvre number `manoeuvre` starts standing: the unactuated
/// joints are as they stand in its target, or in that of the manoeuvre that it reverses. `None` if they are not in equilibrium there.
pub fn standing(config: &Config, manoeuvre: usize, q_a: &ActuatedVector) -> Option<State> {
    let source = config.manoeuvres[manoeuvre].reverses.unwrap_or(manoeuvre);
    config.manoeuvres[source].state_as_in_target(&config.model, &config.robot.planning, q_a)
}

/// The solutions of the entries nearest to a start (rad, rad/s) and `given` values (rad or m) in the database of manoeuvre number `manoeuvre`
/// of the settings, nearest first; none without a database. One that was made for other settings is a warning.
///
/// # Errors
/// Those of [`DatabaseFile::of`].
pub fn solutions_near(
    config: &Config,
    manoeuvre: usize,
    given: &[f64],
    start: &State,
) -> Result<Vec<Trajectory>, ConfigError> {
    let Some(file) = DatabaseFile::of(config, manoeuvre)? else { return Ok(Vec::new()) };
    Ok(match Planner::with_database(config.clone(), manoeuvre, file) {
        Ok(planner) => {
            let near = planner.nearest(manoeuvre, given, start).into_iter();
            let entries = near.filter_map(|near| match planner.entry(manoeuvre, near.index) {
                Ok(entry) => Some(entry.trajectory),
                Err(e) => {
                    tracing::warn!("{}: {e}; the entry is not used", planner.origin(manoeuvre));
                    None
                }
            });
            entries.collect()
        }
        Err(e) => {
            tracing::warn!("{e}; its entries are not used");
            Vec::new()
        }
    })
}

/// Computes the certificate of a trajectory under the limits and weights of the settings.
pub fn certify(config: &Config, trajectory: &Trajectory) -> Certificate {
    let input_weight = config.planner.offline.input_weight;
    Certificate::of(trajectory, &config.model, &config.robot.planning, input_weight)
}
