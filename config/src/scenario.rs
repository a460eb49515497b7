//! Scenarios of the simulated plant: changes to its settings, with faults and pushes at given cycles.

use crate::conflict::SettingsConflict;
use crate::fault::FaultInFile;
use crate::file::TextFile;
use crate::joints::JointList;
use crate::overlay::{Settings, can_be_per_joint, completed, kind};
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
    base: &Settings,
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
    let mut tables = base.tables()?;
    overlay(file, "", tables.get_mut(), changes)?;
    // A value that violates its rule is from the scenario: the values of `base` have been checked before.
    let tables = toml::Deserializer::from(tables);
    let mut settings =
        PlantSettings::deserialize(JointList::of(model).around(tables)).map_err(|e| file.malformed(&e))?;
    settings.finish(robot, model).map_err(|conflict| file.refuse(conflict))?;
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
