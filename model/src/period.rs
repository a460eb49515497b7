//! The sampling period of the control cycle.

use std::fmt;

/// The sampling period T_s of the control cycle (Section VI), a whole number of microseconds above 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Period {
    ns: u64,
}

impl Period {
    /// A period of `us` microseconds; of 1 us for 0.
    pub const fn from_micros(us: u32) -> Self {
        Self { ns: if us == 0 { 1000 } else { us as u64 * 1000 } }
    }

    /// T_s, ns.
    pub const fn nanos(self) -> u64 {
        self.ns
    }

    /// T_s, s.
    pub const fn seconds(self) -> f64 {
        self.nanos() as f64 / 1e9
    }

    /// T_s, us.
    pub const fn micros(self) -> f64 {
        self.nanos() as f64 / 1e3
    }

    /// The time that `cycles` cycles take, ns; the largest number if it is longer than that.
    pub const fn nanos_of(self, cycles: u64) -> u64 {
        self.nanos().saturating_mul(cycles)
    }

    /// The time that `cycles` cycles take, s.
    pub const fn seconds_of(self, cycles: u64) -> f64 {
        cycles as f64 * self.seconds()
    }

    /// The fewest cycles that take at least `seconds` (s); 0 for a negative time.
    pub fn cycles_in(self, seconds: f64) -> u64 {
        (seconds / self.seconds()).ceil() as u64
    }

    /// The number of cycles that comes nearest to `seconds` (s); 0 for a negative time.
    pub fn nearest_cycles(self, seconds: f64) -> u64 {
        (seconds / self.seconds()).round() as u64
    }
}

impl fmt::Display for Period {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} us", self.micros())
    }
}

#[cfg(test)]
mod tests {
    use super::Period;

    #[test]
    fn times_and_cycles_convert_both_ways() {
        let period = Period::from_micros(125);
        assert_eq!((period.seconds(), period.micros(), period.to_string()), (125e-6, 125.0, "125 us".into()));
        assert_eq!((period.nanos_of(8000), period.seconds_of(8000)), (1_000_000_000, 1.0));
        assert_eq!(period.nanos_of(u64::MAX), u64::MAX);
        assert_eq!([0.0, 1e-6, 125e-6, 126e-6, -1.0].map(|s| period.cycles_in(s)), [0, 1, 1, 2, 0]);
        assert_eq!([0.0, 62e-6, 63e-6, 1.0, -1.0].map(|s| period.nearest_cycles(s)), [0, 0, 1, 8000, 0]);
        assert_eq!(Period::from_micros(0).nanos(), 1000);
    }
}
