//! Source of a trajectory database: shipped with the embedded settings, in a folder of settings, or a file.

use super::BuildError;
use std::borrow::Cow;
use std::path::Path;
use upswing_config::{Config, ConfigError, DATABASE};
use upswing_trajectory::Database;
use xxhash_rust::xxh3::xxh3_64;

/// Encoded database that is shipped with the embedded settings.
pub const SHIPPED: &[u8] = include_bytes!("../../../config/database.bin");

/// Encoded trajectory database and its origin.
#[derive(Clone, Debug)]
pub struct DatabaseFile {
    /// Contents of the file.
    pub bytes: Cow<'static, [u8]>,
    /// Path or name of the source, for messages.
    pub origin: String,
}

impl DatabaseFile {
    /// Reads the database in the folder of the settings; the shipped database for the embedded settings.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] if the folder has no readable database.
    pub fn of(config: &Config) -> Result<Self, ConfigError> {
        let (origin, bytes) = config.file(DATABASE, SHIPPED)?;
        Ok(Self { bytes, origin })
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
