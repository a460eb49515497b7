//! Variations of a robustness curve: one error or disturbance, its values and its effect on settings and runs.

use crate::closed_loop::{Disturbances, MissedCycles};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use upswing_config::{Config, MAX_DELAY, Push};

/// Time in Balance before a push or a stretch of missed cycles, s.
const BEFORE: f64 = 0.5;
/// Additional time in Balance for these disturbances, s, so that the evaluated last second is well after them.
const LONGER: f64 = 1.0;
/// Duration of a push, s.
const PUSH: f64 = 0.01;

/// Varied quantity of a robustness curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Variation {
    /// Error of all masses and inertias of the arm, %
    ArmMass,
    /// Error of masses and inertias of the pendulum, %
    PendulumMass,
    /// Error of the rod's length, %
    PendulumLength,
    /// Resolution of the pendulum's encoders, bits per turn
    EncoderBits,
    /// Delay of commands, cycles
    TorqueDelay,
    /// Time constant T_1 of the velocity filter, ms (a setting of the controller)
    VelocityFilter,
    /// Share of the arm's friction that the drives do not compensate, %
    Friction,
    /// Horizontal push on the tip of the rod in Balance, in a direction drawn for each start, N s
    Push,
    /// Horizontal push on the tip of the rod at a moment of the swing-up, from a tenth to nine tenths of the plan, in a direction; both drawn for
    /// each start, N s
    PushSwingUp,
    /// Cycles missed in a row, at a moment of the swing-up drawn for each start
    MissedSwingUp,
    /// Cycles missed in a row in Balance
    MissedBalance,
    /// Random gaps of missed cycles from a recorded histogram (--missed), with their frequency times this factor
    Jitter,
}

/// Error: a value is outside the range of its variation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{label}: expected {} from {lowest} to {highest}, got {value}", if *whole { "a whole number" } else { "a number" })]
pub struct ValueError {
    label: &'static str,
    whole: bool,
    lowest: f64,
    highest: f64,
    value: f64,
}

/// Recorded histogram of missed cycles; a part of the output of `upswing soak --json`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct MissedCycleCounts {
    /// Number of cycles recorded.
    pub cycles: u64,
    /// Number of consecutive missed cycles to number of occurrences.
    pub missed: BTreeMap<u64, u64>,
}

impl MissedCycleCounts {
    /// Draws stretches of missed cycles for `count` cycles, `factor` times as frequent as recorded. `shares`: random numbers in [0, 1).
    fn draw(&self, factor: f64, count: u64, shares: &mut impl Iterator<Item = f64>) -> Vec<MissedCycles> {
        let stretches: u64 = self.missed.values().sum();
        let probability = factor * stretches as f64 / self.cycles as f64;
        let mut drawn = Vec::new();
        let mut cycle = 0;
        while cycle < count {
            if shares.next().is_some_and(|share| share < probability) {
                let mut rank = (shares.next().unwrap_or(0.0) * stretches as f64) as u64;
                let length = self.missed.iter().find_map(|(length, n)| {
                    let found = rank < *n;
                    rank = rank.saturating_sub(*n);
                    found.then_some(*length)
                });
                let missed = MissedCycles { from: cycle, cycles: length.unwrap_or(1) };
                cycle = cycle.saturating_add(missed.cycles);
                drawn.push(missed);
            }
            cycle += 1;
        }
        drawn
    }
}

impl Variation {
    /// Label for axes and tables, with the unit.
    pub fn label(self) -> &'static str {
        match self {
            Self::ArmMass => "mass of the arm, error (%)",
            Self::PendulumMass => "mass of the pendulum, error (%)",
            Self::PendulumLength => "length of the rod, error (%)",
            Self::EncoderBits => "encoders of the pendulum (bits)",
            Self::TorqueDelay => "delay of the torque (cycles)",
            Self::VelocityFilter => "time constant of the filter (ms)",
            Self::Friction => "friction left to the arm (%)",
            Self::Push => "push in Balance (N s)",
            Self::PushSwingUp => "push in the swing-up (N s)",
            Self::MissedSwingUp => "cycles missed in the swing-up",
            Self::MissedBalance => "cycles missed in Balance",
            Self::Jitter => "frequency of recorded misses (factor)",
        }
    }

    /// Default values of a curve, in the unit of the variation.
    pub fn values(self) -> &'static [f64] {
        match self {
            Self::ArmMass | Self::PendulumMass | Self::PendulumLength => {
                &[-20.0, -15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 20.0]
            }
            Self::EncoderBits => &[12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 20.0],
            Self::TorqueDelay => &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0],
            Self::VelocityFilter => &[2.0, 5.0, 8.0, 12.0, 15.0, 18.0, 20.0],
            Self::Friction => &[0.0, 20.0, 40.0, 60.0, 80.0, 100.0],
            Self::Push | Self::PushSwingUp => &[0.0, 0.02, 0.04, 0.06, 0.08, 0.1],
            Self::MissedSwingUp | Self::MissedBalance => &[0.0, 5.0, 10.0, 15.0, 20.0, 21.0, 25.0],
            Self::Jitter => &[0.0, 1.0, 10.0, 100.0, 1000.0],
        }
    }

    /// Checks that the value is within the range of this variation.
    ///
    /// # Errors
    /// [`ValueError`] with the range if the value is outside.
    pub fn check(self, value: f64) -> Result<(), ValueError> {
        let (lowest, highest, whole) = match self {
            Self::ArmMass | Self::PendulumMass | Self::PendulumLength => (-90.0, 1000.0, false),
            Self::EncoderBits => (1.0, 32.0, true),
            Self::TorqueDelay => (0.0, f64::from(MAX_DELAY), true),
            Self::VelocityFilter => (0.2, 1000.0, false),
            Self::Friction => (0.0, 100.0, false),
            Self::Push | Self::PushSwingUp => (0.0, 100.0, false),
            Self::MissedSwingUp | Self::MissedBalance => (0.0, 8000.0, true),
            Self::Jitter => (0.0, 1e6, false),
        };
        // A NaN is in no range.
        if (lowest..=highest).contains(&value) && !(whole && value.fract() != 0.0) {
            return Ok(());
        }
        Err(ValueError { label: self.label(), whole, lowest, highest, value })
    }

    /// Time in Balance, s: `seconds`, or longer for disturbances in Balance.
    pub fn seconds(self, seconds: f64) -> f64 {
        match self {
            Self::Push | Self::MissedBalance => seconds + LONGER,
            _ => seconds,
        }
    }

    /// Applies a value that [`Self::check`] accepts to the settings of plant and controller.
    pub fn apply(self, value: f64, config: &mut Config) {
        let scale = 1.0 + 0.01 * value;
        let plant = &mut config.plant;
        match self {
            Self::ArmMass => plant.model.actuated_mass_scale *= scale,
            Self::PendulumMass => plant.model.unactuated_mass_scale *= scale,
            Self::PendulumLength => plant.model.unactuated_length_scale *= scale,
            Self::EncoderBits => {
                plant.encoder.resolution.unactuated_mut().fill(std::f64::consts::TAU * libm::exp2(-value));
            }
            Self::TorqueDelay => plant.drive.command_delay = value as u32,
            Self::VelocityFilter => config.daemon.cycle.velocity_filter = 1e-3 * value,
            Self::Friction => plant.friction.compensation = 1.0 - 0.01 * value,
            Self::Push | Self::PushSwingUp | Self::MissedSwingUp | Self::MissedBalance | Self::Jitter => {}
        }
    }

    /// The disturbances of a run after the start of a plan of the duration `t_f` (s), balanced for `seconds` (s), in cycles of `period`
    /// (s). `misses`: histogram for [`Self::Jitter`]; `shares`: random numbers in [0, 1).
    pub fn disturbances(
        self,
        value: f64,
        t_f: f64,
        seconds: f64,
        period: f64,
        misses: &MissedCycleCounts,
        mut shares: impl Iterator<Item = f64>,
    ) -> Disturbances {
        let cycle = |time: f64| (time / period).round() as u64;
        let mut share = || shares.next().unwrap_or(0.0);
        let stretch = |from: f64| vec![MissedCycles { from: cycle(from), cycles: value as u64 }];
        let mut disturbances = Disturbances::default();
        match self {
            Self::Push | Self::PushSwingUp => {
                let (sin, cos) = libm::sincos(std::f64::consts::TAU * share());
                let from = if self == Self::Push { t_f + BEFORE } else { t_f * (0.1 + 0.8 * share()) };
                disturbances.pushes.push(Push {
                    from: cycle(from),
                    cycles: cycle(PUSH).max(1),
                    impulse: [value * cos, value * sin, 0.0],
                });
            }
            Self::MissedSwingUp => disturbances.missed = stretch(share() * t_f),
            Self::MissedBalance => disturbances.missed = stretch(t_f + BEFORE),
            Self::Jitter => disturbances.missed = misses.draw(value, cycle(t_f + seconds), &mut shares),
            _ => {}
        }
        disturbances
    }
}
