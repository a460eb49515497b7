//! Source of a trajectory database: shipped with the embedded settings, in a folder of settings, or a file.

use super::BuildError;
use std::borrow::Cow;
use std::path::Path;
use upswing_config::{Config, ConfigError, System};
use upswing_trajectory::{Database, DatabaseSource};

/// Embeds databases: those of a system by the names of their manoeuvres.
macro_rules! shipped {
    ($($system:literal: $($manoeuvre:literal)+;)+) => {
        &[$($((
            $system,
            $manoeuvre,
            include_bytes!(concat!("../../../config/systems/", $system, "/", $manoeuvre, ".bin")),
        )),+),+]
    };
}

/// Encoded databases of the shipped systems: system, manoeuvre, contents.
pub static SHIPPED: &[(&str, &str, &[u8])] = shipped! {
    "iiwa-pendulum": "swing-up" "move" "carry";
    "franka-pendulum": "swing-up" "move" "carry";
    "ur5e-pendulum": "swing-up" "move" "carry";
    "kr3-single": "swing-up" "move" "carry";
    "gantry-crane": "move";
    "cart-pole": "swing-up" "move" "carry";
    "cart-double": "swing-up" "move" "carry";
    "cart-triple": "swing-up" "move" "carry";
    "xy-spherical": "swing-up" "move" "carry";
    "furuta": "swing-up" "move" "carry";
    "acrobot": "swing-up";
    "pendubot": "swing-up";
};

/// The database that is shipped with a system for the manoeuvre `name`.
fn shipped(system: &str, name: &str) -> Option<DatabaseFile> {
    let (.., bytes) = SHIPPED.iter().find(|(of, manoeuvre, _)| *of == system && *manoeuvre == name)?;
    let source = DatabaseSource::Memory(Cow::Borrowed(bytes));
    Some(DatabaseFile { source, origin: format!("embedded {system}/{name}.bin") })
}

/// A trajectory database that is not checked yet, and its origin.
#[derive(Debug)]
pub struct DatabaseFile {
    /// Contents of the file.
    pub source: DatabaseSource,
    /// Path or name of the source, for messages.
    pub origin: String,
}

impl DatabaseFile {
    /// Name of the database of manoeuvre number `manoeuvre` in a folder of settings.
    pub fn name(config: &Config, manoeuvre: usize) -> String {
        format!("{}.bin", config.manoeuvres[manoeuvre].name)
    }

    /// Opens the database of manoeuvre number `manoeuvre` in the folder of the settings; the shipped database for the embedded
    /// settings. `None` if there is none, as for a manoeuvre that reverses another one.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] if there is one that cannot be read.
    pub fn of(config: &Config, manoeuvre: usize) -> Result<Option<Self>, ConfigError> {
        if config.manoeuvres[manoeuvre].reverses.is_some() {
            return Ok(None);
        }
        match config.system() {
            System::Shipped(system) => Ok(shipped(system.name(), &config.manoeuvres[manoeuvre].name)),
            System::Folder(folder) => {
                let path = folder.join(Self::name(config, manoeuvre));
                match upswing_config::open_file(&path) {
                    Ok(file) => Ok(Some(Self::new(file, &path))),
                    Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => Ok(None),
                    Err(cause) => Err(ConfigError::Unreadable { file: path.display().to_string(), cause }),
                }
            }
        }
    }

    fn new(file: std::fs::File, path: &Path) -> Self {
        Self { source: DatabaseSource::File(file), origin: path.display().to_string() }
    }

    /// Opens the database in the file at `path`.
    ///
    /// # Errors
    /// [`BuildError::File`] if the file cannot be read.
    pub fn open(path: &Path) -> Result<Self, BuildError> {
        let failed = |cause| BuildError::File { action: "read", path: path.to_owned(), cause };
        upswing_config::open_file(path).map(|file| Self::new(file, path)).map_err(failed)
    }

    /// Fingerprint of the contents, 16 hexadecimal digits.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn fingerprint(self) -> Result<String, BuildError> {
        Ok(format!("{:016x}", self.load()?.fingerprint()))
    }

    /// Reads and checks the index of the database.
    ///
    /// # Errors
    /// [`BuildError::Database`]
    pub fn load(self) -> Result<Database, BuildError> {
        let Self { source, origin } = self;
        Database::load(source).map_err(|cause| BuildError::Database { origin, cause })
    }
}
