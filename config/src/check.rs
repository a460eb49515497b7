//! From the text of one file to numbers that hold what their key promises.

use crate::ConfigError;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;
use toml::de::{DeTable, DeValue};
use upswing_model::Limits;

/// What a single number has to fulfil.
pub(crate) struct Rule {
    pub expected: &'static str,
    pub holds: fn(f64) -> bool,
}

pub(crate) const FINITE: Rule = Rule { expected: "a finite number", holds: f64::is_finite };
pub(crate) const POSITIVE: Rule =
    Rule { expected: "a finite number above 0", holds: |v| v.is_finite() && v > 0.0 };
pub(crate) const NON_NEGATIVE: Rule =
    Rule { expected: "a finite number, 0 or above", holds: |v| v.is_finite() && v >= 0.0 };
pub(crate) const COUNT: Rule = Rule {
    expected: "a whole number from 1 to 1000000",
    holds: |v| (1.0..=1e6).contains(&v) && v.fract() == 0.0,
};
pub(crate) const NEGATIVE: Rule =
    Rule { expected: "a finite number below 0", holds: |v| v.is_finite() && v < 0.0 };
pub(crate) const FRACTION: Rule = Rule { expected: "a share in (0, 1]", holds: |v| v > 0.0 && v <= 1.0 };
pub(crate) const SHARE: Rule = Rule { expected: "a share in [0, 1]", holds: |v| (0.0..=1.0).contains(&v) };
pub(crate) const PART: Rule = Rule { expected: "a share in [0, 1)", holds: |v| (0.0..1.0).contains(&v) };
pub(crate) const BELOW_ONE: Rule =
    Rule { expected: "a number between 0 and 1, both excluded", holds: |v| v > 0.0 && v < 1.0 };
pub(crate) const DURATION: Rule =
    Rule { expected: "a duration above 0 and at most 60 s", holds: |v| v > 0.0 && v <= 60.0 };
pub(crate) const FULL_TURN: Rule =
    Rule { expected: "an angle from -360 to 360 deg", holds: |v| (-360.0..=360.0).contains(&v) };
pub(crate) const ACUTE: Rule =
    Rule { expected: "an angle between 0 and 90 deg, both excluded", holds: |v| v > 0.0 && v < 90.0 };

/// One file under check; its name goes into every error.
#[derive(Clone, Copy)]
pub(crate) struct Check<'a> {
    pub file: &'a str,
}

impl Check<'_> {
    /// Reads the file's raw mirror: syntax, unknown and missing keys, types.
    pub fn parse<T: DeserializeOwned>(self, text: &str) -> Result<T, ConfigError> {
        toml::from_str(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start).min(text.len());
            let line = text.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
            ConfigError::Toml {
                file: self.file.into(),
                line: line + 1,
                text: text.lines().nth(line).unwrap_or_default().trim().chars().take(80).collect(),
                key: DeTable::parse(text).ok().and_then(|table| key_at(table.get_ref(), at)),
                reason: error.message().into(),
            }
        })
    }

    pub fn refuse(self, key: &str, expected: impl Display, got: impl Display, fix: &str) -> ConfigError {
        ConfigError::Value {
            file: self.file.into(),
            key: key.into(),
            expected: expected.to_string(),
            got: got.to_string(),
            fix: fix.into(),
        }
    }

    pub fn number(self, key: &str, value: f64, rule: &Rule) -> Result<f64, ConfigError> {
        if (rule.holds)(value) { Ok(value) } else { Err(self.refuse(key, rule.expected, value, SEE_COMMENT)) }
    }

    /// One number per joint from `first` (counted from 1) on.
    pub fn list<const N: usize>(
        self,
        key: &str,
        values: &[f64],
        first: usize,
        rule: &Rule,
    ) -> Result<[f64; N], ConfigError> {
        let list: [f64; N] = values.try_into().map_err(|_| {
            let expected = format!("{N} numbers, for joints {first} to {}", first + N - 1);
            self.refuse(key, expected, values.len(), "give one number per joint")
        })?;
        for (i, value) in list.into_iter().enumerate() {
            if !(rule.holds)(value) {
                let got = format!("{value} for joint {}", first + i);
                return Err(self.refuse(key, rule.expected, got, SEE_COMMENT));
            }
        }
        Ok(list)
    }

    pub fn integer<T: TryFrom<i64>>(
        self,
        key: &str,
        value: i64,
        range: RangeInclusive<i64>,
    ) -> Result<T, ConfigError> {
        let expected = format!("a whole number from {} to {}", range.start(), range.end());
        range
            .contains(&value)
            .then(|| T::try_from(value).ok())
            .flatten()
            .ok_or_else(|| self.refuse(key, expected, value, SEE_COMMENT))
    }

    /// A time in s, above 0 and at most a day.
    pub fn seconds(self, key: &str, value: f64) -> Result<Duration, ConfigError> {
        const TIME: Rule =
            Rule { expected: "a time above 0 and at most 86400 s", holds: |v| v > 0.0 && v <= 86_400.0 };
        Ok(Duration::from_secs_f64(self.number(key, value, &TIME)?))
    }

    /// An angle of one joint (counted from 0) inside its limits: deg in, rad out.
    pub fn angle(self, key: &str, deg: f64, joint: usize, limits: &Limits) -> Result<f64, ConfigError> {
        let (low, high) = (limits.q_min[joint], limits.q_max[joint]);
        let angle = deg.to_radians();
        if (low..=high).contains(&angle) {
            return Ok(angle);
        }
        let expected = format!("an angle from {} to {} deg", degrees(low), degrees(high));
        let got = format!("{deg} for joint {}", joint + 1);
        Err(self.refuse(key, expected, got, "stay inside the limits in robot.toml"))
    }

    /// `value` must be above `low`, the value of another key.
    pub fn above(self, key: &str, value: f64, low: f64, low_key: &str) -> Result<(), ConfigError> {
        if value > low {
            return Ok(());
        }
        let fix = format!("raise it or lower {low_key}");
        Err(self.refuse(key, format!("more than the {low} of {low_key}"), value, &fix))
    }
}

/// An angle as a message shows it: deg, without the rounding errors of the way to rad and back.
pub(crate) fn degrees(rad: f64) -> f64 {
    (rad.to_degrees() * 1e6).round() / 1e6
}

const SEE_COMMENT: &str = "the comment at the key states its meaning and unit";

/// Dotted name of the key that stands, or whose value stands, at a byte of the text.
fn key_at(table: &DeTable<'_>, at: usize) -> Option<String> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_hold_up_to_their_ends() {
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let (above_0, below_1) = (f64::MIN_POSITIVE, 1.0_f64.next_down());
        let above_1 = 1.0_f64.next_up();
        for (rule, good, bad) in [
            (FINITE, &[0.0, f64::MAX, f64::MIN][..], &[nan, inf, -inf][..]),
            (POSITIVE, &[above_0, f64::MAX], &[0.0, -above_0, nan, inf]),
            (NON_NEGATIVE, &[0.0, f64::MAX], &[-above_0, nan, inf]),
            (NEGATIVE, &[-above_0, f64::MIN], &[0.0, above_0, nan, -inf]),
            (COUNT, &[1.0, 2.0, 1e6], &[0.0, 0.5, 1.5, 1e6 + 1.0, nan, inf]),
            (FRACTION, &[above_0, 1.0], &[0.0, above_1, nan]),
            (SHARE, &[0.0, 1.0], &[-above_0, above_1, nan]),
            (PART, &[0.0, below_1], &[-above_0, 1.0, nan]),
            (BELOW_ONE, &[above_0, below_1], &[0.0, 1.0, nan]),
            (DURATION, &[above_0, 60.0], &[0.0, 60.0_f64.next_up(), nan]),
            (FULL_TURN, &[-360.0, 360.0], &[-360.1, 360.1, nan]),
            (ACUTE, &[above_0, 90.0_f64.next_down()], &[0.0, 90.0, nan]),
        ] {
            let expected = rule.expected;
            good.iter().for_each(|v| assert!((rule.holds)(*v), "{expected}: {v}"));
            bad.iter().for_each(|v| assert!(!(rule.holds)(*v), "{expected}: {v}"));
        }
    }

    #[test]
    fn ranges_hold_up_to_their_ends() {
        let check = Check { file: "f" };
        let seconds = |v| check.seconds("k", v).is_ok();
        assert!(seconds(1e-9) && seconds(86_400.0));
        assert!(!seconds(0.0) && !seconds(86_400.1) && !seconds(f64::NAN));
        let whole = |v| check.integer::<u8>("k", v, 1..=300).is_ok();
        assert!(whole(1) && whole(255) && !whole(0) && !whole(256) && !whole(301));
        let above = |v| check.above("k", v, 1.0, "l").is_ok();
        assert!(above(1.1) && !above(1.0) && !above(f64::NAN));
        let mut limits = Limits {
            q_min: [-1.0; upswing_model::NQ].into(),
            q_max: [1.0; upswing_model::NQ].into(),
            qd_max: [1.0; upswing_model::NQ].into(),
            tau_max: [1.0; upswing_model::NU].into(),
        };
        (limits.q_min[8], limits.q_max[8]) = (-0.5, 0.25);
        let angle = |deg: f64| check.angle("k", deg, 8, &limits).is_ok();
        assert!(angle(14.0) && angle(-28.0) && !angle(15.0) && !angle(-29.0) && !angle(f64::NAN));
    }
}
