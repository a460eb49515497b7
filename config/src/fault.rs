//! What breaks, and what pushes: events of the simulated plant at cycle numbers.

use crate::MAX_DELAY;
use serde::Deserialize;
use upswing_model::{NQ, NU};

/// Kind of a fault; the index of a variant is its code in shared memory. Simultaneous faults act in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// No measurement arrives.
    DropMeasurement,
    /// Each measurement arrives `amount` cycles late.
    DelayMeasurement,
    /// Every second measurement, beginning with the first, is replaced by a copy of the previous one.
    DuplicateMeasurement,
    /// Every second measurement is replaced by an older one, so that the order changes.
    ReorderMeasurement,
    /// Angles and torques keep their values; sequence number and time stamp advance.
    FreezeMeasurement,
    /// The time stamp keeps its value; everything else advances.
    StaleTime,
    /// The angle of `joint` keeps its value.
    EncoderStuck,
    /// The angle of `joint` is off by `amount`, rad.
    EncoderJump,
    /// The angle of `joint` is NaN.
    EncoderNan,
    /// No command reaches the drives.
    LoseCommand,
    /// An external torque of `amount`, N m, acts on `joint` of the arm, as in a push or a collision.
    ArmTorque,
}

impl FaultKind {
    /// Every kind.
    pub fn all() -> &'static [Self] {
        clap::ValueEnum::value_variants()
    }

    /// The number that stands for this kind in shared memory.
    pub const fn code(self) -> u64 {
        self as u64
    }

    /// Whether it concerns one joint.
    pub const fn has_joint(self) -> bool {
        self.joints() > 0
    }

    /// How many joints, from the first on, it can concern.
    const fn joints(self) -> usize {
        match self {
            Self::EncoderStuck | Self::EncoderJump | Self::EncoderNan => NQ,
            Self::ArmTorque => NU,
            _ => 0,
        }
    }
}

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// What breaks.
    pub kind: FaultKind,
    /// First cycle, counted from 1.
    pub from: u64,
    /// How many cycles it lasts; 0: until it is cleared.
    pub cycles: u64,
    /// The joint, counted from 0, of the kinds that concern one.
    pub joint: usize,
    /// Cycles (`DelayMeasurement`, 1..=[`MAX_DELAY`]), rad (`EncoderJump`, not 0) or N m (`ArmTorque`, not 0).
    pub amount: f64,
}

impl Fault {
    /// Of a kind that needs neither joint nor amount.
    pub fn new(kind: FaultKind, from: u64, cycles: u64) -> Self {
        Self { kind, from, cycles, joint: 0, amount: 0.0 }
    }

    /// Whether it acts in a cycle.
    pub fn acts(&self, cycle: u64) -> bool {
        cycle >= self.from && (self.cycles == 0 || cycle - self.from < self.cycles)
    }

    /// Fails unless joint and amount suit the kind.
    ///
    /// # Errors
    /// [`EventError`] with what was expected and what came.
    pub fn check(&self) -> Result<(), EventError> {
        if self.kind.has_joint() && self.joint >= self.kind.joints() {
            return Err(EventError::Joint { most: self.kind.joints(), got: self.joint.wrapping_add(1) });
        }
        let amount = self.amount;
        match self.kind {
            FaultKind::DelayMeasurement
                if !(amount.fract() == 0.0 && (1.0..=f64::from(MAX_DELAY)).contains(&amount)) =>
            {
                Err(EventError::Delay { got: amount })
            }
            FaultKind::EncoderJump if !(amount.is_finite() && amount != 0.0) => {
                Err(EventError::Jump { got: amount })
            }
            FaultKind::ArmTorque if !(amount.is_finite() && amount != 0.0) => {
                Err(EventError::Torque { got: amount })
            }
            _ if !amount.is_finite() => Err(EventError::Amount { got: amount }),
            _ => Ok(()),
        }
    }
}

/// A push on the tip of the rod: a constant force over some cycles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// First cycle, counted from 1.
    pub from: u64,
    /// How many cycles it lasts, at least 1.
    pub cycles: u64,
    /// Force times its duration, world frame (z up), N s.
    pub impulse: [f64; 3],
}

impl Push {
    /// Whether it acts in a cycle.
    pub fn acts(&self, cycle: u64) -> bool {
        cycle >= self.from && cycle - self.from < self.cycles
    }

    /// Fails unless it has a duration and an impulse.
    ///
    /// # Errors
    /// [`EventError`] with what was expected and what came.
    pub fn check(&self) -> Result<(), EventError> {
        if self.cycles == 0 {
            return Err(EventError::Duration);
        }
        match self.impulse.iter().find(|v| !v.is_finite()) {
            Some(got) => Err(EventError::Impulse { got: *got }),
            None => Ok(()),
        }
    }
}

/// Why a fault or a push cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EventError {
    /// No such joint.
    #[error("joint: expected 1 to {most}, got {got}")]
    Joint {
        /// The last one that there is for the kind.
        most: usize,
        /// What came, counted from 1.
        got: usize,
    },
    /// A delay that is no number of cycles, or too long.
    #[error("amount: expected a whole number of cycles from 1 to {MAX_DELAY}, got {got}")]
    Delay {
        /// What came.
        got: f64,
    },
    /// A jump by nothing, or by what is no number.
    #[error("amount: expected a finite number other than 0, rad, got {got}")]
    Jump {
        /// What came.
        got: f64,
    },
    /// No torque, or one that is no number.
    #[error("amount: expected a finite number other than 0, N m, got {got}")]
    Torque {
        /// What came.
        got: f64,
    },
    /// An amount that is not a number.
    #[error("amount: expected a finite number, got {got}")]
    Amount {
        /// What came.
        got: f64,
    },
    /// A push without duration.
    #[error("cycles: expected 1 or more for a push, got 0")]
    Duration,
    /// An impulse that is not a number.
    #[error("impulse: expected three finite numbers, N s, got {got}")]
    Impulse {
        /// What came.
        got: f64,
    },
}
