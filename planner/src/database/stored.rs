//! Where the planner's database comes from: the shipped one, the one in a folder of settings, or a file.

use super::BuildError;
use std::borrow::Cow;
use std::path::Path;
use upswing_config::{Config, ConfigError, DATABASE};
use xxhash_rust::xxh3::xxh3_64;

/// The database that is shipped with the embedded settings, as stored.
pub const SHIPPED: &[u8] = include_bytes!("../../../config/database.bin");

/// A trajectory database as stored.
#[derive(Clone, Debug)]
pub struct DatabaseFile {
    /// Contents of the file.
    pub bytes: Cow<'static, [u8]>,
    /// Where they come from, for messages.
    pub origin: String,
}

impl DatabaseFile {
    /// The database of the settings: of their folder, or the shipped one.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`]
    pub fn of(config: &Config) -> Result<Self, ConfigError> {
        let (origin, bytes) = config.file(DATABASE, SHIPPED)?;
        Ok(Self { bytes, origin })
    }

    /// The database of a file.
    ///
    /// # Errors
    /// [`BuildError::File`]
    pub fn read(path: &Path) -> Result<Self, BuildError> {
        let bytes = upswing_config::read_file(path).map_err(|cause| BuildError::File {
            action: "read",
            path: path.to_owned(),
            cause,
        })?;
        Ok(Self { bytes: Cow::Owned(bytes), origin: path.display().to_string() })
    }

    /// Identifies the contents: XXH3, 16 hexadecimal digits.
    pub fn fingerprint(&self) -> String {
        format!("{:016x}", xxh3_64(&self.bytes))
    }
}
