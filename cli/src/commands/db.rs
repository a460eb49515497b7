//! `upswing db`: the trajectory database.

use super::{CommonArgs, TrajectoryJson, failed, print_json};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use upswing_config::process::{Failure, shutdown_flag};
use upswing_planner::offline::{GridPoint, build, database, grid_poses, problem_fingerprint};
use upswing_trajectory::Database;

/// Builds, describes or exports a trajectory database.
#[derive(Clone, Debug, clap::Args)]
pub struct DbArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: DbCommand,
}

/// What to do with a database.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum DbCommand {
    /// Optimise every pose of the grid in planner.toml on all cores and write the database
    ///
    /// Example: upswing db build --config my-config --output my-config/database.bin
    Build {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// File to write
        #[arg(long, value_name = "FILE", default_value = "database.bin")]
        output: PathBuf,
    },
    /// Describe the database of the settings, or a file
    Info {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// A database file instead of that of the settings
        file: Option<PathBuf>,
    },
    /// Print trajectories as JSON, one line per entry
    ///
    /// Example: upswing db export --entry 0 > trajectory.json
    Export {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// A database file instead of that of the settings
        file: Option<PathBuf>,
        /// Only this entry, counted from 0
        #[arg(long)]
        entry: Option<usize>,
    },
}

/// Runs the command.
///
/// # Errors
/// [`Failure::BadInput`] for an unusable file, [`Failure::Failed`] if a pose has no solution.
pub fn run(args: &DbArgs) -> Result<(), Failure> {
    match &args.command {
        DbCommand::Build { common, output } => build_file(common, output),
        DbCommand::Info { common, file } => info(common, file.as_deref()),
        DbCommand::Export { common, file, entry } => export(common, file.as_deref(), *entry),
    }
}

#[derive(Serialize)]
struct Built {
    success: bool,
    file: PathBuf,
    poses: usize,
    entries: usize,
    rejected: usize,
    failed: usize,
    time_s: f64,
}

impl std::fmt::Display for Built {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}: {} entries of {} poses ({} left out: no rest position within the limits; {} failed) in {:.1} s",
            self.file.display(),
            self.entries,
            self.poses,
            self.rejected,
            self.failed,
            self.time_s
        )
    }
}

fn build_file(common: &CommonArgs, output: &Path) -> Result<(), Failure> {
    let config = common.process.load()?;
    let stop = shutdown_flag()?;
    let poses = grid_poses(&config.planner.grid).len();
    // Draws nothing where stderr is not a terminal.
    let bar = ProgressBar::new(poses as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} poses, {eta} left") {
        bar.set_style(style);
    }
    let begin = Instant::now();
    let points = build(&config, &stop, || bar.inc(1));
    bar.finish_and_clear();
    let count = |f: fn(&GridPoint) -> bool| points.iter().filter(|p| f(p)).count();
    let rejected = count(|p| matches!(p, GridPoint::Rejected(_)));
    let skipped = count(|p| matches!(p, GridPoint::Skipped));
    let mut failures = 0;
    for point in &points {
        if let GridPoint::Failed { pose, solution } = point {
            failures += 1;
            let degrees: Vec<_> = pose.iter().map(|q| format!("{:.1}", q.to_degrees())).collect();
            tracing::warn!(
                "no solution from [{}] deg: {:?}, largest violation {:.1e}",
                degrees.join(", "),
                solution.status,
                solution.violation
            );
        }
    }
    let database = database(&config, points);
    write_whole(output, &database.encode())?;
    common.print(&Built {
        success: failures == 0 && skipped == 0,
        file: output.to_owned(),
        poses,
        entries: database.entries.len(),
        rejected,
        failed: failures,
        time_s: begin.elapsed().as_secs_f64(),
    })?;
    match (skipped, failures) {
        (0, 0) => Ok(()),
        (0, n) => Err(failed(format!("{n} poses have no solution"))),
        (n, _) => Err(failed(format!("interrupted with {n} poses left; the file holds the others"))),
    }
}

/// Writes a file beside its place and renames it: a reader sees the old one or the new one.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    let write = || {
        std::fs::write(&beside, bytes)?;
        std::fs::rename(&beside, path)
    };
    write().map_err(|e| {
        let _ = std::fs::remove_file(&beside);
        failed(format!("cannot write {}: {e}", path.display()))
    })
}

/// The database of a file or of the settings, and where it comes from.
fn read(common: &CommonArgs, file: Option<&Path>) -> Result<(Database, String), Failure> {
    let (bytes, origin) = match file {
        Some(path) => {
            let bytes = std::fs::read(path)
                .map_err(|e| Failure::BadInput(format!("cannot read {}: {e}", path.display())))?;
            (bytes.into(), path.display().to_string())
        }
        None => {
            let database = common.process.load()?.database;
            (database.bytes, database.origin)
        }
    };
    let database = Database::decode(&bytes).map_err(|e| Failure::BadInput(format!("{origin}: {e}")))?;
    Ok((database, origin))
}

#[derive(Serialize)]
struct Info {
    origin: String,
    entries: usize,
    model: String,
    problem: String,
    fits_settings: bool,
    t_f_min: f64,
    t_f_max: f64,
    cost_min: f64,
    cost_max: f64,
    joints: Vec<JointCoverage>,
}

#[derive(Serialize)]
struct JointCoverage {
    joint: usize,
    angles_deg: Vec<f64>,
}

impl std::fmt::Display for Info {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}: {} entries", self.origin, self.entries)?;
        let fits = if self.fits_settings { "the settings" } else { "OTHER settings" };
        writeln!(f, "  made for  model {}, limits and weights {} ({fits})", self.model, self.problem)?;
        writeln!(f, "  t_F       {:.3} to {:.3} s", self.t_f_min, self.t_f_max)?;
        write!(f, "  cost      {:.3} to {:.3}", self.cost_min, self.cost_max)?;
        for c in &self.joints {
            let angles: Vec<_> = c.angles_deg.iter().map(|a| format!("{a}")).collect();
            write!(f, "\n  joint {}   {} deg", c.joint, angles.join(", "))?;
        }
        Ok(())
    }
}

fn info(common: &CommonArgs, file: Option<&Path>) -> Result<(), Failure> {
    let (database, origin) = read(common, file)?;
    let config = common.process.load()?;
    let range = |values: &dyn Fn(&upswing_trajectory::Entry) -> f64| {
        database
            .entries
            .iter()
            .map(values)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (t_f_min, t_f_max) = range(&|e| e.trajectory.t_f);
    let (cost_min, cost_max) = range(&|e| e.cost);
    let joints = (0..upswing_model::NU)
        .map(|i| {
            // A thousandth of a degree tells all grid angles apart and hides rounding.
            let angle =
                |e: &upswing_trajectory::Entry| (e.trajectory.x[0][i].to_degrees() * 1e3).round() / 1e3;
            let mut angles_deg: Vec<f64> = database.entries.iter().map(angle).collect();
            angles_deg.sort_by(f64::total_cmp);
            angles_deg.dedup();
            JointCoverage { joint: i + 1, angles_deg }
        })
        .filter(|c| c.angles_deg.len() > 1)
        .collect();
    let fits_settings =
        database.check_made_for(config.model.fingerprint(), problem_fingerprint(&config)).is_ok();
    common.print(&Info {
        origin,
        entries: database.entries.len(),
        model: format!("{:016x}", database.model),
        problem: format!("{:016x}", database.problem),
        fits_settings,
        t_f_min,
        t_f_max,
        cost_min,
        cost_max,
        joints,
    })
}

#[derive(Serialize)]
struct EntryJson {
    entry: usize,
    #[serde(flatten)]
    trajectory: TrajectoryJson,
    status: &'static str,
    cost: f64,
}

fn export(common: &CommonArgs, file: Option<&Path>, only: Option<usize>) -> Result<(), Failure> {
    let (database, origin) = read(common, file)?;
    let entries = database.entries.len();
    if let Some(entry) = only.filter(|e| *e >= entries) {
        return Err(Failure::BadInput(format!(
            "--entry: {origin} has entries 0 to {}, got {entry}",
            entries - 1
        )));
    }
    for (entry, e) in database.entries.iter().enumerate() {
        if only.is_none_or(|o| o == entry) {
            print_json(&EntryJson {
                entry,
                trajectory: (&e.trajectory).into(),
                status: "solved",
                cost: e.cost,
            })?;
        }
    }
    Ok(())
}
