//! Settings files: their text, and the line of an error.

use crate::ConfigError;
use crate::conflict::SettingsConflict;
use crate::joints::JointList;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::path::Path;
use toml::de::{DeTable, DeValue};
use upswing_model::Model;

/// A text file: its name in messages, and its text.
pub(crate) struct TextFile {
    pub name: String,
    pub text: String,
}

impl TextFile {
    pub fn new(name: String, bytes: Vec<u8>) -> Result<Self, ConfigError> {
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Self { name, text }),
            Err(e) => Err(ConfigError::NotText { file: name, offset: e.utf8_error().valid_up_to() }),
        }
    }

    /// Reads a file that the user named.
    pub fn at(path: &Path) -> Result<Self, ConfigError> {
        let file = path.display().to_string();
        match read_file(path) {
            Ok(bytes) => Self::new(file, bytes),
            Err(cause) => Err(ConfigError::NoFile { file, cause }),
        }
    }

    /// Parses TOML into settings of the robot `model`; checks syntax, unknown and missing keys and joints, and the rule of each field.
    pub fn parse<T: DeserializeOwned>(&self, model: &Model) -> Result<T, ConfigError> {
        let settings = toml::Deserializer::parse(&self.text)
            .and_then(|toml| T::deserialize(JointList::of(model).around(toml)));
        settings.map_err(|error| self.malformed(&error))
    }

    /// Parses TOML into settings as [`TextFile::parse`], then checks the rules between settings with `validate`.
    pub fn settings<T: DeserializeOwned>(
        &self,
        model: &Model,
        validate: impl FnOnce(&T) -> Result<(), SettingsConflict>,
    ) -> Result<T, ConfigError> {
        let settings = self.parse(model)?;
        validate(&settings).map_err(|conflict| self.refuse(conflict))?;
        Ok(settings)
    }

    /// The error of a violated rule between settings, with the line of the key.
    pub fn refuse(&self, SettingsConflict { key, expected, got, fix }: SettingsConflict) -> ConfigError {
        let at = DeTable::parse(&self.text).map_or(0, |table| position(table.get_ref(), &key));
        self.error(at, Some(key.into()), format_args!("expected {expected}, got {got}: {fix}"))
    }

    /// The error of text that is no TOML, or of a key or value that does not fit, with its line.
    pub fn malformed(&self, error: &toml::de::Error) -> ConfigError {
        let at = error.span().map_or(0, |span| span.start).min(self.text.len());
        let key = DeTable::parse(&self.text).ok().and_then(|table| key_at(table.get_ref(), at));
        self.error(at, key, Self::fix(error))
    }

    /// The text of a key or value that does not fit, with the remedy.
    pub fn fix(error: &toml::de::Error) -> String {
        let fix = "compare with the commented original, `upswing config export DIR` writes it";
        format!("{}: {fix}", error.message())
    }

    /// The error of a setting at byte offset `at` of the text. A `reason` that begins with `.name: ` concerns the key `name` of the
    /// table `key`.
    pub fn error(&self, at: usize, mut key: Option<String>, reason: impl Display) -> ConfigError {
        let mut reason = reason.to_string();
        if let (Some(key), Some((name, rest))) = (&mut key, reason.split_once(": "))
            && name.starts_with('.')
        {
            key.push_str(name);
            reason = rest.into();
        }
        let line = self.text.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
        let text = self.text.lines().nth(line).unwrap_or_default().trim().chars().take(80).collect();
        ConfigError::Setting { file: self.name.clone(), line: line + 1, text, key, reason }
    }
}

/// Dotted name of the key whose name or value is at byte offset `at` of the text.
pub(crate) fn key_at(table: &DeTable<'_>, at: usize) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let inner = match value.get_ref() {
            DeValue::Table(inner) => key_at(inner, at),
            DeValue::Array(items) => {
                items.iter().find_map(|item| item.get_ref().as_table().and_then(|inner| key_at(inner, at)))
            }
            _ => None,
        };
        match inner {
            Some(inner) => Some(format!("{}.{inner}", key.get_ref())),
            None => {
                (key.span().contains(&at) || value.span().contains(&at)).then(|| key.get_ref().to_string())
            }
        }
    })
}

/// Byte offset of a dotted key in the text, or of its longest part that exists; of the list for a key in a list of tables.
pub(crate) fn position(table: &DeTable<'_>, key: &str) -> usize {
    let (part, rest) = key.split_once('.').unwrap_or((key, ""));
    let Some((name, value)) = table.get_key_value(part) else { return 0 };
    let inner = value.get_ref().as_table().map_or(0, |inner| position(inner, rest));
    if inner == 0 { name.span().start } else { inner }
}

/// Reads a regular file. Pipes, devices and directories are refused: reading could block, or never end.
///
/// # Errors
/// Those of the operating system, or that the path is not a regular file.
pub fn read_file(path: &Path) -> std::io::Result<Vec<u8>> {
    check_regular(path)?;
    std::fs::read(path)
}

/// Opens a regular file for reading; pipes, devices and directories are refused as by [`read_file`].
///
/// # Errors
/// Those of the operating system, or that the path is not a regular file.
pub fn open_file(path: &Path) -> std::io::Result<std::fs::File> {
    check_regular(path)?;
    std::fs::File::open(path)
}

/// Refuses the path of a directory, pipe or device; accepts a regular file, and a path without a file.
///
/// # Errors
/// Those of the operating system, or that the path is not a regular file.
pub fn check_regular(path: &Path) -> std::io::Result<()> {
    match path.metadata() {
        Ok(state) if state.is_dir() => Err(std::io::ErrorKind::IsADirectory.into()),
        Ok(state) if !state.is_file() => Err(std::io::Error::other("it is not a regular file")),
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}
