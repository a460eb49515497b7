//! Settings and robot description of upswing: read from files, checked once, converted to SI units.
//!
//! A [`System`] is a folder of files, embedded in the program or of the user: the robot (`robot.urdf`), its limits (`robot.toml`), its
//! manoeuvres (`manoeuvres.toml`), the planner, the daemon, the simulated plant, and scenarios for the plant ([`Config::use_scenario`]).
//! Settings have defaults, commented files in the folder `defaults`; the files of a system contain the keys that differ, and
//! [`Config::files`] gives them in full. Keys of settings in other than SI units name the unit (`_deg`, `_ms`); outside this crate all
//! settings are in rad, s, N m, kg, m, and need no further check.
//! Values per joint are stated by the names of the joints in the URDF, and become vectors of the model. Keys name the units of joints that
//! turn; for prismatic joints a key in degrees has a counterpart in m (`q_deg`, `q_m`), and in other keys rad is m, and N m is N.

mod combinations;
mod conflict;
mod daemon;
mod error;
mod fault;
mod file;
mod grid;
mod joints;
mod manoeuvre;
mod new_system;
mod overlay;
mod planner;
mod plant;
mod robot;
mod rule;
mod scenario;
mod system;

pub use daemon::{
    CycleSettings, DaemonSettings, DisturbanceSettings, HoldGains, Level, Levels, PlanSettings,
    PlanWhileTracking, RealtimeMode, RealtimeSettings, RecorderSettings, RecoverySettings,
    StandstillSettings, StartTolerance, StopSettings, VelocityEstimate,
};
pub use error::ConfigError;
pub use fault::{EventError, Fault, FaultError, FaultJointError, FaultKind, Push};
pub use file::{check_regular, open_file, read_file};
pub use grid::{GridAxis, GridSettings};
pub use manoeuvre::{GivenError, GivenOutsideLimits, Manoeuvre, TargetRow, TargetValue};
pub use new_system::{Changes, NewJoint, NewSystem};
pub use planner::{
    BalanceSettings, ContinuousSettings, LqrRecursion, LqrSettings, OfflineSettings, PlannerSettings,
    QpBackend, ReplanSettings, SUB_HORIZONS, TorqueForm,
};
pub use plant::{
    DriveSettings, EncoderSettings, FrictionSettings, IntegratorSettings, JointStopSettings, MAX_DELAY,
    ModelSettings, PendulumStart, PlantSettings, PlantStart,
};
pub use robot::{CoriolisBound, RobotSettings};
pub use system::{ShippedSystem, System, UnknownSystem};

use conflict::SettingsConflict;
use file::TextFile;
use overlay::{Defaults, Settings};
use std::borrow::Cow;
use std::path::Path;
use upswing_model::{JointKind, Limits, Model, Posture, StartError, State, UnactuatedVector, Urdf};
use upswing_trajectory::{LoopDelays, PlanCriteria};

/// One complete, checked set of settings.
#[derive(Clone, Debug)]
pub struct Config {
    /// Text of the robot description.
    pub urdf: String,
    /// The robot read from it, with the rotors and bearings of `robot`; its rated limits agree with `robot.limits`.
    pub model: Model,
    /// Limits and drives of the robot.
    pub robot: RobotSettings,
    /// Settings of the planner.
    pub planner: PlannerSettings,
    /// Settings of the control daemon.
    pub daemon: DaemonSettings,
    /// Settings of the simulated plant.
    pub plant: PlantSettings,
    /// The bodies of the simulated plant as their URDF describes them, without the differences of `plant.model`.
    pub plant_model: Model,
    /// Manoeuvres, in the order of their file; the first one is that of the demo.
    pub manoeuvres: Vec<Manoeuvre>,
    /// Where the files are.
    system: System,
}

/// Name of the robot description of a system.
const URDF: &str = "robot.urdf";
const MANOEUVRES: &str = "manoeuvres.toml";
/// The paper's grid of start poses, read only by [`Config::use_paper_grid`].
const PAPER_GRID: &str = "grid-paper.toml";

macro_rules! defaults {
    ($name:literal) => {
        Defaults { name: $name, text: include_str!(concat!("../defaults/", $name)) }
    };
}

const ROBOT: Defaults = defaults!("robot.toml");
const PLANNER: Defaults = defaults!("planner.toml");
const DAEMON: Defaults = defaults!("daemon.toml");
const PLANT: Defaults = defaults!("plant.toml");
/// The settings files that have defaults.
const DEFAULTS: [Defaults; 4] = [ROBOT, PLANNER, DAEMON, PLANT];

/// A file: its name in messages, and its contents.
pub type Contents = (String, Cow<'static, [u8]>);

impl Config {
    /// Names of the files of [`Config::texts`] that every system has.
    pub const FILES: [&'static str; 6] =
        [URDF, MANOEUVRES, ROBOT.name, PLANNER.name, DAEMON.name, PLANT.name];

    /// The settings of the default system.
    ///
    /// # Errors
    /// None in a released program: its tests load the embedded settings.
    pub fn embedded() -> Result<Self, ConfigError> {
        Self::load(&System::default())
    }

    /// The settings of the system in a folder.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn from_dir(dir: &Path) -> Result<Self, ConfigError> {
        Self::load(&System::Folder(dir.to_owned()))
    }

    /// The settings of a system.
    ///
    /// # Errors
    /// [`ConfigError`] if a file is missing, unreadable or malformed, or contains an invalid value.
    pub fn load(system: &System) -> Result<Self, ConfigError> {
        let urdf = system.text(URDF)?;
        let model = read_model(&urdf)?;
        let robot: RobotSettings = Settings::new(system.text(ROBOT.name)?, &ROBOT)
            .read(&model, |robot: &mut RobotSettings| robot.validate(&model))?;
        let model = model.with_rotors(&robot.rotor_inertia).with_friction(&robot.bearing_friction);
        let manoeuvres = manoeuvre::read(&system.text(MANOEUVRES)?, &robot, &model)?;
        let planner = Settings::new(system.text_or_empty(PLANNER.name)?, &PLANNER)
            .read(&model, |planner: &mut PlannerSettings| planner.validate(&robot))?;
        let daemon = Settings::new(system.text_or_empty(DAEMON.name)?, &DAEMON)
            .read(&model, |daemon: &mut DaemonSettings| daemon.validate(&robot))?;
        let file = Settings::new(system.text_or_empty(PLANT.name)?, &PLANT);
        let plant = file.read(&model, |plant: &mut PlantSettings| plant.finish(&robot, &model))?;
        let plant_model = read_plant_model(system, &file.file, &plant.model.urdf, &model)?;
        let system = system.clone();
        Ok(Self { urdf: urdf.text, model, robot, planner, daemon, plant, plant_model, manoeuvres, system })
    }

    /// The system of the settings.
    pub fn system(&self) -> &System {
        &self.system
    }

    /// Name of the first manoeuvre that starts in a posture.
    pub fn first_manoeuvre(&self, start: Posture) -> Option<&str> {
        let first = self.manoeuvres.iter().find(|manoeuvre| manoeuvre.start == start);
        first.map(|manoeuvre| manoeuvre.name.as_str())
    }

    /// The criteria that a plan has to meet under these settings.
    pub fn plan_criteria(&self) -> PlanCriteria {
        let DaemonSettings { cycle, plans, start, .. } = &self.daemon;
        PlanCriteria {
            limits: self.robot.planning,
            tau_max: self.robot.limits.tau_max,
            defect: if self.planner.replan.iterations == 1 { plans.defect_of_one_qp } else { plans.defect },
            tolerance: State::new(&start.position, &start.velocity),
            delays: LoopDelays {
                period: cycle.period.seconds(),
                velocity_filter: match cycle.velocity {
                    VelocityEstimate::Filter => Some(cycle.velocity_filter),
                    VelocityEstimate::Model => None,
                },
                cycles: plans.delay,
            },
            amplification: plans.amplification,
        }
    }

    /// The criteria for a plan that replaces a running one: those of [`Self::plan_criteria`], but with all of the rated velocities and torques.
    /// A disturbed motion may be faster than the share that plans may use, and a plan has to begin in the state that there is.
    pub fn replacement_criteria(&self) -> PlanCriteria {
        let Limits { qd_max, tau_max, .. } = self.robot.limits;
        let criteria = self.plan_criteria();
        PlanCriteria {
            limits: Limits { qd_max, tau_max, ..criteria.limits },
            defect: self.daemon.plans.defect_of_one_qp,
            ..criteria
        }
    }

    /// The files of the system, settings in full and with their comments: path relative to a folder, and contents. Without databases.
    ///
    /// # Errors
    /// [`ConfigError`] if a file has become unreadable since the settings were loaded.
    pub fn files(&self) -> Result<Vec<Contents>, ConfigError> {
        let mut files = Vec::new();
        for defaults in &DEFAULTS {
            files.push((defaults.name.to_owned(), Cow::Owned(self.complete(defaults)?.into_bytes())));
        }
        for name in self.system.other_files() {
            if let Some((_, bytes)) = self.system.file(&name)? {
                files.push((name, bytes));
            }
        }
        Ok(files)
    }

    /// The text of a settings file in full.
    fn complete(&self, defaults: &Defaults) -> Result<String, ConfigError> {
        let file = self.system.text_or_empty(defaults.name)?;
        overlay::complete(defaults.text, &file.text)
            .map_err(|e| file.error(e.span().map_or(0, |span| span.start), None, e.message()))
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

    /// Replaces the plant's settings by those of `plant.toml` under a scenario, given by its name in the system or by the path of a file
    /// that ends in `.toml`. Returns the purpose of the scenario, a sentence.
    ///
    /// # Errors
    /// [`ConfigError`] if the scenario does not exist, is unreadable or malformed, or contains an invalid value.
    pub fn use_scenario(&mut self, scenario: &str) -> Result<String, ConfigError> {
        let file = if scenario.ends_with(".toml") {
            TextFile::at(Path::new(scenario))?
        } else {
            self.system.scenario(scenario)?
        };
        let base = Settings::new(self.system.text_or_empty(PLANT.name)?, &PLANT);
        let (plant, purpose) = scenario::read(&file, &base, &self.robot, &self.model)?;
        self.plant_model = read_plant_model(&self.system, &file, &plant.model.urdf, &self.model)?;
        self.plant = plant;
        Ok(purpose)
    }

    /// Names and texts of the settings in full, to be stored with results: all files but grids, scenarios and databases.
    ///
    /// # Errors
    /// [`ConfigError`] if a file has become unreadable since the settings were loaded.
    pub fn texts(&self) -> Result<Vec<(String, String)>, ConfigError> {
        let mut texts = vec![(URDF.to_owned(), self.urdf.clone())];
        for name in [MANOEUVRES, &self.plant.model.urdf].into_iter().filter(|name| *name != URDF) {
            if name == MANOEUVRES || self.system.urdfs().iter().any(|urdf| urdf == name) {
                texts.push((name.to_owned(), self.system.text(name)?.text));
            }
        }
        for defaults in &DEFAULTS {
            texts.push((defaults.name.to_owned(), self.complete(defaults)?));
        }
        Ok(texts)
    }

    /// Replaces the grid of start poses of manoeuvre number `manoeuvre` by the grid in the file at `path`.
    ///
    /// # Errors
    /// [`ConfigError`] if the file is unreadable or malformed, or contains an invalid value.
    pub fn use_grid(&mut self, manoeuvre: usize, path: &Path) -> Result<(), ConfigError> {
        self.manoeuvres[manoeuvre].grid =
            manoeuvre::read_grid(&TextFile::at(path)?, &self.robot, &self.model)?;
        Ok(())
    }

    /// Replaces the grid of start poses of the first manoeuvre by the paper's 4 x 4 x 4 x 4 poses.
    ///
    /// # Errors
    /// [`ConfigError`] if the robot has other joints than the paper's, or a pose is outside the limits of the settings.
    pub fn use_paper_grid(&mut self) -> Result<(), ConfigError> {
        let file = System::default().text(PAPER_GRID)?;
        self.manoeuvres[0].grid = manoeuvre::read_grid(&file, &self.robot, &self.model)?;
        Ok(())
    }
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
    system: &System,
    file: &TextFile,
    urdf: &str,
    robot: &Model,
) -> Result<Model, ConfigError> {
    let urdf_file = if system.urdfs().iter().any(|of_system| of_system == urdf) {
        system.text(urdf)?
    } else if urdf.contains('/') {
        TextFile::at(Path::new(urdf)).map_err(|e| match e {
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
        })?
    } else {
        let expected = format!("{}, or a path with a `/`", system.urdfs().join(", "));
        let fix = "name a file of the system or a path";
        return Err(file.refuse(SettingsConflict::new("model.urdf", expected, urdf, fix)));
    };
    if urdf == URDF {
        // The warnings of the robot's own URDF are logged already.
        let refuse = |cause| ConfigError::Urdf { file: urdf_file.name.clone(), cause };
        return Model::from_urdf(&urdf_file.text).map_err(refuse);
    }
    let model = read_model(&urdf_file)?;
    let [expected, got] = [robot, &model].map(kinds_of_joints);
    if expected != got {
        let expected = format!("the kinds of joints of {URDF}, {expected}");
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
