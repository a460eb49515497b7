//! Settings and robot description of upswing: read, checked once, then plain SI numbers.
//!
//! A full set of files is embedded in the program ([`Config::files`]) and can be exported to a folder for
//! editing: the robot (`robot.urdf`), its limits and the target (`robot.toml`), the planner, the daemon, the
//! simulated plant, the trajectory database, and scenarios for the plant ([`Config::use_scenario`]). In the files angles may be in degrees (the key then says so);
//! past this crate everything is rad, s, N m, kg, m, and no value needs another check.

mod check;
mod daemon;
mod error;
mod fault;
mod grid;
mod planner;
mod plant;
mod robot;
mod scenario;

pub use daemon::{
    CycleSettings, DaemonSettings, DisturbanceSettings, HoldGains, Level, Levels, PlanSettings,
    PlanWhileTracking, RealtimeMode, RealtimeSettings, RecorderSettings, RecoverySettings,
    StandstillSettings, StartTolerance, VelocityEstimate,
};
pub use error::ConfigError;
pub use fault::{EventError, Fault, FaultKind, Push};
pub use grid::{GridAxis, GridSettings};
pub use planner::{
    BalanceWeights, LqrWeights, OfflineSettings, PlannerSettings, QpBackend, ReplanSettings, ReplanWeights,
    SUB_HORIZONS, TorqueConstraint,
};
pub use plant::{
    DriveSettings, EncoderSettings, FrictionSettings, MAX_DELAY, ModelSettings, PendulumStart, PlantSettings,
    PlantStart, StopSettings,
};
pub use robot::{CoriolisBound, JointFriction, RobotSettings, Target};

use check::{Check, degrees};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use upswing_model::{
    ActuatedVector, Limits, Model, NQ, NU, StartError, State, UnactuatedVector, Urdf, Workspace,
};
use upswing_trajectory::{LoopDelays, PlanCriteria};

/// One complete, checked set of settings.
#[derive(Clone, Debug)]
pub struct Config {
    /// Text of the robot description.
    pub urdf: String,
    /// The robot read from it, with the rotors of `robot`; its rated limits agree with `robot.limits`.
    pub model: Model,
    /// Limits and target.
    pub robot: RobotSettings,
    /// The planner.
    pub planner: PlannerSettings,
    /// The control daemon.
    pub daemon: DaemonSettings,
    /// The simulated plant.
    pub plant: PlantSettings,
    /// The bodies that move in the simulated plant, as their URDF describes them; [`ModelSettings::apply`] changes them.
    pub plant_model: Model,
    /// Start poses of the database.
    pub grid: GridSettings,
    /// Where the files come from; None: embedded.
    dir: Option<PathBuf>,
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
/// Name of the trajectory database in a folder of settings; the planner reads it.
pub const DATABASE: &str = "database.bin";
/// Not read with a set of settings unless the plant asks for it: the second model of the arm.
const SECOND_URDF: EmbeddedFile = embedded!("robot-acin.urdf");
const FILES: [EmbeddedFile; 8] = [URDF, ROBOT, PLANNER, DAEMON, PLANT, GRID, PAPER_GRID, SECOND_URDF];
/// Read only when one is asked for.
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

/// The name that messages give a file, and its contents.
pub type Contents = (String, Cow<'static, [u8]>);

impl Config {
    /// The settings that the program was built with.
    ///
    /// # Errors
    /// None in a released program: its tests load them.
    pub fn embedded() -> Result<Self, ConfigError> {
        Self::assemble(None)
    }

    /// The settings in a folder, which must hold all files of a full set.
    ///
    /// # Errors
    /// A file is missing, unreadable, malformed, or holds a value the system cannot work with.
    pub fn from_dir(dir: &Path) -> Result<Self, ConfigError> {
        Self::assemble(Some(dir))
    }

    /// The settings in a folder, or the embedded ones if none is named.
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

    /// The embedded files with their comments: path below a folder of settings, and contents.
    pub fn files() -> impl Iterator<Item = (&'static str, &'static [u8])> {
        FILES.iter().chain(&SCENARIOS).map(|file| (file.name, file.bytes))
    }

    /// The state at standstill with the arm at `q_a` (7 angles, rad) and the pendulum as `pendulum` says.
    ///
    /// # Errors
    /// As [`Model::standstill`], for the limits open to plans.
    pub fn start_state(&self, q_a: &[f64], pendulum: PendulumStart) -> Result<State, StartError> {
        self.start_state_of(&self.model, q_a, pendulum)
    }

    /// As [`Config::start_state`] for another `model`, whose pendulum may hang differently.
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
            PendulumStart::Zero => Some(UnactuatedVector::zeros()),
        };
        model.standstill(&self.robot.planning, q_a, q_u.as_ref())
    }

    fn assemble(dir: Option<&Path>) -> Result<Self, ConfigError> {
        let text = |file| text_of(dir, file);
        let (urdf_name, urdf) = text(&URDF)?;
        let model = read_model(&urdf_name, &urdf)?;
        let (robot_name, robot) = text(&ROBOT)?;
        let robot = RobotSettings::read(&robot_name, &robot)?;
        check_agreement(&robot_name, &robot.limits, &urdf_name, &model)?;
        let model = model.with_rotors(robot.rotor_inertia);
        check_target(&robot_name, &robot.target, &model)?;
        let (name, planner) = text(&PLANNER)?;
        let planner = PlannerSettings::read(&name, &planner)?;
        let (name, daemon) = text(&DAEMON)?;
        let daemon = DaemonSettings::read(&name, &daemon, &robot)?;
        let (name, plant) = text(&PLANT)?;
        let plant = PlantSettings::read(&name, &plant, &robot)?;
        let plant_model = read_plant_model(dir, &name, &plant.model.urdf)?;
        let (name, grid) = text(&GRID)?;
        let grid = GridSettings::read(&name, &grid, &robot)?;
        let dir = dir.map(Path::to_owned);
        Ok(Self { urdf, model, robot, planner, daemon, plant, plant_model, grid, dir })
    }

    /// Replaces the plant's settings by those of `plant.toml` under a scenario: one of the set by its name, or a file by
    /// its path, which ends in `.toml`. Returns the scenario's purpose, a sentence.
    ///
    /// # Errors
    /// There is no such scenario, or it is unreadable, malformed, or holds a value that cannot be.
    pub fn use_scenario(&mut self, scenario: &str) -> Result<String, ConfigError> {
        let dir = self.dir.as_deref();
        let (file, text) = if scenario.ends_with(".toml") {
            text_of_path(Path::new(scenario))?
        } else {
            let of_set = SCENARIOS.iter().find(|file| scenario_name(file) == scenario);
            text_of(dir, of_set.ok_or_else(|| ConfigError::NoScenario { got: scenario.into() })?)?
        };
        let (_, base) = text_of(dir, &PLANT)?;
        let (plant, purpose) = scenario::read(&file, &text, &base, &self.robot)?;
        self.plant_model = read_plant_model(dir, &file, &plant.model.urdf)?;
        self.plant = plant;
        Ok(purpose)
    }

    /// Names and texts of the settings files, for whoever keeps them with results: all but scenarios and database.
    ///
    /// # Errors
    /// A file has become unreadable since it was loaded.
    pub fn texts(&self) -> Result<Vec<(&'static str, String)>, ConfigError> {
        let files = [&URDF, &ROBOT, &PLANNER, &DAEMON, &PLANT, &GRID];
        files.iter().map(|file| Ok((file.name, text_of(self.dir.as_deref(), file)?.1))).collect()
    }

    /// Names of the scenarios of the set.
    pub fn scenario_names() -> impl Iterator<Item = &'static str> {
        SCENARIOS.iter().map(scenario_name)
    }

    /// A file that belongs to the settings but is not read with them: where it comes from, for messages, and its contents. That of the
    /// settings' folder, or, of the embedded settings, `embedded`.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`]
    pub fn file(&self, name: &'static str, embedded: &'static [u8]) -> Result<Contents, ConfigError> {
        contents(self.dir.as_deref(), &EmbeddedFile { name, bytes: embedded })
    }

    /// Replaces the grid by that of a file.
    ///
    /// # Errors
    /// The file is unreadable, malformed, or holds a value that cannot be.
    pub fn use_grid(&mut self, path: &Path) -> Result<(), ConfigError> {
        let (file, text) = text_of_path(path)?;
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

const SCENARIO_FOLDER: &str = "scenarios";

fn scenario_name(file: &EmbeddedFile) -> &'static str {
    file.name.trim_start_matches(SCENARIO_FOLDER).trim_start_matches('/').trim_end_matches(".toml")
}

/// The bytes of a regular file. Anything else in its place (a pipe, a device) is refused: it could block for good, or never
/// end.
///
/// # Errors
/// Of the operating system.
pub fn read_file(path: &Path) -> std::io::Result<Vec<u8>> {
    check_regular(path)?;
    std::fs::read(path)
}

/// A regular file, open for reading; anything else is refused as by [`read_file`].
///
/// # Errors
/// Of the operating system.
pub fn open_file(path: &Path) -> std::io::Result<std::fs::File> {
    check_regular(path)?;
    std::fs::File::open(path)
}

/// Whether what is at a path, if anything, may be opened as a file: a directory, pipe or device may not.
///
/// # Errors
/// Of the operating system.
pub fn check_regular(path: &Path) -> std::io::Result<()> {
    match path.metadata() {
        Ok(state) if state.is_dir() => Err(std::io::ErrorKind::IsADirectory.into()),
        Ok(state) if !state.is_file() => Err(std::io::Error::other("it is not a regular file")),
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

/// One file of a set: of the folder, or the embedded one.
fn contents(dir: Option<&Path>, file: &EmbeddedFile) -> Result<Contents, ConfigError> {
    match dir {
        None => Ok((format!("embedded {}", file.name), Cow::Borrowed(file.bytes))),
        Some(dir) => {
            let path = dir.join(file.name);
            let name = path.display().to_string();
            match read_file(&path) {
                Ok(bytes) => Ok((name, Cow::Owned(bytes))),
                Err(cause) => Err(ConfigError::Unreadable { file: name, cause }),
            }
        }
    }
}

/// Name and text of a file of a set.
fn text_of(dir: Option<&Path>, file: &EmbeddedFile) -> Result<(String, String), ConfigError> {
    let (name, bytes) = contents(dir, file)?;
    as_text(name, bytes.into_owned())
}

/// Name and text of a file that is of no set.
fn text_of_path(path: &Path) -> Result<(String, String), ConfigError> {
    let name = path.display().to_string();
    match read_file(path) {
        Ok(bytes) => as_text(name, bytes),
        Err(cause) => Err(ConfigError::NoFile { file: name, cause }),
    }
}

fn as_text(file: String, bytes: Vec<u8>) -> Result<(String, String), ConfigError> {
    match String::from_utf8(bytes) {
        Ok(text) => Ok((file, text)),
        Err(e) => Err(ConfigError::NotText { file, offset: e.utf8_error().valid_up_to() }),
    }
}

/// The plant's bodies from the URDF that the settings in `file` name.
fn read_plant_model(dir: Option<&Path>, file: &str, urdf: &str) -> Result<Model, ConfigError> {
    let of_set = FILES.iter().find(|file| file.name == urdf && urdf.ends_with(".urdf"));
    let (name, text) = match of_set {
        Some(of_set) => text_of(dir, of_set)?,
        None if urdf.contains('/') => text_of_path(Path::new(urdf))?,
        None => {
            let expected = format!("{}, {}, or a path with a `/`", URDF.name, SECOND_URDF.name);
            return Err(Check { file }.refuse(
                "model.urdf",
                expected,
                urdf,
                "name a file of the set or a path",
            ));
        }
    };
    if urdf == URDF.name {
        // What is left out of it has been told.
        return Model::from_urdf(&text).map_err(|cause| ConfigError::Urdf { file: name, cause });
    }
    read_model(&name, &text)
}

/// Refuses a target (8) in which the pendulum would not stay: no trajectory can end there at rest.
fn check_target(file: &str, target: &Target, model: &Model) -> Result<(), ConfigError> {
    /// Acceleration that counts as none, rad/s^2: far below what bearings hold, far above rounding.
    const NONE: f64 = 1e-3;
    let mut work = Workspace::default();
    // (8) fixes q2 - q4 + q6 only: whichever joint turns the flange, the pendulum has to stay.
    for (joint, sign) in [(1, 1.0), (3, -1.0), (5, 1.0)] {
        let mut x = State::zeros();
        (x[joint], x[NU]) = (sign * target.pitch, target.q8);
        let f = model.f(&x, &ActuatedVector::zeros(), &mut work);
        let falling = (NU..NQ).find(|i| !(f[NQ + i].abs() <= NONE));
        if let Some(i) = falling {
            let (pitch, q8) = (target.pitch.to_degrees(), target.q8.to_degrees());
            return Err(Check { file }.refuse(
                "target.pitch_deg",
                "with target.q8_deg an equilibrium of the pendulum",
                format!(
                    "{pitch:.2} with q8_deg {q8:.2}, where joint {} at rest accelerates with {:.3} rad/s^2",
                    i + 1,
                    f[NQ + i]
                ),
                "make axis 8 horizontal and the rod vertical; the shipped robot has 90 and 180",
            ));
        }
    }
    Ok(())
}

/// The robot of the URDF `file`; what was left out of it goes to the log.
fn read_model(file: &str, text: &str) -> Result<Model, ConfigError> {
    let refuse = |cause| ConfigError::Urdf { file: file.into(), cause };
    let urdf = Urdf::read(text).map_err(refuse)?;
    for warning in &urdf.warnings {
        tracing::warn!("{file}: {warning}");
    }
    Model::from_description(&urdf).map_err(refuse)
}

/// Table II stands in `robot.toml` and, for other programs, in the URDF: both must say the same. A joint that turns without limit
/// there has the limit of `robot.toml`.
fn check_agreement(file: &str, toml: &Limits, urdf_file: &str, model: &Model) -> Result<(), ConfigError> {
    /// Lets a URDF round its angles; deg, deg/s, N m.
    const ROUNDING: f64 = 1e-4;
    let urdf = model.rated_limits();
    for (i, name) in model.joint_names().iter().enumerate() {
        let (low, high) = (degrees(urdf.q_min[i]), degrees(urdf.q_max[i]));
        // Written so that two infinite ends are symmetric.
        if (low + high).abs() > ROUNDING {
            return Err(ConfigError::Asymmetric { file: urdf_file.into(), joint: (*name).into(), low, high });
        }
    }
    let agree = |key: &str, joint: usize, toml: f64, urdf: f64| {
        // Written so that NaN disagrees.
        if (toml - urdf).abs() <= ROUNDING || urdf.is_infinite() {
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
    let mut names = FILES.map(|file| file.name).to_vec();
    names.push(DATABASE);
    names.join(", ")
}
