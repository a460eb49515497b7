//! Faults of the simulated plant and pushes on its rod, each at given cycles.

use crate::MAX_DELAY;
use crate::rule::{Finite, Rule, Whole};
use serde::Deserialize;
use upswing_model::{Model, Sizes};

/// Kind of a plant fault; the index of a variant is its code in shared memory. Simultaneous faults act in the order of the variants.
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
    /// All kinds of faults, in the order of their codes.
    pub fn all() -> &'static [Self] {
        clap::ValueEnum::value_variants()
    }

    /// Code of the kind in shared memory.
    pub const fn code(self) -> u64 {
        self as u64
    }

    /// Number of joints that this kind can concern, the first ones of the model's vectors; 0 for kinds without a joint.
    const fn joints(self, sizes: Sizes) -> usize {
        match self {
            Self::EncoderStuck | Self::EncoderJump | Self::EncoderNan => sizes.joints(),
            Self::ArmTorque => sizes.actuated(),
            _ => 0,
        }
    }

    /// Index in the model's vectors of the joint `name` of a fault of this kind; 0 for kinds without a joint.
    ///
    /// # Errors
    /// [`FaultJointError`] if the kind needs a joint and `name` is none that it can concern, or if it needs none and has one.
    pub fn joint(self, name: Option<&str>, model: &Model) -> Result<usize, FaultJointError> {
        let joints = self.joints(model.sizes());
        match (joints, name) {
            (0, None) => Ok(0),
            (0, Some(got)) => Err(FaultJointError::Needless { got: got.into() }),
            (_, name) => {
                let found = (0..joints).find(|joint| Some(model.joint_name(*joint)) == name);
                found.ok_or_else(|| FaultJointError::Unknown {
                    expected: (0..joints).map(|joint| model.joint_name(joint).into()).collect(),
                    got: name.map(Into::into),
                })
            }
        }
    }
}

/// A fault of the simulated plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// First cycle, counted from 1.
    pub from: u64,
    /// Duration, cycles; 0: until the fault is cleared.
    pub cycles: u64,
    /// Index of the joint in the model's vectors; 0 for kinds without a joint.
    pub joint: usize,
    /// Amount: cycles (`DelayMeasurement`, 1..=[`MAX_DELAY`]), rad or m (`EncoderJump`, not 0), N m or N (`ArmTorque`, not 0); else
    /// unused.
    pub amount: f64,
}

impl Fault {
    /// A fault of a kind that needs neither joint nor amount.
    pub fn new(kind: FaultKind, from: u64, cycles: u64) -> Self {
        Self { kind, from, cycles, joint: 0, amount: 0.0 }
    }

    /// True if the fault acts in `cycle`, counted from 1.
    pub fn acts(&self, cycle: u64) -> bool {
        cycle >= self.from && (self.cycles == 0 || cycle - self.from < self.cycles)
    }

    /// Checks that joint and amount suit the kind of the fault, for a robot with `sizes`.
    ///
    /// # Errors
    /// [`EventError`] with the expected and the actual value.
    pub fn check(&self, sizes: Sizes) -> Result<(), EventError> {
        let joints = self.kind.joints(sizes);
        if joints > 0 && self.joint >= joints {
            return Err(EventError::Joint { most: joints, got: self.joint.wrapping_add(1) });
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

/// A fault as written in a scenario file, without the keys that its kind does not need.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FaultInFile {
    kind: FaultKind,
    #[serde(rename = "from_cycle", deserialize_with = "Whole::<1, MOST_CYCLES>::read")]
    from: u64,
    #[serde(default, deserialize_with = "Whole::<0, MOST_CYCLES>::read")]
    cycles: u64,
    joint: Option<String>,
    #[serde(default)]
    amount: f64,
}

/// Largest cycle number in a scenario, beyond the lifetime of any plant process.
const MOST_CYCLES: i64 = 1_000_000_000_000;

/// Error of the joint of a fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultJointError {
    /// A kind without a joint has one.
    #[error("joint: expected none for this kind, got `{got}`: only encoders and torques have a joint")]
    Needless {
        /// The joint.
        got: String,
    },
    /// A kind that concerns a joint has none that it can concern.
    #[error(
        "joint: expected one of {}, got {}: name one of these joints",
        .expected.join(", "),
        .got.as_ref().map_or_else(|| "none".into(), |got| format!("`{got}`"))
    )]
    Unknown {
        /// Names of the joints that the kind can concern.
        expected: Vec<String>,
        /// The joint; `None`: none was given.
        got: Option<String>,
    },
}

/// Error of a fault in a scenario file or on the command line; its text begins with the name of a key.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FaultError {
    /// The joint does not suit the kind.
    #[error(transparent)]
    Joint(#[from] FaultJointError),
    /// The amount does not suit the kind.
    #[error(transparent)]
    Event(#[from] EventError),
}

impl FaultInFile {
    /// The fault, for the robot `model`.
    pub fn fault(self, model: &Model) -> Result<Fault, FaultError> {
        let Self { kind, from, cycles, joint, amount } = self;
        let fault = Fault { kind, from, cycles, joint: kind.joint(joint.as_deref(), model)?, amount };
        fault.check(model.sizes())?;
        Ok(fault)
    }
}

/// A push on the tip of the rod: a constant force for some cycles.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Push {
    /// First cycle, counted from 1.
    #[serde(rename = "from_cycle", deserialize_with = "Whole::<1, MOST_CYCLES>::read")]
    pub from: u64,
    /// Duration, cycles, at least 1.
    #[serde(deserialize_with = "Whole::<1, MOST_CYCLES>::read")]
    pub cycles: u64,
    /// Force times its duration, world frame (z up), N s.
    #[serde(rename = "impulse_ns", deserialize_with = "Finite::read")]
    pub impulse: [f64; 3],
}

impl Push {
    /// True if the push acts in `cycle`, counted from 1.
    pub fn acts(&self, cycle: u64) -> bool {
        cycle >= self.from && cycle - self.from < self.cycles
    }

    /// Checks that the push has a duration and a finite impulse.
    ///
    /// # Errors
    /// [`EventError`] with the expected and the actual value.
    pub fn check(&self) -> Result<(), EventError> {
        if self.cycles == 0 {
            return Err(EventError::Duration);
        }
        self.impulse
            .iter()
            .find(|v| !v.is_finite())
            .map_or(Ok(()), |got| Err(EventError::Impulse { got: *got }))
    }
}

/// Error of a fault or a push that the plant cannot simulate.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EventError {
    /// The joint does not exist for this kind of fault.
    #[error("joint: expected 1 to {most}, got {got}")]
    Joint {
        /// Last joint of the kind, counted from 1.
        most: usize,
        /// The joint of the fault, counted from 1.
        got: usize,
    },
    /// The delay is no whole number of cycles, or too long.
    #[error("amount: expected a whole number of cycles from 1 to {MAX_DELAY}, got {got}")]
    Delay {
        /// The delay, cycles.
        got: f64,
    },
    /// The jump is 0, NaN or infinite.
    #[error("amount: expected a finite number other than 0, rad, got {got}")]
    Jump {
        /// The jump, rad.
        got: f64,
    },
    /// The torque is 0, NaN or infinite.
    #[error("amount: expected a finite number other than 0, N m, got {got}")]
    Torque {
        /// The torque, N m.
        got: f64,
    },
    /// The amount is NaN or infinite.
    #[error("amount: expected a finite number, got {got}")]
    Amount {
        /// The amount.
        got: f64,
    },
    /// The push has no duration.
    #[error("cycles: expected 1 or more for a push, got 0")]
    Duration,
    /// The impulse is NaN or infinite.
    #[error("impulse: expected three finite numbers, N s, got {got}")]
    Impulse {
        /// The component that is not finite, N s.
        got: f64,
    },
}
