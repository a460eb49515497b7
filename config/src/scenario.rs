//! Scenarios of the simulated plant: changes to its settings, with faults and pushes at given cycles.

use crate::conflict::SettingsConflict;
use crate::fault::{Fault, FaultInFile};
use crate::file::TextFile;
use crate::{ConfigError, PlantSettings, Push, RobotSettings};
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

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
) -> Result<(PlantSettings, String), ConfigError> {
    let Scenario { purpose, fault, push } = file.settings(|scenario: &Scenario| {
        let fix = "say what the scenario is for";
        let blank = scenario.purpose.trim().is_empty();
        if blank { Err(SettingsConflict::new("purpose", "a sentence", "none", fix)) } else { Ok(()) }
    })?;
    let faults = fault.into_iter().map(|fault| {
        let at = fault.span().start;
        Fault::try_from(fault.into_inner()).map_err(|reason| file.error(at, Some("fault".into()), reason))
    });
    let faults = faults.collect::<Result<_, _>>()?;
    let mut changes = DeTable::parse(&file.text).map_err(|e| file.malformed(&e))?.into_inner();
    for key in ["purpose", "fault", "push"] {
        changes.remove(key);
    }
    let mut tables = DeTable::parse(&base.text).map_err(|e| base.malformed(&e))?;
    overlay(file, "", tables.get_mut(), changes)?;
    // A value that violates its rule is from the scenario: the values of `base` have been checked before.
    let mut settings =
        PlantSettings::deserialize(toml::Deserializer::from(tables)).map_err(|e| file.malformed(&e))?;
    settings.validate(robot).map_err(|conflict| file.refuse(conflict))?;
    (settings.faults, settings.pushes) = (faults, push);
    Ok((settings, purpose))
}

/// Replaces values of `base` by `changes`; a scenario can neither add a key nor change the type of a value.
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
        match (old.get_mut(), value.get_ref()) {
            (DeValue::Table(old), DeValue::Table(_)) => {
                let DeValue::Table(new) = value.into_inner() else { continue };
                overlay(file, &format!("{name}."), old, new)?;
            }
            (before, new) if alike(before, new) => *old = value,
            (before, new) => {
                let (expected, got) = (format!("{} as in plant.toml", kind(before)), kind(new));
                return refuse(expected, got, "change the value");
            }
        }
    }
    Ok(())
}

fn alike(a: &DeValue<'_>, b: &DeValue<'_>) -> bool {
    match (a, b) {
        (DeValue::Array(a), DeValue::Array(b)) => {
            a.iter().all(|a| b.iter().all(|b| alike(a.get_ref(), b.get_ref())))
        }
        (a, b) => kind(a) == kind(b),
    }
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
