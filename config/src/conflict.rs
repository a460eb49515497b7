//! Conflicts between settings: values that violate a rule which concerns several settings.

use std::borrow::Cow;
use std::fmt::Display;
use upswing_model::Limits;

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
    pub fn unless_above(key: &'static str, value: f64, low: f64, low_key: &str) -> Result<(), Self> {
        if value > low {
            return Ok(());
        }
        let fix = format!("raise it or lower {low_key}");
        Err(Self::new(key, format!("more than the {low} of {low_key}"), value, fix))
    }

    /// Refuses an `angle` (rad) outside the position limits of `joint`, counted from 0.
    pub fn unless_within(key: &'static str, angle: f64, joint: usize, limits: &Limits) -> Result<(), Self> {
        let (low, high) = (limits.q_min[joint], limits.q_max[joint]);
        if (low..=high).contains(&angle) {
            return Ok(());
        }
        let expected = format!("an angle from {} to {} deg", degrees(low), degrees(high));
        let got = format!("{} for joint {}", degrees(angle), joint + 1);
        Err(Self::new(key, expected, got, "stay inside the limits in robot.toml"))
    }
}

/// Converts an angle from rad to deg, rounded to 1e-6 deg to hide the rounding errors of the conversion.
pub(crate) fn degrees(rad: f64) -> f64 {
    (rad.to_degrees() * 1e6).round() / 1e6
}

/// Converts a time from s to ms, rounded to 1e-6 ms to hide the rounding errors of the conversion.
pub(crate) fn milliseconds(s: f64) -> f64 {
    (s * 1e9).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use upswing_model::{NQ, NU};

    #[test]
    fn ranges_hold_up_to_their_ends() {
        let above = |v| SettingsConflict::unless_above("k", v, 1.0, "l").is_ok();
        assert!(above(1.1) && !above(1.0) && !above(f64::NAN));
        let mut limits = Limits {
            q_min: [-1.0; NQ].into(),
            q_max: [1.0; NQ].into(),
            qd_max: [1.0; NQ].into(),
            tau_max: [1.0; NU].into(),
        };
        (limits.q_min[8], limits.q_max[8]) = (-0.5, 0.25);
        let within = |rad: f64| SettingsConflict::unless_within("k", rad, 8, &limits).is_ok();
        assert!(within(0.25) && within(-0.5) && !within(0.26) && !within(-0.51) && !within(f64::NAN));
    }
}
