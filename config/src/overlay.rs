//! Settings in layers: the defaults, the file of a system with the keys that differ, and a scenario.

use crate::ConfigError;
use crate::conflict::SettingsConflict;
use crate::file::{TextFile, key_at, position};
use crate::joints::{DEFAULT, JointList};
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use toml_edit::{Decor, DocumentMut, Item, Table, Value};
use upswing_model::Model;

/// The defaults of a settings file, complete and commented.
pub(crate) struct Defaults {
    /// Name of the file.
    pub name: &'static str,
    /// Its text.
    pub text: &'static str,
}

/// The settings file of a system over its defaults.
pub(crate) struct Settings {
    /// The file of the system.
    pub file: TextFile,
    /// The defaults, behind as many spaces as the file of the system has bytes: a place tells in which of both it is.
    defaults: String,
}

impl Settings {
    /// The `file` of a system over its defaults.
    pub fn new(file: TextFile, defaults: &Defaults) -> Self {
        let defaults = format!("{}{}", " ".repeat(file.text.len() + 1), defaults.text);
        Self { file, defaults }
    }

    /// The defaults with the values of the system.
    pub fn tables(&self) -> Result<Spanned<DeTable<'_>>, ConfigError> {
        let changes = DeTable::parse(&self.file.text).map_err(|e| self.file.malformed(&e))?;
        let mut tables = DeTable::parse(&self.defaults).map_err(|e| self.malformed(&e))?;
        for (key, value) in changes.into_inner() {
            match (tables.get_mut().get_mut(key.get_ref().as_ref()).map(Spanned::get_mut), value.get_ref()) {
                (Some(DeValue::Table(old)), DeValue::Table(_)) => {
                    let DeValue::Table(changes) = value.into_inner() else { continue };
                    overlay(old, changes);
                }
                _ => {
                    tables.get_mut().insert(key, value);
                }
            }
        }
        Ok(tables)
    }

    /// Reads settings of the robot `model`; checks syntax, unknown and missing keys and joints, the rule of each field, then the rules
    /// between settings with `finish`.
    pub fn read<T: DeserializeOwned>(
        &self,
        model: &Model,
        finish: impl FnOnce(&mut T) -> Result<(), SettingsConflict>,
    ) -> Result<T, ConfigError> {
        let tables = toml::Deserializer::from(self.tables()?);
        let mut settings =
            T::deserialize(JointList::of(model).around(tables)).map_err(|e| self.malformed(&e))?;
        finish(&mut settings).map_err(|conflict| self.file.refuse(conflict))?;
        Ok(settings)
    }

    /// The error of a key or value that does not fit. One among the defaults concerns the key that the file of the system lacks.
    fn malformed(&self, error: &toml::de::Error) -> ConfigError {
        let at = error.span().map_or(0, |span| span.start);
        if at <= self.file.text.len() {
            return self.file.malformed(error);
        }
        let key = DeTable::parse(&self.defaults).ok().and_then(|table| key_at(table.get_ref(), at));
        let at = DeTable::parse(&self.file.text)
            .map_or(0, |table| position(table.get_ref(), key.as_deref().unwrap_or_default()));
        self.file.error(at, key, TextFile::fix(error))
    }
}

/// Replaces values of a section by `changes`.
fn overlay<'a>(base: &mut DeTable<'a>, changes: DeTable<'a>) {
    for (key, value) in changes {
        let span = value.span();
        let value = match base.get(key.get_ref().as_ref()).map(Spanned::get_ref) {
            Some(old) if can_be_per_joint(old) && can_be_per_joint(value.get_ref()) => {
                completed(value.into_inner(), old)
            }
            _ => value.into_inner(),
        };
        base.insert(key, Spanned::new(span, value));
    }
}

/// A value per joint; a table without a default has the values of `old` for the joints that it does not name.
pub(crate) fn completed<'a>(new: DeValue<'a>, old: &DeValue<'a>) -> DeValue<'a> {
    let DeValue::Table(mut table) = new else { return new };
    if !table.contains_key(DEFAULT) {
        let default =
            || [(Spanned::new(0..0, DEFAULT.into()), Spanned::new(0..0, old.clone()))].into_iter().collect();
        let old: DeTable<'_> = old.as_table().cloned().unwrap_or_else(default);
        for (joint, value) in old {
            table.entry(joint).or_insert(value);
        }
    }
    DeValue::Table(table)
}

/// Whether a value of a section can be one value per joint: a number, a list of numbers, or a table.
pub(crate) fn can_be_per_joint(value: &DeValue<'_>) -> bool {
    matches!(value, DeValue::Table(_)) || ["a number", "a list of numbers"].contains(&kind(value).as_str())
}

/// Name of a value's type in messages; integers and floats are both "a number".
pub(crate) fn kind(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Integer(_) | DeValue::Float(_) => "a number".into(),
        DeValue::Array(items) => {
            match items.iter().map(Spanned::get_ref).map(kind).find(|item| item != "a number") {
                Some(other) => format!("a list with {other}"),
                None => "a list of numbers".into(),
            }
        }
        other => format!("a {}", other.type_str()),
    }
}

/// The complete text of settings: the defaults with the values and comments of the `system`.
pub(crate) fn complete(defaults: &str, system: &str) -> Result<String, toml_edit::TomlError> {
    let ((header, defaults), (system_header, system)) = (split_header(defaults), split_header(system));
    let mut document: DocumentMut = defaults.parse()?;
    let system: DocumentMut = system.parse()?;
    for (name, item) in system.iter() {
        match (document.get_mut(name), item) {
            (Some(Item::Table(old)), Item::Table(new)) => {
                if has_comment(new.decor()) {
                    *old.decor_mut() = new.decor().clone();
                }
                complete_section(old, new);
            }
            _ => complete_value(document.as_table_mut(), system.as_table(), name, item),
        }
    }
    let header = if system_header.is_empty() { header } else { system_header };
    Ok(format!("{header}{document}"))
}

/// Replaces values of a section by those of the `system`, with their comments.
fn complete_section(section: &mut Table, system: &Table) {
    for (name, item) in system.iter() {
        complete_value(section, system, name, item);
    }
}

/// Replaces the value `name` of a section by the `item` of the `system`, with its comment.
fn complete_value(section: &mut Table, system: &Table, name: &str, item: &Item) {
    let mut item = item.clone();
    if let (Some(old), Some(new)) = (section.get(name), item.as_table_like_mut())
        && !new.contains_key(DEFAULT)
    {
        let missing: Vec<_> = match old.as_table_like() {
            Some(old) => old.iter().map(|(joint, value)| (joint.to_owned(), value.clone())).collect(),
            None => vec![(DEFAULT.to_owned(), old.clone())],
        };
        for (joint, value) in missing {
            if !new.contains_key(&joint) {
                new.insert(&joint, value);
            }
        }
    }
    if let Item::Value(Value::InlineTable(table)) = &mut item {
        table.fmt();
    }
    let comment = |table: &Table| table.key(name).map(|key| key.leaf_decor().clone());
    let comment = comment(system).filter(has_comment).or_else(|| comment(section));
    section.insert(name, in_place(item));
    if let (Some(comment), Some(mut key)) = (comment, section.key_mut(name)) {
        *key.leaf_decor_mut() = comment;
    }
}

/// An item at the place in the document where it is inserted, not where it was in its own.
fn in_place(mut item: Item) -> Item {
    if let Item::Table(table) = &mut item {
        table.set_position(None);
    }
    item
}

fn has_comment(decor: &Decor) -> bool {
    decor.prefix().and_then(|prefix| prefix.as_str()).is_some_and(|prefix| prefix.contains('#'))
}

/// The comment at the top of a file up to the first empty line, and the rest; without such a line there is none.
fn split_header(text: &str) -> (&str, &str) {
    let end = text.find("\n\n").filter(|end| text[..*end].lines().all(|line| line.starts_with('#')));
    text.split_at(end.map_or(0, |end| end + 1))
}
