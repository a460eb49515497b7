//! Rules of single settings, as serde deserializers of their fields: a number is checked in the unit of the file, then converted to SI
//! units.

use serde::de::{Deserialize, Deserializer, Error};
use std::fmt::Display;
use std::time::Duration;
use upswing_model::Period;

/// A condition on a number of a settings file. Its functions deserialize a field, one function per unit.
pub(crate) trait Rule: Sized {
    /// Text of the condition in messages, after "expected".
    const EXPECTED: &'static str;

    /// True if a number, in the unit of the file, meets the condition.
    fn holds(value: f64) -> bool;

    /// Reads a quantity that is in its SI unit in the file.
    fn read<'de, D: Deserializer<'de>, Q: Quantity>(from: D) -> Result<Q, D::Error> {
        Q::read::<Self, D>(from, 1.0)
    }

    /// Reads a quantity in deg or deg/s; returns rad or rad/s.
    fn degrees<'de, D: Deserializer<'de>, Q: Quantity>(from: D) -> Result<Q, D::Error> {
        Q::read::<Self, D>(from, 1_f64.to_radians())
    }

    /// Reads a quantity in ms; returns s.
    fn milli<'de, D: Deserializer<'de>, Q: Quantity>(from: D) -> Result<Q, D::Error> {
        Q::read::<Self, D>(from, 1e-3)
    }

    /// Reads a rate per ms; returns a rate per s.
    fn per_milli<'de, D: Deserializer<'de>, Q: Quantity>(from: D) -> Result<Q, D::Error> {
        Q::read::<Self, D>(from, 1e3)
    }
}

macro_rules! rules {
    ($($name:ident: $expected:literal, $holds:expr;)*) => {$(
        #[doc = concat!("Allows ", $expected, ".")]
        pub(crate) struct $name;

        impl Rule for $name {
            const EXPECTED: &'static str = $expected;

            fn holds(value: f64) -> bool {
                let holds: fn(f64) -> bool = $holds;
                holds(value)
            }
        }
    )*};
}

rules! {
    Finite: "a finite number", f64::is_finite;
    Positive: "a finite number above 0", |v| v.is_finite() && v > 0.0;
    NonNegative: "a finite number, 0 or above", |v| v.is_finite() && v >= 0.0;
    Negative: "a finite number below 0", |v| v.is_finite() && v < 0.0;
    Count: "a whole number from 1 to 1000000", |v| (1.0..=1e6).contains(&v) && v.fract() == 0.0;
    PositiveShare: "a share in (0, 1]", |v| v > 0.0 && v <= 1.0;
    Share: "a share in [0, 1]", |v| (0.0..=1.0).contains(&v);
    ShareBelowOne: "a share in [0, 1)", |v| (0.0..1.0).contains(&v);
    BetweenZeroAndOne: "a number between 0 and 1, both excluded", |v| v > 0.0 && v < 1.0;
    MotionTime: "a duration above 0 and at most 60 s", |v| v > 0.0 && v <= 60.0;
    WaitingTime: "a time above 0 and at most 86400 s", |v| v > 0.0 && v <= 86_400.0;
    QuarterTurn: "an angle above 0 and below pi/2 rad", |v| v > 0.0 && v < std::f64::consts::FRAC_PI_2;
    Angle: "an angle from -360 to 360 deg", |v| (-360.0..=360.0).contains(&v);
    // Beyond, sums of positions would lose digits that the checks of equilibria need.
    Position: "a position from -100000 to 100000", |v| v.abs() <= 1e5;
    Margin: "a margin from 0 to 100000", |v| (0.0..=1e5).contains(&v);
}

/// Type of a field whose numbers all meet one [`Rule`]: a number, a vector over joints, a point, a time, a level.
pub(crate) trait Quantity: Sized {
    /// Reads the numbers, checks each against the rule `R` and multiplies it by `unit`.
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error>;
}

impl Quantity for f64 {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        let value = Self::deserialize(from)?;
        if R::holds(value) { Ok(value * unit) } else { Err(refused(R::EXPECTED, value)) }
    }
}

/// A key that may be absent, with `#[serde(default)]`.
impl<Q: Quantity> Quantity for Option<Q> {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        Q::read::<R, D>(from, unit).map(Some)
    }
}

/// The coordinates of a point.
impl Quantity for [f64; 3] {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        let coordinates: Self = Vec::deserialize(from)?.try_into().map_err(|list: Vec<f64>| {
            refused("3 numbers, for x, y and z", format!("{}: give one number per coordinate", list.len()))
        })?;
        match coordinates.iter().zip(["x", "y", "z"]).find(|(value, _)| !R::holds(**value)) {
            Some((value, name)) => Err(refused(R::EXPECTED, format!("{value} for {name}"))),
            None => Ok(coordinates.map(|value| value * unit)),
        }
    }
}

/// Rules of times must have an upper bound: conversion of a larger number panics.
impl Quantity for Duration {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        f64::read::<R, D>(from, unit).map(Self::from_secs_f64)
    }
}

/// Allows whole numbers from `LOW` to `HIGH`. Its functions deserialize a field.
pub(crate) struct Whole<const LOW: i64, const HIGH: i64>;

impl<const LOW: i64, const HIGH: i64> Whole<LOW, HIGH> {
    /// Reads a whole number.
    pub fn read<'de, D: Deserializer<'de>, T: TryFrom<i64>>(from: D) -> Result<T, D::Error> {
        let value = i64::deserialize(from)?;
        let allowed = (LOW..=HIGH).contains(&value).then(|| T::try_from(value).ok()).flatten();
        allowed.ok_or_else(|| refused(format!("a whole number from {LOW} to {HIGH}"), value))
    }

    /// Reads a time, a whole number of ms.
    pub fn millis<'de, D: Deserializer<'de>>(from: D) -> Result<Duration, D::Error> {
        Self::read(from).map(Duration::from_millis)
    }

    /// Reads a control period, a whole number of us.
    pub fn period<'de, D: Deserializer<'de>>(from: D) -> Result<Period, D::Error> {
        Self::read(from).map(Period::from_micros)
    }
}

/// The error of a value that violates its rule.
pub(crate) fn refused<E: Error>(expected: impl Display, got: impl Display) -> E {
    E::custom(format_args!("expected {expected}, got {got}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::IntoDeserializer;
    use serde::de::value::Error;

    fn holds_up_to_its_ends<R: Rule>(good: &[f64], bad: &[f64]) {
        good.iter().for_each(|v| assert!(R::holds(*v), "{}: {v}", R::EXPECTED));
        bad.iter().for_each(|v| assert!(!R::holds(*v), "{}: {v}", R::EXPECTED));
    }

    #[test]
    fn rules_hold_up_to_their_ends() {
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let (above_0, below_1) = (f64::MIN_POSITIVE, 1.0_f64.next_down());
        let above_1 = 1.0_f64.next_up();
        holds_up_to_its_ends::<Finite>(&[0.0, f64::MAX, f64::MIN], &[nan, inf, -inf]);
        holds_up_to_its_ends::<Positive>(&[above_0, f64::MAX], &[0.0, -above_0, nan, inf]);
        holds_up_to_its_ends::<NonNegative>(&[0.0, f64::MAX], &[-above_0, nan, inf]);
        holds_up_to_its_ends::<Negative>(&[-above_0, f64::MIN], &[0.0, above_0, nan, -inf]);
        holds_up_to_its_ends::<Count>(&[1.0, 2.0, 1e6], &[0.0, 0.5, 1.5, 1e6 + 1.0, nan, inf]);
        holds_up_to_its_ends::<PositiveShare>(&[above_0, 1.0], &[0.0, above_1, nan]);
        holds_up_to_its_ends::<Share>(&[0.0, 1.0], &[-above_0, above_1, nan]);
        holds_up_to_its_ends::<ShareBelowOne>(&[0.0, below_1], &[-above_0, 1.0, nan]);
        holds_up_to_its_ends::<BetweenZeroAndOne>(&[above_0, below_1], &[0.0, 1.0, nan]);
        holds_up_to_its_ends::<MotionTime>(&[above_0, 60.0], &[0.0, 60.0_f64.next_up(), nan]);
        holds_up_to_its_ends::<WaitingTime>(&[1e-9, 86_400.0], &[0.0, 86_400.1, nan]);
        let quarter = std::f64::consts::FRAC_PI_2;
        holds_up_to_its_ends::<QuarterTurn>(&[above_0, quarter.next_down()], &[0.0, quarter, nan]);
        holds_up_to_its_ends::<Angle>(&[-360.0, 360.0], &[-360.1, 360.1, nan]);
        holds_up_to_its_ends::<Position>(&[-1e5, 1e5], &[1e5_f64.next_up(), nan, -inf]);
        holds_up_to_its_ends::<Margin>(&[0.0, 1e5], &[-above_0, 1e5_f64.next_up(), nan]);
    }

    #[test]
    fn whole_numbers_hold_up_to_their_ends_and_those_of_their_type() {
        let read = |v: i64| Whole::<1, 300>::read::<_, u8>(IntoDeserializer::<Error>::into_deserializer(v));
        assert!(read(1).is_ok() && read(255).is_ok());
        assert!(read(0).is_err() && read(256).is_err() && read(301).is_err());
    }

    #[test]
    fn units_become_si() {
        let of = |v: f64| IntoDeserializer::<Error>::into_deserializer(v);
        assert_eq!(Angle::degrees(of(-95.0)), Ok((-95_f64).to_radians()));
        assert_eq!(Positive::milli(of(12.0)), Ok(0.012));
        assert_eq!(Positive::per_milli(of(4.0)), Ok(4e3));
        assert_eq!(WaitingTime::read(of(2.5)), Ok(Duration::from_millis(2500)));
    }
}
