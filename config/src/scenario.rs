//! Scenarios of the simulated plant: changes to its settings, with faults and pushes at given cycles.

use crate::conflict::SettingsConflict;
use crate::fault::FaultInFile;
use crate::file::TextFile;
use crate::joints::{DEFAULT, JointList};
use crate::{ConfigError, PlantSettings, Push, RobotSettings};
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use upswing_model::Model;

/// The keys of a scenario file, without the changed keys of `plant.toml`.
#[derive(Deserialize)]
struct Scenario {
    purpose: String,
    #[serde(default)]
    fault: Vec<Spanned<FaultInFile>>,
    #[serde(default)]
    push: Vec<Push>,
}

/// Applies the scenario in `file` to `plant.toml` (`base`); returns the settings and the purpose of the scenario.
pub(crate) fn read(
    file: &TextFile,
    base: &TextFile,
    robot: &RobotSettings,
    model: &Model,
) -> Result<(PlantSettings, String), ConfigError> {
    let Scenario { purpose, fault, push } = file.settings(model, |scenario: &Scenario| {
        let fix = "say what the scenario is for";
        let blank = scenario.purpose.trim().is_empty();
        if blank { Err(SettingsConflict::new("purpose", "a sentence", "none", fix)) } else { Ok(()) }
    })?;
    let faults = fault.into_iter().map(|fault| {
        let at = fault.span().start;
        fault
            .into_inner()
            .fault(model)
            .map_err(|e| file.error(at, Some("fault".into()), format_args!(".{e}")))
    });
    let faults = faults.collect::<Result<_, _>>()?;
    let mut changes = DeTable::parse(&file.text).map_err(|e| file.malformed(&e))?.into_inner();
    for key in ["purpose", "fault", "push"] {
        changes.remove(key);
    }
    let mut tables = DeTable::parse(&base.text).map_err(|e| base.malformed(&e))?;
    overlay(file, "", tables.get_mut(), changes)?;
    // A value that violates its rule is from the scenario: the values of `base` have been checked before.
    let tables = toml::Deserializer::from(tables);
    let mut settings =
        PlantSettings::deserialize(JointList::of(model).around(tables)).map_err(|e| file.malformed(&e))?;
    settings.validate(robot, model).map_err(|conflict| file.refuse(conflict))?;
    (settings.faults, settings.pushes) = (faults, push);
    Ok((settings, purpose))
}

/// Replaces values of `base` by `changes`; a scenario can neither add a key nor change the type of a value. A table of values by joint
/// name changes the joints that it names, and all joints if it has a default.
fn overlay<'a>(
    file: &TextFile,
    section: &str,
    base: &mut DeTable<'a>,
    changes: DeTable<'a>,
) -> Result<(), ConfigError> {
    for (key, value) in changes {
        let name = format!("{section}{}", key.get_ref());
        let refuse = |expected: String, got: String, fix: &str| {
            Err(file.refuse(SettingsConflict::new(name.clone(), expected, got, fix)))
        };
        let Some(old) = base.get_mut(key.get_ref().as_ref()) else {
            return refuse("a key of plant.toml".into(), "none".into(), "correct its name or remove it");
        };
        let span = value.span();
        let new = match (old.get_mut(), value.into_inner()) {
            (DeValue::Table(old), DeValue::Table(new)) if section.is_empty() => {
                overlay(file, &format!("{name}."), old, new)?;
                continue;
            }
            (old, new) if !section.is_empty() && can_be_per_joint(old) && can_be_per_joint(&new) => {
                completed(new, old)
            }
            (old, new) if kind(old) == kind(&new) => new,
            (old, new) => {
                let (expected, got) = (format!("{} as in plant.toml", kind(old)), kind(&new));
                return refuse(expected, got, "change the value");
            }
        };
        *old = Spanned::new(span, new);
    }
    Ok(())
}

/// A value per joint of a scenario; a table without a default has the values of `old` for the joints that it does not name.
fn completed<'a>(new: DeValue<'a>, old: &DeValue<'a>) -> DeValue<'a> {
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
fn can_be_per_joint(value: &DeValue<'_>) -> bool {
    matches!(value, DeValue::Table(_)) || ["a number", "a list of numbers"].contains(&kind(value).as_str())
}

/// Name of a value's type in messages; integers and floats are both "a number".
fn kind(value: &DeValue<'_>) -> String {
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
