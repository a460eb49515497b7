//! Settings and robot description of upswing: read from files, checked once, converted to SI units.
//!
//! A full set of files is embedded in the program ([`Config::files`]) and can be exported to a folder for editing: the robot
//! (`robot.urdf`), its limits and the target (`robot.toml`), the planner, the daemon, the simulated plant, the grid of the trajectory
//! database, and scenarios for the plant ([`Config::use_scenario`]). Keys of settings in other than SI units name the unit (`_deg`,
//! `_ms`); outside this crate all settings are in rad, s, N m, kg, m, and need no further check.
//! Values per joint are stated by the names of the joints in the URDF, and become vectors of the model. Keys name the units of joints that
//! turn; for prismatic joints a key in degrees has a counterpart in m (`q_deg`, `q_m`), and in other keys rad is m, and N m is N.

mod conflict;
mod daemon;
mod error;
mod fault;
mod file;
mod grid;
mod joints;
mod manoeuvre;
mod planner;
mod plant;
mod robot;
mod rule;
mod scenario;

pub use daemon::{
    CycleSettings, DaemonSettings, DisturbanceSettings, HoldGains, Level, Levels, PlanSettings,
    PlanWhileTracking, RealtimeMode, RealtimeSettings, RecorderSettings, RecoverySettings,
    StandstillSettings, StartTolerance, StopSettings, VelocityEstimate,
};
pub use error::ConfigError;
pub use fault::{EventError, Fault, FaultError, FaultJointError, FaultKind, Push};
pub use file::{check_regular, open_file, read_file};
pub use grid::{GridAxis, GridSettings};
pub use manoeuvre::{GivenError, Manoeuvre, TargetRow, TargetValue};
pub use planner::{
    BalanceSettings, LqrSettings, OfflineSettings, PlannerSettings, QpBackend, ReplanSettings, SUB_HORIZONS,
    TorqueForm,
};
pub use plant::{
    DriveSettings, EncoderSettings, FrictionSettings, IntegratorSettings, JointStopSettings, MAX_DELAY,
    ModelSettings, PendulumStart, PlantSettings, PlantStart,
};
pub use robot::{CoriolisBound, RobotSettings, Target};

use conflict::SettingsConflict;
use file::{EmbeddedFile, TextFile};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use upswing_model::{JointKind, Model, Posture, StartError, State, UnactuatedVector, Urdf};
use upswing_trajectory::{LoopDelays, PlanCriteria};

/// One complete, checked set of settings.
#[derive(Clone, Debug)]
pub struct Config {
    /// Text of the robot description.
    pub urdf: String,
    /// The robot read from it, with the rotors of `robot`; its rated limits agree with `robot.limits`.
    pub model: Model,
    /// Limits and drives of the robot, and the target of the swing-up.
    pub robot: RobotSettings,
    /// Settings of the planner.
    pub planner: PlannerSettings,
    /// Settings of the control daemon.
    pub daemon: DaemonSettings,
    /// Settings of the simulated plant.
    pub plant: PlantSettings,
    /// The bodies of the simulated plant as their URDF describes them, without the differences of `plant.model`.
    pub plant_model: Model,
    /// Grid of the start poses of the trajectory database.
    pub grid: GridSettings,
    /// Manoeuvres, in the order of their file; the first one is that of the demo.
    pub manoeuvres: Vec<Manoeuvre>,
    /// Folder of the files; `None`: embedded.
    dir: Option<PathBuf>,
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
const MANOEUVRES: EmbeddedFile = embedded!("manoeuvres.toml");
const GRID: EmbeddedFile = embedded!("grid.toml");
/// The paper's grid of start poses, read only by [`Config::use_paper_grid`].
const PAPER_GRID: EmbeddedFile = embedded!("grid-paper.toml");
/// File name of the trajectory database in a folder of settings; read by the planner.
pub const DATABASE: &str = "database.bin";
/// The second model of the arm, read only if `model.urdf` of the plant's settings names it.
const SECOND_URDF: EmbeddedFile = embedded!("robot-acin.urdf");
const FILES: [EmbeddedFile; 9] =
    [URDF, ROBOT, MANOEUVRES, PLANNER, DAEMON, PLANT, GRID, PAPER_GRID, SECOND_URDF];
/// The scenarios of the set, read only by [`Config::use_scenario`].
const SCENARIOS: [EmbeddedFile; 16] = [
    embedded!("scenarios/arm-friction.toml"),
    embedded!("scenarios/coarse-encoders.toml"),
    embedded!("scenarios/dead-encoder.toml"),
    embedded!("scenarios/everyday.toml"),
    embedded!("scenarios/heavy-arm.toml"),
    embedded!("scenarios/joint-stops.toml"),
    embedded!("scenarios/late-brakes.toml"),
    embedded!("scenarios/long-rod.toml"),
    embedded!("scenarios/lost-packets.toml"),
    embedded!("scenarios/payload.toml"),
    embedded!("scenarios/push.toml"),
    embedded!("scenarios/rotor-inertia.toml"),
    embedded!("scenarios/second-arm.toml"),
    embedded!("scenarios/slow-drives.toml"),
    embedded!("scenarios/torque-offset.toml"),
    embedded!("scenarios/worn-bearings.toml"),
];

/// A file: its name in messages, and its contents.
pub type Contents = (String, Cow<'static, [u8]>);

impl Config {
    /// The settings embedded in the program.
    ///
    /// # Errors
    /// None in a released program: its tests load the embedded settings.
    pub fn embedded() -> Result<Self, ConfigError> {
        Self::assemble(None)
    }

    /// The settings in a folder, which must contain all files of a full set.
    ///
    /// # Errors
    /// [`ConfigError`] if a file is missing, unreadable or malformed, or contains an invalid value.
    pub fn from_dir(dir: &Path) -> Result<Self, ConfigError> {
        Self::assemble(Some(dir))
    }

    /// The settings in the folder `dir`, or the embedded settings without a folder.
    ///
    /// # Errors
    /// As [`Config::from_dir`].
    pub fn load(dir: Option<&Path>) -> Result<Self, ConfigError> {
        dir.map_or_else(Self::embedded, Self::from_dir)
    }

    /// The criteria that a plan has to meet under these settings.
    pub fn plan_criteria(&self) -> PlanCriteria {
        let DaemonSettings { cycle, plans, start, .. } = &self.daemon;
        PlanCriteria {
            limits: self.robot.planning,
            tau_max: self.robot.limits.tau_max,
            defect: if self.planner.replan.iterations == 1 { plans.defect_of_one_qp } else { plans.defect },
            tolerance: (start.position, start.velocity),
            delays: LoopDelays {
                period: cycle.period.seconds(),
                velocity_filter: match cycle.velocity {
                    VelocityEstimate::Filter => Some(cycle.velocity_filter),
                    VelocityEstimate::Model => None,
                },
                cycles: plans.delay,
            },
        }
    }

    /// Name of the first manoeuvre that starts in a posture.
    pub fn first_manoeuvre(&self, start: Posture) -> Option<&str> {
        let first = self.manoeuvres.iter().find(|manoeuvre| manoeuvre.start == start);
        first.map(|manoeuvre| manoeuvre.name.as_str())
    }

    /// The embedded files with their comments: path relative to a folder of settings, and contents.
    pub fn files() -> impl Iterator<Item = (&'static str, &'static [u8])> {
        FILES.iter().chain(&SCENARIOS).map(|file| (file.name, file.bytes))
    }

    /// The state x at standstill with the actuated joints at `q_a` (rad or m) and the unactuated ones as given by `pendulum`.
    ///
    /// # Errors
    /// As [`Model::standstill`], for the limits open to plans.
    pub fn start_state(&self, q_a: &[f64], pendulum: PendulumStart) -> Result<State, StartError> {
        self.start_state_of(&self.model, q_a, pendulum)
    }

    /// As [`Config::start_state`] for another `model`, whose rest position of the pendulum may differ.
    ///
    /// # Errors
    /// As [`Config::start_state`].
    pub fn start_state_of(
        &self,
        model: &Model,
        q_a: &[f64],
        pendulum: PendulumStart,
    ) -> Result<State, StartError> {
        let q_u = match pendulum {
            PendulumStart::Rest => None,
            PendulumStart::Zero => Some(UnactuatedVector::zeros(model.sizes())),
        };
        model.standstill(&self.robot.planning, q_a, q_u.as_ref())
    }

    fn assemble(dir: Option<&Path>) -> Result<Self, ConfigError> {
        let urdf = URDF.text(dir)?;
        let model = read_model(&urdf)?;
        let robot: RobotSettings =
            ROBOT.text(dir)?.settings(&model, |robot: &RobotSettings| robot.validate(&model))?;
        let model = model.with_rotors(&robot.rotor_inertia);
        let manoeuvres = manoeuvre::read(&MANOEUVRES.text(dir)?, &robot, &model)?;
        let planner = PLANNER.text(dir)?.settings(&model, PlannerSettings::validate)?;
        let daemon = DAEMON.text(dir)?.settings(&model, |daemon: &DaemonSettings| daemon.validate(&robot))?;
        let file = PLANT.text(dir)?;
        let plant = file.settings(&model, |plant: &PlantSettings| plant.validate(&robot, &model))?;
        let plant_model = read_plant_model(dir, &file, &plant.model.urdf, &model)?;
        let grid = GridSettings::read(&GRID.text(dir)?, &robot, &model)?;
        let dir = dir.map(Path::to_owned);
        Ok(Self { urdf: urdf.text, model, robot, planner, daemon, plant, plant_model, grid, manoeuvres, dir })
    }

    /// Replaces the plant's settings by those of `plant.toml` under a scenario, given by its name in the set or by the path of a file
    /// that ends in `.toml`. Returns the purpose of the scenario, a sentence.
    ///
    /// # Errors
    /// [`ConfigError`] if the scenario does not exist, is unreadable or malformed, or contains an invalid value.
    pub fn use_scenario(&mut self, scenario: &str) -> Result<String, ConfigError> {
        let dir = self.dir.as_deref();
        let file = if scenario.ends_with(".toml") {
            TextFile::at(Path::new(scenario))?
        } else {
            let of_set = SCENARIOS.iter().find(|file| scenario_name(file) == scenario);
            of_set.ok_or_else(|| ConfigError::NoScenario { got: scenario.into() })?.text(dir)?
        };
        let (plant, purpose) = scenario::read(&file, &PLANT.text(dir)?, &self.robot, &self.model)?;
        self.plant_model = read_plant_model(dir, &file, &plant.model.urdf, &self.model)?;
        self.plant = plant;
        Ok(purpose)
    }

    /// Names and texts of the settings files, to be stored with results: all but scenarios and database.
    ///
    /// # Errors
    /// [`ConfigError`] if a file has become unreadable since the settings were loaded.
    pub fn texts(&self) -> Result<Vec<(&'static str, String)>, ConfigError> {
        let files = [&URDF, &ROBOT, &MANOEUVRES, &PLANNER, &DAEMON, &PLANT, &GRID];
        files.iter().map(|file| Ok((file.name, file.text(self.dir.as_deref())?.text))).collect()
    }

    /// Names of the scenarios of the set.
    pub fn scenario_names() -> impl Iterator<Item = &'static str> {
        SCENARIOS.iter().map(scenario_name)
    }

    /// Reads a further file of the settings: its name in messages and its contents, from the folder of the settings, or `embedded` for
    /// the embedded settings; `None` if there is no such file.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] if the folder has the file, but it cannot be read.
    pub fn optional_file(
        &self,
        name: &str,
        embedded: Option<&'static [u8]>,
    ) -> Result<Option<Contents>, ConfigError> {
        let Some(dir) = &self.dir else {
            return Ok(embedded.map(|bytes| (format!("embedded {name}"), Cow::Borrowed(bytes))));
        };
        let path = dir.join(name);
        match read_file(&path) {
            Ok(bytes) => Ok(Some((path.display().to_string(), Cow::Owned(bytes)))),
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(ConfigError::Unreadable { file: path.display().to_string(), cause }),
        }
    }

    /// Replaces the grid of start poses of manoeuvre number `manoeuvre` by the grid in the file at `path`.
    ///
    /// # Errors
    /// [`ConfigError`] if the file is unreadable or malformed, or contains an invalid value.
    pub fn use_grid(&mut self, manoeuvre: usize, path: &Path) -> Result<(), ConfigError> {
        self.manoeuvres[manoeuvre].grid = GridSettings::read(&TextFile::at(path)?, &self.robot, &self.model)?;
        Ok(())
    }

    /// Replaces the grid of start poses of the first manoeuvre by the paper's 4 x 4 x 4 x 4 poses.
    ///
    /// # Errors
    /// [`ConfigError`] if a pose of the paper's grid is outside the limits of the settings.
    pub fn use_paper_grid(&mut self) -> Result<(), ConfigError> {
        self.manoeuvres[0].grid = GridSettings::read(&PAPER_GRID.text(None)?, &self.robot, &self.model)?;
        Ok(())
    }
}

const SCENARIO_FOLDER: &str = "scenarios";

fn scenario_name(file: &EmbeddedFile) -> &'static str {
    file.name.trim_start_matches(SCENARIO_FOLDER).trim_start_matches('/').trim_end_matches(".toml")
}

/// Reads the robot model of a URDF; parts of the URDF that the model ignores are logged as warnings.
fn read_model(urdf: &TextFile) -> Result<Model, ConfigError> {
    let refuse = |cause| ConfigError::Urdf { file: urdf.name.clone(), cause };
    let description = Urdf::read(&urdf.text).map_err(refuse)?;
    for warning in &description.warnings {
        tracing::warn!("{}: {warning}", urdf.name);
    }
    Model::from_description(&description).map_err(refuse)
}

/// Reads the model of the simulated bodies from the URDF that the settings in `file` name; `robot` is the model of planner and daemon.
fn read_plant_model(
    dir: Option<&Path>,
    file: &TextFile,
    urdf: &str,
    robot: &Model,
) -> Result<Model, ConfigError> {
    let of_set = FILES.iter().find(|file| file.name == urdf && urdf.ends_with(".urdf"));
    let urdf_file = match of_set {
        Some(of_set) => of_set.text(dir)?,
        None if urdf.contains('/') => TextFile::at(Path::new(urdf)).map_err(|e| match e {
            ConfigError::NoFile { cause, .. } => {
                let got = format!("{urdf} ({cause})");
                file.refuse(SettingsConflict::new(
                    "model.urdf",
                    "a file that can be read",
                    got,
                    "name an existing file",
                ))
            }
            e => e,
        })?,
        None => {
            let expected = format!("{}, {}, or a path with a `/`", URDF.name, SECOND_URDF.name);
            let fix = "name a file of the set or a path";
            return Err(file.refuse(SettingsConflict::new("model.urdf", expected, urdf, fix)));
        }
    };
    if urdf == URDF.name {
        // The warnings of the robot's own URDF are logged already.
        let refuse = |cause| ConfigError::Urdf { file: urdf_file.name.clone(), cause };
        return Model::from_urdf(&urdf_file.text).map_err(refuse);
    }
    let model = read_model(&urdf_file)?;
    let [expected, got] = [robot, &model].map(kinds_of_joints);
    if expected != got {
        let expected = format!("the kinds of joints of {}, {expected}", URDF.name);
        let fix = "name a URDF whose joints can take the place of the robot's";
        return Err(file.refuse(SettingsConflict::new("model.urdf", expected, got, fix)));
    }
    Ok(model)
}

/// Kinds of the joints of a model, in the chain's order.
fn kinds_of_joints(model: &Model) -> String {
    let kind = |joint: usize| {
        let motor = if model.order().is_actuated(joint) { "actuated" } else { "unactuated" };
        let kind = match model.joint_kind(model.order().coordinate(joint)) {
            JointKind::Revolute | JointKind::Continuous => "revolute",
            JointKind::Prismatic => "prismatic",
        };
        format!("{motor} {kind}")
    };
    (0..model.sizes().joints()).map(kind).collect::<Vec<_>>().join(", ")
}

/// Names of all files of a full set, for messages.
fn file_names() -> String {
    let mut names = FILES.map(|file| file.name).to_vec();
    names.push(DATABASE);
    names.join(", ")
}
