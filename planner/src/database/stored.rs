//! Source of a trajectory database: shipped with the embedded settings, in a folder of settings, or a file.

use super::BuildError;
use std::borrow::Cow;
use std::path::Path;
use upswing_config::{Config, ConfigError, System};
use upswing_trajectory::Database;
use xxhash_rust::xxh3::xxh3_64;

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

/// Encoded database that is shipped with a system for the manoeuvre `name`.
fn shipped(system: &System, name: &str) -> Option<&'static [u8]> {
    let System::Shipped(system) = system else { return None };
    let database = SHIPPED.iter().find(|(of, manoeuvre, _)| *of == system.name() && *manoeuvre == name);
    database.map(|(.., bytes)| *bytes)
}

/// Encoded trajectory database and its origin.
#[derive(Clone, Debug)]
pub struct DatabaseFile {
    /// Contents of the file.
    pub bytes: Cow<'static, [u8]>,
    /// Path or name of the source, for messages.
    pub origin: String,
}

impl DatabaseFile {
    /// Name of the database of manoeuvre number `manoeuvre` in a folder of settings.
    pub fn name(config: &Config, manoeuvre: usize) -> String {
        format!("{}.bin", config.manoeuvres[manoeuvre].name)
    }

    /// Reads the database of manoeuvre number `manoeuvre` in the folder of the settings; the shipped database for the embedded
    /// settings. `None` if there is none, as for a manoeuvre that reverses another one.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] if there is one that cannot be read.
    pub fn of(config: &Config, manoeuvre: usize) -> Result<Option<Self>, ConfigError> {
        if config.manoeuvres[manoeuvre].reverses.is_some() {
            return Ok(None);
        }
        let shipped = shipped(config.system(), &config.manoeuvres[manoeuvre].name);
        let file = config.optional_file(&Self::name(config, manoeuvre), shipped)?;
        Ok(file.map(|(origin, bytes)| Self { bytes, origin }))
    }

    /// Reads the database in the file at `path`.
    ///
    /// # Errors
    /// [`BuildError::File`] if the file cannot be read.
    pub fn read(path: &Path) -> Result<Self, BuildError> {
        let bytes = upswing_config::read_file(path).map_err(|cause| BuildError::File {
            action: "read",
            path: path.to_owned(),
            cause,
        })?;
        Ok(Self { bytes: Cow::Owned(bytes), origin: path.display().to_string() })
    }

    /// Decodes the database.
    ///
    /// # Errors
    /// [`BuildError::Database`]
    pub fn decode(&self) -> Result<Database, BuildError> {
        Database::decode(&self.bytes)
            .map_err(|cause| BuildError::Database { origin: self.origin.clone(), cause })
    }

    /// XXH3 hash of the contents, 16 hexadecimal digits.
    pub fn fingerprint(&self) -> String {
        format!("{:016x}", xxh3_64(&self.bytes))
    }
}
