//! Scenarios: what is different about the plant this time, and what happens to it.

use crate::check::Check;
use crate::{ConfigError, Fault, FaultKind, PlantSettings, Push, RobotSettings};
use serde::Deserialize;
use toml::{Table, Value};
use upswing_model::NQ;

/// A scenario file: its purpose, what happens when, and the keys of `plant.toml` that differ.
#[derive(Deserialize)]
struct Raw {
    purpose: String,
    #[serde(default)]
    fault: Vec<RawFault>,
    #[serde(default)]
    push: Vec<RawPush>,
    #[serde(flatten)]
    plant: Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFault {
    kind: FaultKind,
    from_cycle: i64,
    #[serde(default)]
    cycles: i64,
    joint: Option<i64>,
    amount: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPush {
    from_cycle: i64,
    cycles: i64,
    impulse_ns: [f64; 3],
}

/// Cycle numbers that a file can state: more than a plant lives to see.
const CYCLES: std::ops::RangeInclusive<i64> = 0..=1_000_000_000_000;

/// The settings of `plant.toml` (`base`) under a scenario, and its purpose.
pub(crate) fn read(
    file: &str,
    text: &str,
    base: &str,
    robot: &RobotSettings,
) -> Result<(PlantSettings, String), ConfigError> {
    let check = Check { file };
    let raw: Raw = check.parse(text)?;
    if raw.purpose.trim().is_empty() {
        return Err(check.refuse("purpose", "a sentence", "none", "say what the scenario is for"));
    }
    let mut tables: Table = Check { file: crate::PLANT.name }.parse(base)?;
    overlay(check, "", &mut tables, raw.plant)?;
    let mut settings = PlantSettings::from_tables(check, tables, robot)?;
    settings.faults = raw.fault.iter().map(|fault| read_fault(check, fault)).collect::<Result<_, _>>()?;
    settings.pushes = raw.push.iter().map(|push| read_push(check, push)).collect::<Result<_, _>>()?;
    Ok((settings, raw.purpose))
}

/// Replaces values of `base`; a scenario can neither add a key nor change what kind of value it has.
fn overlay(check: Check<'_>, section: &str, base: &mut Table, changes: Table) -> Result<(), ConfigError> {
    for (key, value) in changes {
        let name = if section.is_empty() { key.clone() } else { format!("{section}.{key}") };
        let Some(old) = base.get_mut(&key) else {
            let fix = "correct its name or remove it";
            return Err(check.refuse(&name, "a key of plant.toml", "none", fix));
        };
        match (old, value) {
            (Value::Table(old), Value::Table(new)) => overlay(check, &name, old, new)?,
            (old, new) if alike(old, &new) => *old = new,
            (old, new) => {
                let expected = format!("{} as in plant.toml", kind(old));
                return Err(check.refuse(&name, expected, kind(&new), "change the value"));
            }
        }
    }
    Ok(())
}

fn alike(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => a.iter().all(|a| b.iter().all(|b| alike(a, b))),
        (a, b) => kind(a) == kind(b),
    }
}

/// What a message calls a value; whole numbers pass for numbers.
fn kind(value: &Value) -> String {
    match value {
        Value::Integer(_) | Value::Float(_) => "a number".into(),
        Value::Array(items) => match items.iter().find(|item| kind(item) != "a number") {
            Some(other) => format!("a list with {}", kind(other)),
            None => "a list of numbers".into(),
        },
        other => format!("a {}", other.type_str()),
    }
}

fn read_fault(check: Check<'_>, raw: &RawFault) -> Result<Fault, ConfigError> {
    let needs = raw.kind.has_joint();
    let joint = match raw.joint {
        Some(joint) if needs => check.integer("fault.joint", joint, 1..=NQ as i64)?,
        None if !needs => 1,
        other => {
            let expected = if needs { "a joint" } else { "none for this kind" };
            let got = other.map_or("none".into(), |joint| joint.to_string());
            return Err(check.refuse("fault.joint", expected, got, "only encoders and torques have a joint"));
        }
    };
    let fault = Fault {
        kind: raw.kind,
        from: check.integer("fault.from_cycle", raw.from_cycle, 1..=*CYCLES.end())?,
        cycles: check.integer("fault.cycles", raw.cycles, CYCLES)?,
        joint: joint - 1,
        amount: raw.amount.unwrap_or_default(),
    };
    fault.check().map_err(|e| event(check, "fault", e))?;
    Ok(fault)
}

fn read_push(check: Check<'_>, raw: &RawPush) -> Result<Push, ConfigError> {
    let push = Push {
        from: check.integer("push.from_cycle", raw.from_cycle, 1..=*CYCLES.end())?,
        cycles: check.integer("push.cycles", raw.cycles, 1..=*CYCLES.end())?,
        impulse: raw.impulse_ns,
    };
    push.check().map_err(|e| event(check, "push", e))?;
    Ok(push)
}

fn event(check: Check<'_>, section: &str, cause: crate::EventError) -> ConfigError {
    ConfigError::Event { file: check.file.into(), section: section.into(), cause }
}
