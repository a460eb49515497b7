//! Conflicts between settings: values that violate a rule which concerns several settings.

use std::borrow::Cow;
use std::fmt::Display;
use upswing_model::{JointKind, Limits, Model};

/// A setting that meets its own rule but conflicts with another setting.
#[derive(Debug, thiserror::Error)]
#[error("{key}: expected {expected}, got {got}: {fix}")]
pub(crate) struct SettingsConflict {
    /// The key with its section.
    pub key: Cow<'static, str>,
    /// Values that the other setting allows.
    pub expected: String,
    /// Value of the setting.
    pub got: String,
    /// Remedy for the user.
    pub fix: String,
}

impl SettingsConflict {
    pub fn new(
        key: impl Into<Cow<'static, str>>,
        expected: impl Display,
        got: impl Display,
        fix: impl Display,
    ) -> Self {
        Self { key: key.into(), expected: expected.to_string(), got: got.to_string(), fix: fix.to_string() }
    }

    /// Refuses a value of `key` that is not above `low`, the value of `low_key`; both in the unit of the file.
    pub fn unless_above(
        key: impl Into<Cow<'static, str>>,
        value: f64,
        low: f64,
        low_key: &str,
    ) -> Result<(), Self> {
        if value > low {
            return Ok(());
        }
        let fix = format!("raise it or lower {low_key}");
        Err(Self::new(key, format!("more than the {low} of {low_key}"), value, fix))
    }

    /// Refuses a `position` (rad or m) outside the position limits of the joint of index `joint` in the model's vectors. The key of the
    /// position is `key`, with the unit and the name of the joint.
    pub fn unless_within(
        key: &str,
        position: f64,
        joint: usize,
        limits: &Limits,
        model: &Model,
    ) -> Result<(), Self> {
        let (low, high) = (limits.q_min[joint], limits.q_max[joint]);
        if (low..=high).contains(&position) {
            return Ok(());
        }
        let kind = model.joint_kind(joint);
        let [low, high, got] = [low, high, position].map(|q| in_file(kind, q));
        let (name, unit) = (model.joint_name(joint), unit(kind));
        let expected = format!("a position from {low} to {high} {unit}");
        let got = format!("{got} for joint `{name}`");
        Err(Self::new(format!("{key}_{unit}"), expected, got, "stay inside the limits in robot.toml"))
    }
}

/// The position `q` (rad or m) in the unit of files, rounded to 1e-6 to hide the rounding errors of the conversion.
pub(crate) fn in_file(kind: JointKind, q: f64) -> f64 {
    (kind.shown(q).0 * 1e6).round() / 1e6
}

/// The unit of positions in files: the end of their keys.
pub(crate) fn unit(kind: JointKind) -> &'static str {
    kind.shown(0.0).1
}

/// Converts a time from s to ms, rounded to 1e-6 ms to hide the rounding errors of the conversion.
pub(crate) fn milliseconds(s: f64) -> f64 {
    (s * 1e9).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_hold_up_to_their_ends() {
        let above = |v| SettingsConflict::unless_above("k", v, 1.0, "l").is_ok();
        assert!(above(1.1) && !above(1.0) && !above(f64::NAN));
        let model = Model::from_urdf(include_str!("../systems/iiwa-pendulum/robot.urdf")).expect("the robot");
        let mut limits = *model.rated_limits();
        (limits.q_min[8], limits.q_max[8]) = (-0.5, 0.25);
        let within = |rad: f64| SettingsConflict::unless_within("k", rad, 8, &limits, &model).is_ok();
        assert!(within(0.25) && within(-0.5) && !within(0.26) && !within(-0.51) && !within(f64::NAN));
    }
}
