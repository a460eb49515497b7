//! Systems: the folders of the shipped ones, embedded in the program, and folders of the user.

use crate::file::{TextFile, read_file};
use crate::{ConfigError, Contents};
use std::borrow::Cow;
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A robot with its settings and manoeuvres: the name of a shipped one, or the folder of its files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum System {
    /// A system whose files are embedded in the program.
    Shipped(&'static ShippedSystem),
    /// A folder.
    Folder(PathBuf),
}

/// A system whose files are embedded in the program.
#[derive(PartialEq, Eq)]
pub struct ShippedSystem {
    name: &'static str,
    files: &'static [(&'static str, &'static [u8])],
}

/// Embeds the files of the folder `systems`. A list and not the whole folder: a file that is added to a folder does not make cargo build
/// its crate again, and databases are embedded by the planner. A test compares the list with the folder.
macro_rules! shipped {
    ($($system:literal: $($file:literal)+;)+) => {
        &[$(ShippedSystem {
            name: $system,
            files: &[$(($file, include_bytes!(concat!("../systems/", $system, "/", $file)))),+],
        }),+]
    };
}

/// The shipped systems; the first one is the default.
static SHIPPED: &[ShippedSystem] = shipped! {
    "iiwa-pendulum": "robot.urdf" "robot.toml" "manoeuvres.toml" "daemon.toml" "plant.toml" "robot-acin.urdf" "grid-paper.toml"
        "scenarios/arm-friction.toml" "scenarios/coarse-encoders.toml" "scenarios/dead-encoder.toml" "scenarios/everyday.toml"
        "scenarios/heavy-arm.toml" "scenarios/joint-stops.toml" "scenarios/late-brakes.toml" "scenarios/long-rod.toml"
        "scenarios/lost-packets.toml" "scenarios/payload.toml" "scenarios/push.toml" "scenarios/rotor-inertia.toml"
        "scenarios/second-arm.toml" "scenarios/slow-drives.toml" "scenarios/torque-offset.toml" "scenarios/worn-bearings.toml";
    "franka-pendulum": "robot.urdf" "robot.toml" "manoeuvres.toml" "plant.toml" "scenarios/everyday.toml";
    "ur5e-pendulum": "robot.urdf" "robot.toml" "manoeuvres.toml" "plant.toml" "scenarios/everyday.toml";
    "kr3-single": "robot.urdf" "robot.toml" "manoeuvres.toml" "plant.toml" "scenarios/everyday.toml";
    "gantry-crane": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "cart-pole": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "cart-double": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "cart-triple": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "xy-spherical": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "furuta": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "acrobot": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
    "pendubot": "robot.urdf" "robot.toml" "manoeuvres.toml" "planner.toml" "daemon.toml" "plant.toml" "scenarios/everyday.toml";
};

/// Folder of the scenarios in that of a system.
const SCENARIOS: &str = "scenarios";

impl fmt::Debug for ShippedSystem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl ShippedSystem {
    /// The system as an option names it.
    pub fn name(&self) -> &'static str {
        self.name
    }
}

/// A text that is neither the name of a shipped system nor a folder.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected the folder of a system or one of {}, got `{got}`",
    System::shipped().map(|system| system.name).collect::<Vec<_>>().join(", ")
)]
pub struct UnknownSystem {
    /// The text.
    pub got: String,
}

impl Default for System {
    fn default() -> Self {
        Self::Shipped(&SHIPPED[0])
    }
}

/// The shipped system of this name, else the folder with this path: one with a `/`, or one that exists.
impl TryFrom<OsString> for System {
    type Error = UnknownSystem;

    fn try_from(text: OsString) -> Result<Self, UnknownSystem> {
        if let Some(system) = Self::shipped().find(|system| text == system.name) {
            return Ok(Self::Shipped(system));
        }
        let path = PathBuf::from(text);
        if path.as_os_str().as_encoded_bytes().contains(&b'/') || path.is_dir() {
            return Ok(Self::Folder(path));
        }
        Err(UnknownSystem { got: path.display().to_string() })
    }
}

impl FromStr for System {
    type Err = UnknownSystem;

    fn from_str(text: &str) -> Result<Self, UnknownSystem> {
        OsString::from(text).try_into()
    }
}

impl fmt::Display for System {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.option().to_string_lossy())
    }
}

impl System {
    /// The shipped systems; the first one is the default.
    pub fn shipped() -> impl Iterator<Item = &'static ShippedSystem> {
        SHIPPED.iter()
    }

    /// The text of an option from which [`System::try_from`] makes the system.
    pub fn option(&self) -> OsString {
        match self {
            Self::Shipped(system) => system.name.into(),
            // Not to be taken for the name of a shipped system.
            Self::Folder(path) if path.components().count() == 1 => Path::new(".").join(path).into(),
            Self::Folder(path) => path.into(),
        }
    }

    /// A file in the folder of the system: its name in messages, and its contents; `None` if there is none.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] if the file exists but cannot be read.
    pub(crate) fn file(&self, name: &str) -> Result<Option<Contents>, ConfigError> {
        let label = self.label(name);
        match self {
            Self::Shipped(system) => {
                let file = system.files.iter().find(|(of_system, _)| *of_system == name);
                Ok(file.map(|(_, bytes)| (label, Cow::Borrowed(*bytes))))
            }
            Self::Folder(dir) => match read_file(&dir.join(name)) {
                Ok(bytes) => Ok(Some((label, Cow::Owned(bytes)))),
                Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => Ok(None),
                Err(cause) => Err(ConfigError::Unreadable { file: label, cause }),
            },
        }
    }

    /// The text of a file that every system has.
    pub(crate) fn text(&self, name: &str) -> Result<TextFile, ConfigError> {
        let missing =
            || ConfigError::Unreadable { file: self.label(name), cause: std::io::ErrorKind::NotFound.into() };
        let (name, bytes) = self.file(name)?.ok_or_else(missing)?;
        TextFile::new(name, bytes.into_owned())
    }

    /// The text of a file; empty if the system does not have it.
    pub(crate) fn text_or_empty(&self, name: &str) -> Result<TextFile, ConfigError> {
        let (name, bytes) = self.file(name)?.unwrap_or_else(|| (self.label(name), Cow::Borrowed(&[])));
        TextFile::new(name, bytes.into_owned())
    }

    /// Name of a file in messages.
    fn label(&self, name: &str) -> String {
        match self {
            Self::Shipped(system) => format!("embedded {}/{name}", system.name),
            Self::Folder(dir) => dir.join(name).display().to_string(),
        }
    }

    /// Names of the files with this extension in the folder of the system, or in its `subfolder`, sorted; those of a folder that cannot be
    /// read are none.
    fn names(&self, subfolder: &str, extension: &str) -> Vec<String> {
        let is_one = |path: &Path| path.extension().is_some_and(|e| e == extension);
        let mut names: Vec<_> = match self {
            Self::Shipped(system) => {
                let paths = system.files.iter().map(|(name, _)| Path::new(name));
                let inside = paths.filter(|path| path.parent() == Some(Path::new(subfolder)) && is_one(path));
                inside.filter_map(Path::file_name).map(|name| name.to_string_lossy().into_owned()).collect()
            }
            Self::Folder(dir) => {
                let entries = std::fs::read_dir(dir.join(subfolder)).into_iter().flatten().flatten();
                let inside = entries.filter(|entry| is_one(&entry.path()));
                inside.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
            }
        };
        names.sort();
        names
    }

    /// Names of the robot descriptions in the folder.
    pub(crate) fn urdfs(&self) -> Vec<String> {
        self.names("", "urdf")
    }

    /// Names of the scenarios, sorted.
    pub fn scenarios(&self) -> Vec<String> {
        let mut names = self.names(SCENARIOS, "toml");
        names.iter_mut().for_each(|name| name.truncate(name.len() - ".toml".len()));
        names
    }

    /// The text of a scenario.
    pub(crate) fn scenario(&self, name: &str) -> Result<TextFile, ConfigError> {
        if !self.scenarios().iter().any(|of_system| of_system == name) {
            return Err(ConfigError::NoScenario { names: self.scenarios(), got: name.into() });
        }
        self.text(&format!("{SCENARIOS}/{name}.toml"))
    }

    /// Paths, relative to the folder of the system, of its files that are not settings with defaults: robot descriptions, manoeuvres,
    /// grids, scenarios.
    pub(crate) fn other_files(&self) -> Vec<String> {
        let scenarios = self.scenarios();
        let scenarios = scenarios.iter().map(|name| format!("{SCENARIOS}/{name}.toml"));
        let plain = |name: &String| !crate::DEFAULTS.iter().any(|defaults| defaults.name == name);
        let of_folder = self.urdfs().into_iter().chain(self.names("", "toml").into_iter().filter(plain));
        of_folder.chain(scenarios).collect()
    }
}
