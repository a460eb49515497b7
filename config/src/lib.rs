//! Settings and robot description of upswing: read, checked once, then plain SI numbers.
//!
//! A full set is eight files, embedded in the program and, with [`Config::export`], written to a folder for
//! editing: the robot (`robot.urdf`), its limits and the target (`robot.toml`), the planner, the daemon, the
//! simulated plant, and the trajectory database. In the files angles may be in degrees (the key then says so);
//! past this crate everything is rad, s, N m, kg, m, and no value needs another check.

mod check;
mod daemon;
mod error;
mod grid;
mod planner;
mod plant;
pub mod process;
mod robot;
mod start;

pub use daemon::{
    CycleSettings, DaemonSettings, HoldGains, Level, Levels, PlanWhileTracking, RealtimeMode,
    RealtimeSettings, RecorderSettings, RecoverySettings, StartTolerance,
};
pub use error::ConfigError;
pub use grid::{GridAxis, GridSettings};
pub use planner::{
    LqrWeights, OfflineSettings, PlannerSettings, QpBackend, ReplanSettings, ReplanWeights, SUB_HORIZONS,
    TorqueConstraint,
};
pub use plant::{DriveSettings, EncoderSettings, FrictionSettings, PendulumStart, PlantSettings, PlantStart};
pub use robot::{CoriolisBound, RobotSettings, Target};
pub use start::StartError;

use check::{Check, degrees};
use std::borrow::Cow;
use std::io::Write;
use std::path::Path;
use upswing_model::{Limits, Model, NQ, NU};

/// One complete, checked set of settings.
#[derive(Clone, Debug)]
pub struct Config {
    /// Text of the robot description.
    pub urdf: String,
    /// The robot read from it; its rated limits agree with `robot.limits`.
    pub model: Model,
    /// Limits and target.
    pub robot: RobotSettings,
    /// The planner.
    pub planner: PlannerSettings,
    /// The control daemon.
    pub daemon: DaemonSettings,
    /// The simulated plant.
    pub plant: PlantSettings,
    /// Start poses of the database.
    pub grid: GridSettings,
    /// The trajectory database, not yet decoded.
    pub database: DatabaseFile,
}

/// A trajectory database as stored.
#[derive(Clone, Debug)]
pub struct DatabaseFile {
    /// Contents of the file.
    pub bytes: Cow<'static, [u8]>,
    /// Where they come from, for messages.
    pub origin: String,
}

struct EmbeddedFile {
    name: &'static str,
    bytes: &'static [u8],
}

macro_rules! embedded {
    ($name:literal) => {
        EmbeddedFile { name: $name, bytes: include_bytes!(concat!("../", $name)) }
    };
}

const URDF: EmbeddedFile = embedded!("robot.urdf");
const ROBOT: EmbeddedFile = embedded!("robot.toml");
const PLANNER: EmbeddedFile = embedded!("planner.toml");
const DAEMON: EmbeddedFile = embedded!("daemon.toml");
const PLANT: EmbeddedFile = embedded!("plant.toml");
const GRID: EmbeddedFile = embedded!("grid.toml");
/// Not read with a set of settings: another grid to build a database from.
const PAPER_GRID: EmbeddedFile = embedded!("grid-paper.toml");
const DATABASE: EmbeddedFile = embedded!("database.bin");
const FILES: [EmbeddedFile; 8] = [URDF, ROBOT, PLANNER, DAEMON, PLANT, GRID, PAPER_GRID, DATABASE];

/// A file's contents and the name that messages give it.
type Contents = (String, Cow<'static, [u8]>);

impl Config {
    /// The settings that the program was built with.
    ///
    /// # Errors
    /// None in a released program: its tests load them.
    pub fn embedded() -> Result<Self, ConfigError> {
        Self::assemble(|file| Ok((format!("embedded {}", file.name), Cow::Borrowed(file.bytes))))
    }

    /// The settings in a folder, which must hold all files of a full set.
    ///
    /// # Errors
    /// A file is missing, unreadable, malformed, or holds a value the system cannot work with.
    pub fn from_dir(dir: &Path) -> Result<Self, ConfigError> {
        Self::assemble(|file| {
            let path = dir.join(file.name);
            let name = path.display().to_string();
            match std::fs::read(path) {
                Ok(bytes) => Ok((name, Cow::Owned(bytes))),
                Err(cause) => Err(ConfigError::Unreadable { file: name, cause }),
            }
        })
    }

    /// The settings in a folder, or the embedded ones if none is named.
    ///
    /// # Errors
    /// As [`Config::from_dir`].
    pub fn load(dir: Option<&Path>) -> Result<Self, ConfigError> {
        dir.map_or_else(Self::embedded, Self::from_dir)
    }

    /// Writes the embedded files, with their comments, to a folder, which is created if need be.
    ///
    /// # Errors
    /// One of the files exists already (then nothing is written), or the folder cannot be written to.
    pub fn export(dir: &Path) -> Result<(), ConfigError> {
        let name = |path: &Path| path.display().to_string();
        if let Some(path) = FILES.iter().map(|file| dir.join(file.name)).find(|path| path.exists()) {
            return Err(ConfigError::Exists { file: name(&path) });
        }
        std::fs::create_dir_all(dir).map_err(|cause| ConfigError::Unwritable { file: name(dir), cause })?;
        for file in &FILES {
            let path = dir.join(file.name);
            std::fs::File::create_new(&path)
                .and_then(|mut target| target.write_all(file.bytes))
                .map_err(|cause| ConfigError::Unwritable { file: name(&path), cause })?;
        }
        Ok(())
    }

    fn assemble(read: impl Fn(&EmbeddedFile) -> Result<Contents, ConfigError>) -> Result<Self, ConfigError> {
        let text = |file| {
            let (name, bytes) = read(file)?;
            match String::from_utf8(bytes.into_owned()) {
                Ok(text) => Ok((name, text)),
                Err(e) => Err(ConfigError::NotText { file: name, offset: e.utf8_error().valid_up_to() }),
            }
        };
        let (urdf_name, urdf) = text(&URDF)?;
        let model = Model::from_urdf(&urdf).map_err(|cause| ConfigError::Urdf { file: urdf_name, cause })?;
        let (robot_name, robot) = text(&ROBOT)?;
        let robot = RobotSettings::read(&robot_name, &robot)?;
        check_agreement(&robot_name, &robot.limits, model.rated_limits())?;
        let (name, planner) = text(&PLANNER)?;
        let planner = PlannerSettings::read(&name, &planner)?;
        let (name, daemon) = text(&DAEMON)?;
        let daemon = DaemonSettings::read(&name, &daemon, &robot)?;
        let (name, plant) = text(&PLANT)?;
        let plant = PlantSettings::read(&name, &plant, &robot)?;
        let (name, grid) = text(&GRID)?;
        let grid = GridSettings::read(&name, &grid, &robot)?;
        let (origin, bytes) = read(&DATABASE)?;
        let database = DatabaseFile { bytes, origin };
        Ok(Self { urdf, model, robot, planner, daemon, plant, grid, database })
    }

    /// Replaces the grid by that of a file.
    ///
    /// # Errors
    /// The file is unreadable, malformed, or holds a value that cannot be.
    pub fn use_grid(&mut self, path: &Path) -> Result<(), ConfigError> {
        let file = path.display().to_string();
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(cause) => return Err(ConfigError::Unreadable { file, cause }),
        };
        self.grid = GridSettings::read(&file, &text, &self.robot)?;
        Ok(())
    }

    /// Replaces the grid by the paper's 4 x 4 x 4 x 4 poses.
    ///
    /// # Errors
    /// The limits of the settings are too narrow for it.
    pub fn use_paper_grid(&mut self) -> Result<(), ConfigError> {
        let file = format!("embedded {}", PAPER_GRID.name);
        self.grid = GridSettings::read(&file, &String::from_utf8_lossy(PAPER_GRID.bytes), &self.robot)?;
        Ok(())
    }
}

/// Table II stands in `robot.toml` and, for other programs, in the URDF: both must say the same.
fn check_agreement(file: &str, toml: &Limits, urdf: &Limits) -> Result<(), ConfigError> {
    let agree = |key: &str, joint: usize, toml: f64, urdf: f64| {
        // The tolerance lets a URDF round its angles. Written so that NaN disagrees.
        if (toml - urdf).abs() <= 1e-4 {
            return Ok(());
        }
        let expected = format!("the {urdf} of joint {} in {}", joint + 1, URDF.name);
        Err(Check { file }.refuse(key, expected, toml, "change both files alike"))
    };
    for i in 0..NQ {
        agree("limits.q_deg", i, degrees(toml.q_max[i]), degrees(urdf.q_max[i]))?;
        agree("limits.q_deg", i, degrees(toml.q_min[i]), degrees(urdf.q_min[i]))?;
        agree("limits.qd_deg_s", i, degrees(toml.qd_max[i]), degrees(urdf.qd_max[i]))?;
    }
    for i in 0..NU {
        agree("limits.tau_nm", i, toml.tau_max[i], urdf.tau_max[i])?;
    }
    Ok(())
}

/// Names of all files of a full set, for messages.
fn file_names() -> String {
    FILES.map(|file| file.name).join(", ")
}
