//! `upswing db`: builds, joins, checks, describes or exports trajectory databases.

use super::{CommonArgs, TrajectoryJson, print_json, progress_bar};
use crate::parse::given_values;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;
use upswing_config::Config;
use upswing_planner::database::{
    self, BuildError, BuildSummary, DatabaseFile, DatabaseOverview, JointCoverage,
};
use upswing_process::number::whole;
use upswing_process::output::{Destination, OutputError, OutputFile, Overwrite};
use upswing_process::shard::Shard;
use upswing_process::{Failure, shutdown_flag};
use upswing_trajectory::{Certificate, Database};

/// Builds, joins, checks, describes or exports trajectory databases.
///
/// Example: upswing db info
#[derive(Clone, Debug, clap::Args)]
pub struct DbArgs {
    /// The action.
    #[command(subcommand)]
    pub command: DbCommand,
}

/// Actions on databases.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum DbCommand {
    /// Optimise every pose of a grid on all cores and write the database; resumes an interrupted build
    ///
    /// Example: upswing db build --grid my-grid.toml --output swing-up.bin
    Build {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// Manoeuvre of the database [default: the first one of the settings]
        #[arg(long, value_name = "NAME")]
        manoeuvre: Option<String>,
        /// Grid file, or `paper` for the paper's 4 x 4 x 4 x 4 poses [default: that of the manoeuvre in the settings]
        #[arg(long, value_name = "FILE")]
        grid: Option<PathBuf>,
        /// Build only part i of n; `upswing db merge` joins the parts
        #[arg(long, value_name = "i/n", default_value = "1/1")]
        shard: Shard,
        /// Output file; during the build, FILE.journal holds the finished poses [default: the name of the database in the folder of a
        /// system, like `swing-up.bin`]
        #[arg(long, value_name = "FILE")]
        output: Option<Destination>,
        /// Overwriting of existing files.
        #[command(flatten)]
        overwrite: Overwrite,
    },
    /// Join the shards of one build; the result has the same bytes as a build without shards
    ///
    /// Example: upswing db merge --output swing-up.bin shard-1.bin shard-2.bin
    Merge {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// Output file
        #[arg(long, value_name = "FILE")]
        output: Destination,
        /// Overwriting of existing files.
        #[command(flatten)]
        overwrite: Overwrite,
        /// Shard files, in any order
        #[arg(required = true)]
        shards: Vec<PathBuf>,
    },
    /// Recompute the certificate of every entry (start, target, limits, figures), and optimise the poses without a trajectory again
    ///
    /// Example: upswing db verify swing-up.bin
    Verify {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// Manoeuvre of the database [default: the first one of the settings]
        #[arg(long, value_name = "NAME")]
        manoeuvre: Option<String>,
        /// Grid of the database: a file, or `paper` [default: that of the manoeuvre in the settings]
        #[arg(long, value_name = "FILE")]
        grid: Option<PathBuf>,
        /// Database file [default: the database of the settings]
        file: Option<PathBuf>,
    },
    /// Describe the database of the settings, or a file; angles in deg, t_F in s
    ///
    /// Example: upswing db info swing-up.bin
    Info {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// Manoeuvre of the database [default: the first one of the settings]
        #[arg(long, value_name = "NAME")]
        manoeuvre: Option<String>,
        /// Database file [default: the database of the settings]
        file: Option<PathBuf>,
    },
    /// Print trajectories as JSON, one line per entry; units s, rad, rad/s, rad/s^2
    ///
    /// Example: upswing db export --entry 0 > trajectory.json
    Export {
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
        /// Manoeuvre of the database [default: the first one of the settings]
        #[arg(long, value_name = "NAME")]
        manoeuvre: Option<String>,
        /// Database file [default: the database of the settings]
        file: Option<PathBuf>,
        /// Export only this entry, counted from 0
        #[arg(long, value_parser = whole(0, usize::MAX))]
        entry: Option<usize>,
    },
}

/// Runs a command on databases.
///
/// # Errors
/// [`Failure::BadInput`] for an unusable file, [`Failure::Failed`] if a pose has no solution or a certificate does
/// not hold.
pub fn run(args: &DbArgs) -> Result<(), Failure> {
    match &args.command {
        DbCommand::Build { common, manoeuvre, grid, shard, output, overwrite } => {
            build(common, (manoeuvre.as_deref(), grid.as_deref()), *shard, (output.as_ref(), *overwrite))
        }
        DbCommand::Merge { common, output, overwrite, shards } => {
            merge(common, &overwrite.output(output), shards)
        }
        DbCommand::Verify { common, manoeuvre, grid, file } => {
            verify(common, (manoeuvre.as_deref(), grid.as_deref()), file.as_deref())
        }
        DbCommand::Info { common, manoeuvre, file } => info(common, manoeuvre.as_deref(), file.as_deref()),
        DbCommand::Export { common, manoeuvre, file, entry } => {
            export(common, manoeuvre.as_deref(), file.as_deref(), *entry)
        }
    }
}

/// Converts the error of a build: shards of different builds to [`Failure::BadInput`], a full disk to [`Failure::Failed`].
fn failure(e: BuildError) -> Failure {
    match e {
        BuildError::File { action: "read", .. }
        | BuildError::Output(OutputError::Exists { .. })
        | BuildError::Database { .. }
        | BuildError::Foreign { .. }
        | BuildError::Nothing => Failure::bad_input(e),
        e => Failure::failed(e),
    }
}

#[derive(Serialize)]
struct DbBuildResult {
    success: bool,
    file: PathBuf,
    poses: usize,
    entries: usize,
    rejected: usize,
    failed: Vec<u64>,
    resumed: usize,
    left: usize,
    time_s: f64,
}

impl std::fmt::Display for DbBuildResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}: {} entries of {} poses ({} left out by the grid's rules, {} without solution) in {:.1} s",
            self.file.display(),
            self.entries,
            self.poses,
            self.rejected,
            self.failed.len(),
            self.time_s
        )?;
        if self.resumed > 0 {
            write!(f, "; {} poses were there already", self.resumed)?;
        }
        Ok(())
    }
}

fn build(
    common: &CommonArgs,
    (name, grid): (Option<&str>, Option<&Path>),
    shard: Shard,
    (output, overwrite): (Option<&Destination>, Overwrite),
) -> Result<(), Failure> {
    let mut config = common.process.load()?;
    let manoeuvre = use_manoeuvre(&mut config, name, grid)?;
    let default = || Destination::from(OsString::from(DatabaseFile::name(&config, manoeuvre)));
    let output = &overwrite.output(&output.cloned().unwrap_or_else(default));
    let stop = shutdown_flag()?;
    let poses = database::poses(&config.manoeuvres[manoeuvre]);
    let bar = progress_bar((poses as u64).div_ceil(shard.of), "poses");
    let begin = Instant::now();
    let summary = database::build(&config, manoeuvre, shard, output, &stop, |n| bar.inc(n as u64)).map_err(
        |e| match e {
            BuildError::File { action: "read", .. } => failure(e),
            BuildError::File { .. } | BuildError::Output(OutputError::Io { .. }) => {
                Failure::failed(format!("{e}; what was finished is kept in the journal"))
            }
            e => failure(e),
        },
    )?;
    bar.finish_and_clear();
    for pose in &summary.failed {
        let settings = &config.manoeuvres[manoeuvre];
        let (q_a, given) = database::pose(settings, *pose as usize);
        let shown = |(i, q): (usize, &f64)| {
            let (q, unit) = config.model.joint_kind(i).shown(*q);
            format!("{q:.3} {unit}")
        };
        let start: Vec<String> = q_a.iter().enumerate().map(shown).collect();
        let given = settings.given().map(|axis| axis.joint).zip(&given);
        let to: Vec<String> = given.map(shown).collect();
        let to = if to.is_empty() { String::new() } else { format!(" to [{}]", to.join(", ")) };
        tracing::warn!("no solution from pose {pose}, [{}]{to}", start.join(", "));
    }
    conclude(common, output.path(), summary, begin)
}

fn merge(common: &CommonArgs, output: &OutputFile, shards: &[PathBuf]) -> Result<(), Failure> {
    let begin = Instant::now();
    let summary = database::merge(shards, output).map_err(failure)?;
    conclude(common, output.path(), summary, begin)
}

/// Number of the manoeuvre `name`, the first one without a name, whose grid is replaced by `grid` if given.
fn use_manoeuvre(config: &mut Config, name: Option<&str>, grid: Option<&Path>) -> Result<usize, Failure> {
    let number = number_of(config, name)?;
    if let Some(other) = config.manoeuvres[number].reverses {
        let [name, other] = [number, other].map(|i| &config.manoeuvres[i].name);
        let refusal =
            format!("--manoeuvre: `{name}` runs the database of `{other}` backwards: name that one");
        return Err(Failure::BadInput(refusal));
    }
    match grid {
        Some(name) if name == Path::new("paper") && number == 0 => config.use_paper_grid()?,
        Some(path) => config.use_grid(number, path)?,
        None => {}
    }
    Ok(number)
}

/// Number of the manoeuvre `name`; of the first one without a name.
fn number_of(config: &Config, name: Option<&str>) -> Result<usize, Failure> {
    name.map_or(Ok(0), |name| Ok(given_values(config, Some(name), &[])?.0))
}

/// Prints the result of a build or merge that started at `begin`.
fn conclude(
    common: &CommonArgs,
    output: &Path,
    summary: BuildSummary,
    begin: Instant,
) -> Result<(), Failure> {
    let BuildSummary { poses, resumed, solved, rejected, failed: unsolved, left } = summary;
    let count = unsolved.len();
    common.print(&DbBuildResult {
        success: count == 0 && left == 0,
        file: output.to_owned(),
        poses,
        entries: solved,
        rejected,
        failed: unsolved,
        resumed,
        left,
        time_s: begin.elapsed().as_secs_f64(),
    })?;
    match (left, count) {
        (0, 0) => Ok(()),
        (0, n) => Err(Failure::failed(format!("{n} poses have no solution"))),
        (n, _) => Err(Failure::failed(format!(
            "interrupted with {n} poses left; the same command goes on from here"
        ))),
    }
}

/// Reads the database of a file, or that of a manoeuvre of the settings; returns it with its origin for messages.
fn read(config: &Config, manoeuvre: usize, file: Option<&Path>) -> Result<(Database, String), Failure> {
    let file = match file {
        Some(path) => DatabaseFile::open(path).map_err(failure)?,
        None => DatabaseFile::of(config, manoeuvre)?.ok_or_else(|| {
            let name = &config.manoeuvres[manoeuvre].name;
            Failure::BadInput(format!(
                "the settings have no database of `{name}`; build it with `upswing db build --manoeuvre {name}`"
            ))
        })?,
    };
    let origin = file.origin.clone();
    Ok((file.load().map_err(failure)?, origin))
}

#[derive(Serialize)]
struct DbVerifyResult {
    success: bool,
    origin: String,
    entries: usize,
    /// Whether the start of every entry was compared with the grid, because the database was built from this grid.
    starts_compared: bool,
    discrepancies: Vec<u64>,
    worst: CertificateJson,
    time_s: f64,
}

/// Figures of a certificate, or the worst of several.
#[derive(Serialize)]
struct CertificateJson {
    defect: f64,
    margin_q: f64,
    margin_qd: f64,
    margin_tau: f64,
    end_error: f64,
}

impl From<&Certificate> for CertificateJson {
    fn from(c: &Certificate) -> Self {
        Self {
            defect: c.defect,
            margin_q: c.margin_q,
            margin_qd: c.margin_qd,
            margin_tau: c.margin_tau,
            end_error: c.end_error,
        }
    }
}

impl std::fmt::Display for CertificateJson {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "defect {:.1e}; margin (share of half the range, between knots too) position {:.4}, velocity {:.4}, \
             torque {:.4}; end missed without feedback by {:.3} rad or rad/s",
            self.defect, self.margin_q, self.margin_qd, self.margin_tau, self.end_error
        )
    }
}

impl std::fmt::Display for DbVerifyResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.success { "every record holds" } else { "RECORDS DO NOT HOLD" };
        writeln!(f, "{}: {} entries, {verdict} ({:.1} s)", self.origin, self.entries, self.time_s)?;
        if !self.discrepancies.is_empty() {
            writeln!(f, "  poses     {:?}", self.discrepancies)?;
        }
        write!(f, "  worst     {}", self.worst)
    }
}

fn verify(
    common: &CommonArgs,
    (name, grid): (Option<&str>, Option<&Path>),
    file: Option<&Path>,
) -> Result<(), Failure> {
    let mut config = common.process.load()?;
    let manoeuvre = use_manoeuvre(&mut config, name, grid)?;
    let (database, origin) = read(&config, manoeuvre, file)?;
    database::check_origin(&config, manoeuvre, &database)
        .map_err(|e| Failure::BadInput(format!("{origin}: {e}")))?;
    let starts_compared = database::has_grid_of(&config, manoeuvre, &database);
    if !starts_compared {
        tracing::warn!("{origin}: built from another grid, starts are not compared; name it by --grid");
    }
    let entries = database.entries();
    let bar = progress_bar(entries as u64, "entries");
    let begin = Instant::now();
    let damaged = |e| Failure::BadInput(format!("{origin}: {e}"));
    let discrepancies = database::verify(&config, manoeuvre, &database, || bar.inc(1)).map_err(damaged)?;
    let worst = DatabaseOverview::of(&database, &config.model).map_err(damaged)?.worst;
    bar.finish_and_clear();
    for d in &discrepancies {
        tracing::warn!("pose {}: {}", d.pose, d.flaw);
    }
    let success = discrepancies.is_empty();
    common.print(&DbVerifyResult {
        success,
        origin,
        entries,
        starts_compared,
        discrepancies: discrepancies.iter().map(|d| d.pose).collect(),
        worst: (&worst).into(),
        time_s: begin.elapsed().as_secs_f64(),
    })?;
    if success {
        Ok(())
    } else {
        Err(Failure::failed(format!("{} records do not hold", discrepancies.len())))
    }
}

#[derive(Serialize)]
struct DbInfoResult {
    origin: String,
    poses: u64,
    shard: u64,
    shards: u64,
    entries: usize,
    rejected: usize,
    failed: usize,
    model: String,
    problem: String,
    grid: String,
    fits_settings: bool,
    t_f_min: f64,
    t_f_max: f64,
    cost_min: f64,
    cost_max: f64,
    worst: CertificateJson,
    joints: Vec<JointCoverage>,
    #[serde(skip)]
    map: String,
}

impl std::fmt::Display for DbInfoResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}: {} entries of {} poses", self.origin, self.entries, self.poses)?;
        if self.shards > 1 {
            writeln!(f, "  shard     {} of {}", self.shard, self.shards)?;
        }
        writeln!(f, "  left out  {} by the grid's rules, {} without solution", self.rejected, self.failed)?;
        let fits = if self.fits_settings { "the settings" } else { "OTHER settings" };
        writeln!(f, "  made for  model {}, limits and weights {} ({fits})", self.model, self.problem)?;
        writeln!(f, "  t_F       {:.3} to {:.3} s", self.t_f_min, self.t_f_max)?;
        writeln!(f, "  cost      {:.3} to {:.3}", self.cost_min, self.cost_max)?;
        write!(f, "  worst     {}", self.worst)?;
        for c in &self.joints {
            let positions: Vec<_> =
                c.positions.iter().zip(&c.entries).map(|(q, n)| format!("{q} ({n})")).collect();
            write!(f, "\n  joint {}   {} {} (entries)", c.joint, positions.join(", "), c.unit)?;
        }
        write!(f, "{}", self.map)
    }
}

/// Draws the map of an overview as text, with one cell per pair of positions, darker with more entries; nothing without a map.
fn coverage_map(overview: &DatabaseOverview) -> String {
    const SHADES: [char; 5] = ['·', '░', '▒', '▓', '█'];
    let ([.., rows, columns], cells) = (overview.joints.as_slice(), &overview.map) else {
        return String::new();
    };
    let most = cells.iter().flatten().copied().max().unwrap_or(0).max(1);
    let mut map = format!(
        "\n  coverage  joint {} down, joint {} across ({} to {} {}); █ is {most} entries, · none",
        rows.joint,
        columns.joint,
        columns.positions.first().copied().unwrap_or(0.0),
        columns.positions.last().copied().unwrap_or(0.0),
        columns.unit
    );
    for (position, row) in rows.positions.iter().zip(cells) {
        let shade = |n: &usize| SHADES[(n * (SHADES.len() - 1)).div_ceil(most)];
        let line: String = row.iter().flat_map(|n| [shade(n); 2]).collect();
        map.push_str(&format!("\n  {position:>8}  {line}"));
    }
    map
}

fn info(common: &CommonArgs, name: Option<&str>, file: Option<&Path>) -> Result<(), Failure> {
    let config = common.process.load()?;
    let manoeuvre = number_of(&config, name)?;
    let (database, origin) = read(&config, manoeuvre, file)?;
    let overview = DatabaseOverview::of(&database, &config.model);
    let (h, overview) =
        (database.heading(), overview.map_err(|e| Failure::BadInput(format!("{origin}: {e}")))?);
    common.print(&DbInfoResult {
        origin,
        poses: h.poses,
        shard: h.shard,
        shards: h.shards,
        entries: overview.entries,
        rejected: overview.rejected,
        failed: overview.failed,
        model: format!("{:016x}", h.model),
        problem: format!("{:016x}", h.problem),
        grid: format!("{:016x}", h.grid),
        fits_settings: database::check_origin(&config, manoeuvre, &database).is_ok(),
        t_f_min: overview.t_f.0,
        t_f_max: overview.t_f.1,
        cost_min: overview.cost.0,
        cost_max: overview.cost.1,
        worst: (&overview.worst).into(),
        map: coverage_map(&overview),
        joints: overview.joints,
    })
}

#[derive(Serialize)]
struct DbExportResult {
    entry: usize,
    #[serde(flatten)]
    trajectory: TrajectoryJson,
    status: &'static str,
    cost: f64,
    #[serde(flatten)]
    certificate: CertificateJson,
}

fn export(
    common: &CommonArgs,
    name: Option<&str>,
    file: Option<&Path>,
    only: Option<usize>,
) -> Result<(), Failure> {
    let config = common.process.load()?;
    let (database, origin) = read(&config, number_of(&config, name)?, file)?;
    let entries = database.entries();
    if let Some(entry) = only.filter(|e| *e >= entries) {
        let last = entries.saturating_sub(1);
        return Err(Failure::BadInput(format!("--entry: {origin} has entries 0 to {last}, got {entry}")));
    }
    for entry in only.map_or(0..entries, |entry| entry..entry + 1) {
        let e = database.entry(entry).map_err(|e| Failure::BadInput(format!("{origin}: {e}")))?;
        print_json(&DbExportResult {
            entry,
            trajectory: TrajectoryJson::new(&e.trajectory, config.model.order()),
            status: "solved",
            cost: e.certificate.cost,
            certificate: (&e.certificate).into(),
        })?;
    }
    Ok(())
}
