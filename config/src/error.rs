//! Errors of settings and robot description.

use upswing_model::UrdfError;

/// Error of reading or checking settings. Each message states the file, the expected and the actual value, and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file of a system is missing or cannot be read.
    #[error(
        "{file}: cannot be read ({cause}); a system is a folder with at least robot.urdf, robot.toml and manoeuvres.toml: \
         `upswing config export DIR` writes a complete one to start from"
    )]
    Unreadable {
        /// Path of the file.
        file: String,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// A file that the user named is missing or cannot be read.
    #[error("{file}: cannot be read ({cause}): name an existing file")]
    NoFile {
        /// Path of the file.
        file: String,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// A text file is not UTF-8.
    #[error("{file}: expected UTF-8 text, got other bytes at offset {offset}: save the file as UTF-8")]
    NotText {
        /// Path of the file.
        file: String,
        /// Offset of the first byte that is not UTF-8, counted from 0.
        offset: usize,
    },
    /// A text is no TOML, a key is unknown or missing, or a value violates its rule.
    #[error(
        "{file}, line {line}, `{text}`: {}{reason}",
        .key.as_ref().map(|key| format!("{key}: ")).unwrap_or_default()
    )]
    Setting {
        /// Path of the file.
        file: String,
        /// Number of the line, counted from 1.
        line: usize,
        /// Text of the line, at most 80 characters.
        text: String,
        /// The key with its section; `None` in text that is no TOML.
        key: Option<String>,
        /// Expected value, actual value and remedy.
        reason: String,
    },
    /// A scenario does not exist.
    #[error(
        "expected the path of a scenario that ends in .toml or one of {}, got `{got}`",
        names.join(", ")
    )]
    NoScenario {
        /// Names of the scenarios of the system.
        names: Vec<String>,
        /// Name given for the scenario.
        got: String,
    },
    /// The robot description cannot be used.
    #[error("{file}: {cause}")]
    Urdf {
        /// Path of the file.
        file: String,
        /// Error of the robot description.
        cause: UrdfError,
    },
    /// A new system has no pose from which to start.
    #[error("{file}: {reason}")]
    NoPose {
        /// Path of the robot description.
        file: String,
        /// Expected, actual and remedy.
        reason: String,
    },
}
