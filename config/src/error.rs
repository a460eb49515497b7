//! The one error of all settings.

use upswing_model::UrdfError;

/// Why settings cannot be used. Each message names the file, what was expected, what came, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file is missing or cannot be read.
    #[error(
        "{file}: cannot be read ({cause}); expected all of {}: `upswing config export DIR` writes a full copy to \
         start from",
        crate::file_names()
    )]
    Unreadable {
        /// Path of the file.
        file: String,
        /// What the operating system said.
        cause: std::io::Error,
    },
    /// A file that the user named is missing or cannot be read.
    #[error("{file}: cannot be read ({cause}): name an existing file")]
    NoFile {
        /// Path of the file.
        file: String,
        /// What the operating system said.
        cause: std::io::Error,
    },
    /// A file that should be text is not.
    #[error("{file}: expected UTF-8 text, got other bytes at offset {offset}: save the file as UTF-8")]
    NotText {
        /// Path of the file.
        file: String,
        /// First byte that is not UTF-8, counted from 0.
        offset: usize,
    },
    /// No TOML, an unknown or missing key, or a value of the wrong type.
    #[error(
        "{file}, line {line}, `{text}`: {}{reason}: compare with the commented original, \
         `upswing config export DIR` writes it",
        .key.as_ref().map(|key| format!("{key}: ")).unwrap_or_default()
    )]
    Toml {
        /// Path of the file.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// The line.
        text: String,
        /// The key with its section; none in text that is no TOML.
        key: Option<String>,
        /// What was expected and what came.
        reason: String,
    },
    /// A value that the system cannot work with.
    #[error("{file}: {key}: expected {expected}, got {got}: {fix}")]
    Value {
        /// Path of the file.
        file: String,
        /// The key with its section.
        key: String,
        /// What is possible.
        expected: String,
        /// What was found.
        got: String,
        /// What to do.
        fix: String,
    },
    /// A fault or a push of a scenario that cannot be.
    #[error("{file}: {section}: {cause}")]
    Event {
        /// Path of the file.
        file: String,
        /// `fault` or `push`.
        section: String,
        /// What is wrong with it.
        cause: crate::EventError,
    },
    /// A scenario that does not exist.
    #[error(
        "expected the path of a scenario that ends in .toml or one of {}, got `{got}`",
        crate::Config::scenario_names().collect::<Vec<_>>().join(", ")
    )]
    NoScenario {
        /// The name that came.
        got: String,
    },
    /// The robot description cannot be used.
    #[error("{file}: {cause}")]
    Urdf {
        /// Path of the file.
        file: String,
        /// What is wrong with it.
        cause: UrdfError,
    },
    /// A joint's range is not symmetric about 0.
    #[error(
        "{file}: joint `{joint}`: expected a range that is symmetric about 0, got {low} to {high} deg: others are not supported \
         yet; turn the joint's origin so that the middle of its range is 0, or use the smaller side there and in robot.toml"
    )]
    Asymmetric {
        /// Name of the URDF.
        file: String,
        /// The joint.
        joint: String,
        /// Lower end, deg.
        low: f64,
        /// Upper end, deg.
        high: f64,
    },
}
