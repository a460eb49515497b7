//! The mode machine. Pure.
//!
//! [`transition`] is the only place that says which mode follows which; [`crate::controller`] adds the guards
//! (fresh measurement, plan that fits) and does what a mode does.

use crate::plan::Ending;
use crate::trip::Trip;
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
    /// Follow the loaded plan if it is the one of this id.
    Start(u64),
    /// Decelerate, then hold.
    Stop,
    /// Leave a latched fault.
    Reset,
    /// Come to rest, close the brakes and accept nothing more.
    Shutdown,
}

impl Request {
    /// Every request; the start is one of no plan.
    pub const ALL: [Self; 6] =
        [Self::Enable, Self::Hold, Self::Start(0), Self::Stop, Self::Reset, Self::Shutdown];

    /// Where it is in [`Self::ALL`].
    pub const fn index(self) -> u64 {
        match self {
            Self::Enable => 0,
            Self::Hold => 1,
            Self::Start(_) => 2,
            Self::Stop => 3,
            Self::Reset => 4,
            Self::Shutdown => 5,
        }
    }
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Enable => "enable",
            Self::Hold => "hold",
            Self::Start(_) => "start",
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
    /// Tracking error, tilt of the rod, speed to keep it upright, range of the pendulum or late cycles beyond the trip level.
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
        (Hold | Balance, Event::Asked(Request::Start(_))) => Ok(Track),
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

/// Why a request was refused; it changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Refusal {
    /// The mode does not allow it.
    #[error("{} is not possible in mode {mode}; next: {}", event_name(.event), .mode.next_action())]
    Mode {
        /// The mode.
        mode: Mode,
        /// What was asked.
        event: Event,
    },
    /// The measurement cannot be trusted.
    #[error("the robot is not fit to be enabled: {0}; next: {remedy}, then {enable}", remedy = .0.cause.remedy(), enable = Mode::Idle.next_action())]
    Unfit(Trip),
    /// A drive is not powered.
    #[error("the drives are not ready; next: {DRIVES_ON}, then {}", Mode::Idle.next_action())]
    DrivesNotReady,
    /// No plan is loaded.
    #[error("no plan is loaded: ask the planner for one")]
    NoPlan,
    /// Another plan is loaded than the one that shall start.
    #[error(
        "plan {asked:016x} is not loaded, but plan {loaded:016x} of another request: ask for a plan again"
    )]
    OtherPlan {
        /// Id that was asked for.
        asked: u64,
        /// Id of the loaded plan.
        loaded: u64,
    },
    /// The moment for which the plan's first state was predicted is still to come.
    #[error("the plan begins in {wait:.3} s: start it then")]
    BeforeActivation {
        /// Time until then, s.
        wait: f64,
    },
    /// The measured state is not the plan's.
    #[error(
        "the plan starts elsewhere: joint {} is at {measured:.4} {unit}, the plan at t = {t_plan:.3} s at \
         {expected:.4} {unit} (tolerance {tolerance} {unit}): ask for a plan from now",
        .joint + 1, unit = if *.velocity { "rad/s" } else { "rad" }
    )]
    StartMismatch {
        /// The joint, 0-based.
        joint: usize,
        /// Its velocity (rad/s), otherwise its angle (rad).
        velocity: bool,
        /// Measured.
        measured: f64,
        /// Of the plan.
        expected: f64,
        /// Time since the plan's activation, s.
        t_plan: f64,
        /// Allowed difference.
        tolerance: f64,
    },
    /// The loaded plan is too old.
    #[error("the plan was loaded {age:.0} s ago, at most {limit:.0} s are allowed: ask for a new one")]
    PlanExpired {
        /// Time since it was loaded, s.
        age: f64,
        /// Trip level, s.
        limit: f64,
    },
    /// A plan is being tracked, and the settings want no other to be loaded meanwhile.
    #[error(
        "plan {running} is being tracked, and plans.while_tracking is \"refuse\": send it again afterwards"
    )]
    Tracking {
        /// Id of the running plan.
        running: u64,
    },
    /// The process shuts down.
    #[error("the daemon is shutting down; next: start it again")]
    ShuttingDown,
}

/// What helps drives that are not ready.
const DRIVES_ON: &str = "switch the drives on";

impl Refusal {
    /// What to do first where an enable would be refused with this; short.
    pub fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::Unfit(trip) => Some(trip.cause.remedy()),
            Self::DrivesNotReady => Some(DRIVES_ON),
            _ => None,
        }
    }
}

fn event_name(event: &Event) -> String {
    match event {
        Event::Asked(request) => request.to_string(),
        other => format!("{other:?}"),
    }
}
