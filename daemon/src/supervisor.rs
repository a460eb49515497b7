//! The mode machine and the reasons for leaving a mode. Pure.
//!
//! [`transition`] is the only place that says which mode follows which; [`crate::controller`] adds the guards
//! (fresh measurement, plan that fits) and does what a mode does.

use crate::plan::Ending;
use std::fmt;
use thiserror::Error;
use upswing_ipc::Mode;

/// What somebody asks of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Release the brakes and hold.
    Enable,
    /// Hold the pose of this moment.
    Hold,
    /// Follow the loaded plan.
    Start,
    /// Decelerate, then hold.
    Stop,
    /// Leave a latched fault.
    Reset,
    /// Come to rest, close the brakes and accept nothing more.
    Shutdown,
}

impl Request {
    /// Every request.
    pub const ALL: [Self; 6] =
        [Self::Enable, Self::Hold, Self::Start, Self::Stop, Self::Reset, Self::Shutdown];
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Enable => "enable",
            Self::Hold => "hold",
            Self::Start => "start",
            Self::Stop => "stop",
            Self::Reset => "reset",
            Self::Shutdown => "shutdown",
        })
    }
}

/// What can change the mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Somebody asked.
    Asked(Request),
    /// t >= t_F, and what the plan ends in.
    PlanEnded(Ending),
    /// Tracking error, tilt of the rod or range of the pendulum beyond its trip level.
    Lost,
    /// All of q_A at rest.
    AtRest,
    /// All of q_A at rest, and the process shuts down.
    AtRestForGood,
    /// Measurement, drives or control law cannot be trusted.
    Fault,
}

/// The table of modes: what follows `mode` on `event`.
///
/// | torque | modes |
/// |---|---|
/// | none, brakes closed | Idle, Fault |
/// | (24) with u that holds a pose | Hold, Stop (a pose that decelerates) |
/// | (24) with u = u_d + K (x - x_d) | Track, Balance (x_d = x_N, u_d = 0) |
///
/// # Errors
/// [`Refusal::Mode`] for all that is not in the table; it changes nothing.
pub fn transition(mode: Mode, event: Event) -> Result<Mode, Refusal> {
    use Mode::{Balance, Fault, Hold, Idle, Stop, Track};
    match (mode, event) {
        (Idle, Event::Asked(Request::Enable)) => Ok(Hold),
        (Hold | Balance, Event::Asked(Request::Start)) => Ok(Track),
        (Hold | Balance, Event::Asked(Request::Hold)) => Ok(Hold),
        (Hold | Track | Balance, Event::Asked(Request::Stop)) => Ok(Stop),
        (Fault, Event::Asked(Request::Reset)) => Ok(Idle),
        (Hold | Track | Balance | Stop, Event::Asked(Request::Shutdown)) => Ok(Stop),
        (Idle | Fault, Event::Asked(Request::Shutdown)) => Ok(mode),
        (Track, Event::PlanEnded(Ending::Upright)) => Ok(Balance),
        (Track, Event::PlanEnded(Ending::Hanging)) => Ok(Hold),
        (Track | Balance, Event::Lost) => Ok(Stop),
        (Stop, Event::AtRest) => Ok(Hold),
        (Stop, Event::AtRestForGood) => Ok(Idle),
        (Hold | Track | Balance | Stop, Event::Fault) => Ok(Fault),
        _ => Err(Refusal::Mode { mode, event }),
    }
}

/// Whether the brakes hold in `mode`, without torque.
pub fn is_braked(mode: Mode) -> bool {
    matches!(mode, Mode::Idle | Mode::Fault)
}

/// Why the controller gave up a mode; those up to [`TripCause::LawNotFinite`] lead to Fault, the others to Stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum TripCause {
    /// Nothing was measured yet.
    NoMeasurement = 1,
    /// The newest measurement is too old.
    StaleMeasurement = 2,
    /// The plant restarted: its measurements do not continue the earlier ones.
    MeasurementRestarted = 3,
    /// An angle is not finite.
    NotFinite = 4,
    /// An angle changed faster than the joint can move.
    EncoderJump = 5,
    /// An angle of the arm is beyond its trip level.
    PositionLimit = 6,
    /// A velocity of the arm is beyond its trip level.
    VelocityLimit = 7,
    /// A drive reports a fault.
    DriveFault = 8,
    /// The plant runs with another period.
    PeriodMismatch = 9,
    /// The plant names a clock that does not exist.
    UnknownClock = 10,
    /// The control law gave no finite torque.
    LawNotFinite = 11,
    /// An angle is too far from its reference.
    TrackingError = 12,
    /// The rod is too far from upright.
    BalanceLost = 13,
    /// An angle of the pendulum is beyond the range open to plans.
    PendulumRange = 14,
}

impl TripCause {
    /// Every cause; the index is the code less 1.
    pub const ALL: [Self; 14] = [
        Self::NoMeasurement,
        Self::StaleMeasurement,
        Self::MeasurementRestarted,
        Self::NotFinite,
        Self::EncoderJump,
        Self::PositionLimit,
        Self::VelocityLimit,
        Self::DriveFault,
        Self::PeriodMismatch,
        Self::UnknownClock,
        Self::LawNotFinite,
        Self::TrackingError,
        Self::BalanceLost,
        Self::PendulumRange,
    ];

    /// The number that stands for the cause in telemetry; above 0.
    pub const fn code(self) -> u64 {
        self as u64
    }

    /// The cause in words, where the numbers of its [`Trip`] are not known.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NoMeasurement => "nothing was measured yet: is the plant running?",
            Self::StaleMeasurement => "no new measurement",
            Self::MeasurementRestarted => "the plant restarted",
            Self::NotFinite => "an angle is not finite",
            Self::EncoderJump => "an angle jumped",
            Self::PositionLimit => "the arm is beyond a position limit",
            Self::VelocityLimit => "the arm is beyond a velocity limit",
            Self::DriveFault => "a drive reports a fault",
            Self::PeriodMismatch => "plant and daemon have different periods",
            Self::UnknownClock => "the plant names an unknown clock",
            Self::LawNotFinite => "the control law gave no finite torque",
            Self::TrackingError => "too far from the reference",
            Self::BalanceLost => "the rod fell",
            Self::PendulumRange => "the pendulum is beyond the range open to plans",
        }
    }
}

/// What the `fault` of telemetry and answers means; `None` for 0 and for codes that do not exist.
pub fn fault_text(code: u64) -> Option<&'static str> {
    let index = usize::try_from(code.checked_sub(1)?).ok()?;
    TripCause::ALL.get(index).map(|cause| cause.text())
}

/// What was found beyond which limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trip {
    /// The kind of check.
    pub cause: TripCause,
    /// The joint, 0-based; 0 where none is concerned.
    pub joint: usize,
    /// What was found: rad, rad/s, cycles or ns, as the cause says.
    pub value: f64,
    /// The limit that it was compared with, in the same unit.
    pub limit: f64,
}

impl Trip {
    /// A trip that concerns no joint and has no numbers.
    pub const fn plain(cause: TripCause) -> Self {
        Self { cause, joint: 0, value: 0.0, limit: 0.0 }
    }
}

impl fmt::Display for Trip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { cause, joint, value, limit } = self;
        let joint = joint + 1;
        match cause {
            TripCause::StaleMeasurement => {
                write!(f, "no new measurement for {value:.0} cycles, limit {limit:.0}")
            }
            TripCause::NotFinite => write!(f, "the angle of joint {joint} is {value}"),
            TripCause::EncoderJump => {
                write!(
                    f,
                    "the angle of joint {joint} jumped by {value:.5} rad, at most {limit:.5} rad are possible"
                )
            }
            TripCause::PositionLimit | TripCause::PendulumRange => {
                write!(f, "joint {joint} at {value:.4} rad, limit {limit:.4} rad")
            }
            TripCause::VelocityLimit => {
                write!(f, "joint {joint} moves at {value:.4} rad/s, limit {limit:.4} rad/s")
            }
            TripCause::PeriodMismatch => {
                write!(f, "the plant has a period of {value:.0} ns, the daemon one of {limit:.0} ns")
            }
            TripCause::UnknownClock => {
                write!(f, "the plant names clock {value:.0}, the last known is {limit:.0}")
            }
            TripCause::TrackingError => {
                write!(f, "joint {joint} is {value:.4} rad from its reference, limit {limit:.4} rad")
            }
            TripCause::BalanceLost => {
                write!(f, "the rod is {value:.4} rad from where the plan ends, limit {limit:.4} rad")
            }
            TripCause::NoMeasurement
            | TripCause::MeasurementRestarted
            | TripCause::DriveFault
            | TripCause::LawNotFinite => f.write_str(cause.text()),
        }
    }
}

/// Why a request was refused; it changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Refusal {
    /// The mode does not allow it.
    #[error("{} is not possible in mode {mode}", event_name(.event))]
    Mode {
        /// The mode.
        mode: Mode,
        /// What was asked.
        event: Event,
    },
    /// The measurement cannot be trusted.
    #[error("the robot is not fit to be enabled: {0}")]
    Unfit(Trip),
    /// A drive is not powered.
    #[error("the drives are not ready")]
    DrivesNotReady,
    /// No plan is loaded.
    #[error("no plan is loaded: ask the planner for one")]
    NoPlan,
    /// The measured state is not the plan's start.
    #[error(
        "the plan starts elsewhere: joint {} is at {measured:.4} {unit}, the plan starts at {expected:.4} {unit} \
         (tolerance {tolerance} {unit}): ask for a plan from now",
        .joint + 1, unit = if *.velocity { "rad/s" } else { "rad" }
    )]
    StartMismatch {
        /// The joint, 0-based.
        joint: usize,
        /// Its velocity (rad/s), otherwise its angle (rad).
        velocity: bool,
        /// Measured.
        measured: f64,
        /// Of the plan's x_0.
        expected: f64,
        /// Allowed difference.
        tolerance: f64,
    },
    /// A plan whose parts do not have the same number of knots.
    #[error(
        "the plan is incomplete: its states, inputs, derivatives and gains must have the same number of knots"
    )]
    IncompletePlan,
    /// The process shuts down.
    #[error("the daemon is shutting down")]
    ShuttingDown,
}

fn event_name(event: &Event) -> String {
    match event {
        Event::Asked(request) => request.to_string(),
        other => format!("{other:?}"),
    }
}
