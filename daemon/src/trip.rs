//! Causes of warnings and of trips to Fault or Stop: the limits that the daemon checks.

use upswing_model::{LimitKind, Model};

/// Defines the causes, each with its code and its text.
macro_rules! causes {
    ($($(#[$doc:meta])+ $name:ident = $code:literal, $text:literal;)+) => {
        /// A limit that the daemon checks. docs/daemon.md states which limits trip to Fault, which trip to Stop, and which only
        /// refuse the start of a plan.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u64)]
        pub enum TripCause {
            $($(#[$doc])+ $name = $code),+
        }

        impl TripCause {
            /// All causes; the index is the code minus 1.
            pub const ALL: [Self; [$($code),+].len()] = [$(Self::$name),+];

            /// Description of the cause without the numbers of a [`Trip`].
            pub const fn text(self) -> &'static str {
                match self { $(Self::$name => $text),+ }
            }
        }
    };
}

causes! {
    /// No measurement has come yet.
    NoMeasurement = 1, "no measurement received yet: is the plant running?";
    /// The newest measurement is too old.
    StaleMeasurement = 2, "no new measurement";
    /// Too many measurements were missed between two that came.
    MeasurementGap = 3, "measurements were missed";
    /// The plant restarted: its measurements do not continue the earlier ones.
    MeasurementRestarted = 4, "the plant restarted";
    /// A position is not finite, or beyond the range of an encoder.
    NotFinite = 5, "an angle is not finite";
    /// An angle changed faster than the joint can move.
    EncoderJump = 6, "an angle jumped";
    /// The position of an actuated joint is too far past the range open to plans.
    PositionLimit = 7, "an actuated joint is beyond a position limit";
    /// An actuated joint is too fast.
    VelocityLimit = 8, "an actuated joint is beyond a velocity limit";
    /// A measured torque is too high, or not finite.
    TorqueLimit = 9, "a measured torque is too high";
    /// The commanded torque changes too fast.
    TorqueRate = 10, "the commanded torque changes too fast";
    /// A drive reports a fault.
    DriveFault = 11, "a drive reports a fault";
    /// The brakes are closed or the drives not ready, although the command opens the brakes.
    DrivesStopped = 12, "the drives do not act";
    /// The plant and the daemon have different control periods.
    PeriodMismatch = 13, "plant and daemon have different periods";
    /// The plant states a clock that does not exist.
    UnknownClock = 14, "the plant names an unknown clock";
    /// The control law gave no finite torque.
    LawNotFinite = 15, "the control law gave no finite torque";
    /// An angle is too far from its reference.
    TrackingError = 16, "too far from the reference";
    /// The unactuated joints are too far from their positions at the end of the plan.
    BalanceLost = 17, "the balance is lost";
    /// The position of an unactuated joint is too far past the range open to plans.
    PendulumRange = 18, "an unactuated joint is beyond the range open to plans";
    /// Too many consecutive cycles were overruns.
    LateCycles = 19, "cycles end late";
    /// The loaded plan is too old to be started.
    PlanAge = 20, "the loaded plan is old";
    /// An angle does not change although the torque must have moved its joint.
    StuckEncoder = 21, "an encoder is stuck";
    /// To keep the balance an actuated joint would have to move too fast.
    BalanceSpeed = 22, "the balance is lost: an actuated joint would have to move too fast";
    /// An unexplained torque acts on the arm: a person or an object is in its way.
    Collision = 23, "something is in the robot's way";
    /// No angle and no measured torque changes, although the commanded torque does.
    FrozenMeasurement = 24, "the measurements are frozen";
    /// The measurements are those of another chain.
    OtherChain = 25, "plant and daemon have different joints";
}

// `fault_text` finds a cause by its code.
const _: () = {
    let mut i = 0;
    while i < TripCause::ALL.len() {
        assert!(TripCause::ALL[i].code() == i as u64 + 1);
        i += 1;
    }
};

impl TripCause {
    /// Code of the cause in telemetry, above 0.
    pub const fn code(self) -> u64 {
        self as u64
    }

    /// Remedy before the robot can be enabled, in a few words.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::NoMeasurement => "start a plant",
            Self::StaleMeasurement | Self::MeasurementGap | Self::MeasurementRestarted => {
                "wait until measurements arrive regularly"
            }
            Self::PositionLimit | Self::PendulumRange => "move the joint into its range",
            Self::PeriodMismatch | Self::UnknownClock => "start both with the same version",
            Self::OtherChain => "start both with the same robot",
            Self::DriveFault | Self::DrivesStopped => "clear the drives' fault",
            Self::NotFinite
            | Self::EncoderJump
            | Self::StuckEncoder
            | Self::FrozenMeasurement
            | Self::VelocityLimit
            | Self::TorqueLimit => "check the joint's sensors",
            Self::Collision => "remove the obstacle",
            Self::TorqueRate
            | Self::LawNotFinite
            | Self::TrackingError
            | Self::BalanceLost
            | Self::BalanceSpeed
            | Self::LateCycles
            | Self::PlanAge => "wait a moment",
        }
    }

    /// Bit of the cause in a `warnings` word.
    pub const fn bit(self) -> u64 {
        1 << (self.code() - 1)
    }
}

/// Description of the cause with the code `fault` of telemetry and answers; `None` for 0 and for unknown codes.
pub fn fault_text(code: u64) -> Option<&'static str> {
    let index = usize::try_from(code.checked_sub(1)?).ok()?;
    TripCause::ALL.get(index).map(|cause| cause.text())
}

/// Descriptions of the causes in a `warnings` word; unknown bits are skipped.
pub fn warning_texts(warnings: u64) -> impl Iterator<Item = &'static str> {
    TripCause::ALL.into_iter().filter(move |cause| warnings & cause.bit() != 0).map(TripCause::text)
}

/// Set of the limits whose warning levels were exceeded in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Warnings(u64);

impl Warnings {
    /// Adds a limit to the set.
    pub const fn insert(&mut self, cause: TripCause) {
        self.0 |= cause.bit();
    }

    /// Whether the set contains the limit.
    pub const fn contains(self, cause: TripCause) -> bool {
        self.0 & cause.bit() != 0
    }

    /// The set as the `warnings` word of telemetry: [`TripCause::bit`] of each limit.
    pub const fn bits(self) -> u64 {
        self.0
    }
}

/// Trip of a limit: a value beyond the trip level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trip {
    /// Limit that was exceeded.
    pub cause: TripCause,
    /// Index of the joint in sorted vectors; 0 for a limit of no joint.
    pub joint: usize,
    /// Value beyond the trip level: a position, velocity, torque or its rate in the unit of the joint, s, ns or a count, depending on the
    /// cause.
    pub value: f64,
    /// Trip level, in the unit of the value.
    pub limit: f64,
}

impl Trip {
    /// Creates a trip of a limit without joint and numbers.
    pub const fn plain(cause: TripCause) -> Self {
        Self { cause, joint: 0, value: 0.0, limit: 0.0 }
    }
}

impl Trip {
    /// The trip in words, with the name of its joint in `model`.
    pub fn text(&self, model: &Model) -> String {
        let Self { cause, joint, value, limit } = *self;
        let (name, kind) = (model.joint_name(joint), model.joint_kind(joint));
        let [q, qd, tau] =
            [LimitKind::Position, LimitKind::Velocity, LimitKind::Torque].map(|quantity| quantity.unit(kind));
        match cause {
            TripCause::StaleMeasurement => {
                format!("no new measurement for {value:.0} cycles, limit {limit:.0}")
            }
            TripCause::MeasurementGap => format!("{value:.0} measurements were missed, limit {limit:.0}"),
            TripCause::NotFinite => {
                format!("the position of joint `{name}` is {value}, expected at most {limit} {q}")
            }
            TripCause::EncoderJump => format!(
                "the position of joint `{name}` jumped by {value:.5} {q}, at most {limit:.5} {q} are possible"
            ),
            TripCause::PositionLimit | TripCause::PendulumRange => {
                format!("joint `{name}` at {value:.4} {q}, limit {limit:.4} {q}")
            }
            TripCause::VelocityLimit => {
                format!("joint `{name}` moves at {value:.4} {qd}, limit {limit:.4} {qd}")
            }
            TripCause::TorqueLimit => {
                format!("joint `{name}` shows a torque of {value:.2} {tau}, limit {limit:.2} {tau}")
            }
            TripCause::TorqueRate => format!(
                "the torque commanded to joint `{name}` changes by {value:.0} {tau}/s, limit {limit:.0} {tau}/s"
            ),
            TripCause::DrivesStopped => format!(
                "brakes closed or drives not ready for {value:.0} cycles with the brakes commanded open, limit {limit:.0}"
            ),
            TripCause::PeriodMismatch => {
                format!("the plant has a period of {value:.0} ns, the daemon one of {limit:.0} ns")
            }
            TripCause::OtherChain => {
                format!(
                    "number of joints or of actuated joints: the plant has {value:.0}, the daemon {limit:.0}"
                )
            }
            TripCause::UnknownClock => {
                format!("the plant names clock {value:.0}, the last known is {limit:.0}")
            }
            TripCause::TrackingError => {
                format!("joint `{name}` is {value:.4} {q} from its reference, limit {limit:.4} {q}")
            }
            TripCause::BalanceLost => {
                format!(
                    "the unactuated joints are {value:.4} {q} from the end of the plan, limit {limit:.4} {q}"
                )
            }
            TripCause::FrozenMeasurement => format!(
                "no position and no measured torque has changed for {value:.4} s, although the commanded torque did"
            ),
            TripCause::Collision => format!(
                "an unexplained torque of {value:.2} {tau} acts on joint `{name}`, limit {limit:.2} {tau}: is something in \
                 its way?"
            ),
            TripCause::BalanceSpeed => format!(
                "joint `{name}` would have to move at {value:.4} {qd} to keep the balance, limit {limit:.4} {qd}"
            ),
            TripCause::StuckEncoder => format!(
                "the position of joint `{name}` has not changed for {value:.4} s, although the torque must have moved it by \
                 more than {limit} {q}: its encoder is stuck, or something blocks it"
            ),
            TripCause::LateCycles => format!("{value:.0} late cycles in a row, limit {limit:.0}"),
            TripCause::NoMeasurement
            | TripCause::MeasurementRestarted
            | TripCause::DriveFault
            | TripCause::LawNotFinite
            | TripCause::PlanAge => cause.text().to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Trip, TripCause};
    use upswing_config::Config;

    /// Expected texts for `joint_3` with the value 1.5 and the limit 4.
    const TEXTS: [(TripCause, &str); 19] = [
        (TripCause::StaleMeasurement, "no new measurement for 2 cycles, limit 4"),
        (TripCause::MeasurementGap, "2 measurements were missed, limit 4"),
        (TripCause::NotFinite, "the position of joint `joint_3` is 1.5, expected at most 4 rad"),
        (
            TripCause::EncoderJump,
            "the position of joint `joint_3` jumped by 1.50000 rad, at most 4.00000 rad are possible",
        ),
        (TripCause::PositionLimit, "joint `joint_3` at 1.5000 rad, limit 4.0000 rad"),
        (TripCause::PendulumRange, "joint `joint_3` at 1.5000 rad, limit 4.0000 rad"),
        (TripCause::VelocityLimit, "joint `joint_3` moves at 1.5000 rad/s, limit 4.0000 rad/s"),
        (TripCause::TorqueLimit, "joint `joint_3` shows a torque of 1.50 N m, limit 4.00 N m"),
        (TripCause::TorqueRate, "the torque commanded to joint `joint_3` changes by 2 N m/s, limit 4 N m/s"),
        (TripCause::OtherChain, "number of joints or of actuated joints: the plant has 2, the daemon 4"),
        (TripCause::PeriodMismatch, "the plant has a period of 2 ns, the daemon one of 4 ns"),
        (TripCause::UnknownClock, "the plant names clock 2, the last known is 4"),
        (TripCause::TrackingError, "joint `joint_3` is 1.5000 rad from its reference, limit 4.0000 rad"),
        (
            TripCause::BalanceLost,
            "the unactuated joints are 1.5000 rad from the end of the plan, limit 4.0000 rad",
        ),
        (TripCause::LateCycles, "2 late cycles in a row, limit 4"),
        (TripCause::PlanAge, "the loaded plan is old"),
        (
            TripCause::BalanceSpeed,
            "joint `joint_3` would have to move at 1.5000 rad/s to keep the balance, limit 4.0000 rad/s",
        ),
        (
            TripCause::Collision,
            "an unexplained torque of 1.50 N m acts on joint `joint_3`, limit 4.00 N m: is something in its way?",
        ),
        (
            TripCause::FrozenMeasurement,
            "no position and no measured torque has changed for 1.5000 s, although the commanded torque did",
        ),
    ];

    #[test]
    fn a_trip_tells_joint_value_and_limit() {
        let model = Config::embedded().expect("settings").model;
        for (cause, text) in TEXTS {
            assert_eq!(Trip { cause, joint: 2, value: 1.5, limit: 4.0 }.text(&model), text);
        }
    }
}
