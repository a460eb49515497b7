//! Table of modes: the next mode for each mode and event, and the reasons for which requests are refused. Pure functions.
//!
//! Only [`transition`] decides which mode follows which; [`crate::controller`] adds the guards
//! (fresh measurement, plan that fits) and performs the actions of a mode.

use crate::trip::{Trip, TripCause};
use std::fmt;
use upswing_ipc::{Mode, Readiness};
use upswing_model::{LimitKind, Model, Posture};

/// An event that can change the mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModeEvent {
    /// Request: release the brakes and hold the arm.
    Enable,
    /// Request: hold the current pose.
    Hold,
    /// Request: track the loaded plan.
    Start,
    /// Request: decelerate, then hold.
    Stop,
    /// Request: leave Fault.
    Reset,
    /// Request: come to rest, close the brakes, and refuse all later requests.
    Shutdown,
    /// The plan has reached t_F, with the unactuated joints standing or hanging.
    PlanEnded(Posture),
    /// A limit of the class "stop" is beyond its trip level: tracking error, distance of the pendulum, speed to keep it upright, range
    /// of the pendulum, late cycles.
    TripToStop,
    /// A limit of the class "fault" is beyond its trip level: measurement, drives or control law cannot be trusted.
    TripToFault,
    /// All of q_A has come to rest in Stop.
    AtRest,
    /// All of q_A has come to rest in Stop, and the process shuts down.
    AtRestAtShutdown,
}

impl ModeEvent {
    /// The requests of an operator or of the daemon itself.
    pub const REQUESTS: [Self; 6] =
        [Self::Enable, Self::Hold, Self::Start, Self::Stop, Self::Reset, Self::Shutdown];
}

impl fmt::Display for ModeEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Enable => "enable",
            Self::Hold => "hold",
            Self::Start => "start",
            Self::Stop => "stop",
            Self::Reset => "reset",
            Self::Shutdown => "shutdown",
            Self::PlanEnded(_) => "end of the plan",
            Self::TripToStop => "trip to Stop",
            Self::TripToFault => "trip to Fault",
            Self::AtRest | Self::AtRestAtShutdown => "rest",
        })
    }
}

/// Returns the mode that follows `mode` on `event`.
///
/// | torque | modes |
/// |---|---|
/// | none, brakes closed | Idle, Fault |
/// | (24) with u that holds a pose | Hold, Stop (a pose that decelerates) |
/// | (24) with u = u_d + K (x - x_d) | Track, Balance (x_d = x_N, u_d = 0) |
///
/// # Errors
/// [`RequestRefusal::Mode`] for every transition that is not in the table; it changes nothing.
pub fn transition(mode: Mode, event: ModeEvent) -> Result<Mode, RequestRefusal> {
    use Mode::{Balance, Fault, Hold, Idle, Stop, Track};
    match (mode, event) {
        (Idle, ModeEvent::Enable) => Ok(Hold),
        (Hold | Balance, ModeEvent::Start) => Ok(Track),
        (Hold | Balance, ModeEvent::Hold) => Ok(Hold),
        (Hold | Track | Balance, ModeEvent::Stop) => Ok(Stop),
        (Fault, ModeEvent::Reset) => Ok(Idle),
        (Hold | Track | Balance | Stop, ModeEvent::Shutdown) => Ok(Stop),
        (Idle | Fault, ModeEvent::Shutdown) => Ok(mode),
        (Track, ModeEvent::PlanEnded(Posture::Standing)) => Ok(Balance),
        (Track, ModeEvent::PlanEnded(Posture::Hanging)) => Ok(Hold),
        (Track | Balance, ModeEvent::TripToStop) => Ok(Stop),
        (Stop, ModeEvent::AtRest) => Ok(Hold),
        (Stop, ModeEvent::AtRestAtShutdown) => Ok(Idle),
        (Hold | Track | Balance | Stop, ModeEvent::TripToFault) => Ok(Fault),
        _ => Err(RequestRefusal::Mode { mode, event }),
    }
}

/// Whether the brakes hold in `mode`, without torque.
pub fn is_braked(mode: Mode) -> bool {
    matches!(mode, Mode::Idle | Mode::Fault)
}

/// Refusal of a request, which changed nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RequestRefusal {
    /// The mode does not allow the request.
    Mode {
        /// The mode at the time of the request.
        mode: Mode,
        /// The event of the request.
        event: ModeEvent,
    },
    /// The measurement cannot be trusted.
    Unfit(Trip),
    /// A drive is not powered.
    DrivesNotReady,
    /// No plan is loaded.
    NoPlan,
    /// The loaded plan is not the plan that is to be started.
    OtherPlan {
        /// Id of the plan that is to be started.
        asked: u64,
        /// Id of the loaded plan.
        loaded: u64,
    },
    /// The start time of the plan, for which its first state was predicted, is still to come.
    BeforeActivation {
        /// Time until the start time, s.
        wait: f64,
    },
    /// The measured state does not match the state of the plan.
    StartMismatch {
        /// Index of the joint in sorted vectors.
        joint: usize,
        /// Whether the velocity does not match, otherwise the position.
        velocity: bool,
        /// Measured value.
        measured: f64,
        /// Value of the plan.
        expected: f64,
        /// Time since the plan's activation, s.
        t_plan: f64,
        /// Largest difference allowed.
        tolerance: f64,
    },
    /// The loaded plan is too old.
    PlanExpired {
        /// Time since the plan was loaded, s.
        age: f64,
        /// Trip level, s.
        limit: f64,
    },
    /// A plan is being tracked, and the settings forbid loading another plan meanwhile.
    Tracking {
        /// Id of the running plan.
        running: u64,
    },
    /// The plan that was to be replaced is not the running one.
    NotRunning {
        /// Id of the plan that was to be replaced.
        replaced: u64,
        /// Id of the running plan, 0: none.
        running: u64,
    },
    /// The plan came after the moment at which it was to replace the running one.
    AfterActivation {
        /// Time since that moment, s.
        late: f64,
    },
    /// The process shuts down.
    ShuttingDown,
}

/// Remedy for drives that are not ready.
const DRIVES_ON: &str = "switch the drives on";

impl RequestRefusal {
    /// The refusal in words, with names and units of joints from `model`.
    pub fn text(&self, model: &Model) -> String {
        match self {
            Self::Mode { mode, event } => {
                format!("{event} is not possible in mode {mode}; next: {}", mode.next_action(|_| None))
            }
            Self::Unfit(trip) => format!(
                "the robot cannot be enabled: {}; next: {}, then {}",
                trip.text(model),
                trip.cause.remedy(),
                Mode::Idle.next_action(|_| None)
            ),
            Self::DrivesNotReady => {
                format!(
                    "the drives are not ready; next: {DRIVES_ON}, then {}",
                    Mode::Idle.next_action(|_| None)
                )
            }
            Self::NoPlan => "no plan is loaded: request one from the planner".to_owned(),
            Self::OtherPlan { asked, loaded } => format!(
                "plan {asked:016x} is not loaded, but plan {loaded:016x} of another request: request a plan again"
            ),
            Self::BeforeActivation { wait } => format!("the plan begins in {wait:.3} s: start it then"),
            Self::StartMismatch { joint, velocity, measured, expected, t_plan, tolerance } => {
                let kind = if *velocity { LimitKind::Velocity } else { LimitKind::Position };
                let (name, unit) = (model.joint_name(*joint), kind.unit(model.joint_kind(*joint)));
                format!(
                    "the measured state is not the plan's: joint `{name}` is at {measured:.4} {unit}, the plan at t = \
                     {t_plan:.3} s at {expected:.4} {unit} (tolerance {tolerance} {unit}): request a plan from the current \
                     state"
                )
            }
            Self::PlanExpired { age, limit } => format!(
                "the plan was loaded {age:.0} s ago, at most {limit:.0} s are allowed: request a new one"
            ),
            Self::Tracking { running } => format!(
                "plan {running} is being tracked, and plans.while_tracking is \"refuse\": send it again afterwards"
            ),
            Self::NotRunning { replaced, running: 0 } => {
                format!("it replaces plan {replaced:016x}, but no plan is being tracked")
            }
            Self::NotRunning { replaced, running } => {
                format!("it replaces plan {replaced:016x}, but plan {running:016x} is being tracked")
            }
            Self::AfterActivation { late } => format!(
                "it came {:.1} ms after the moment at which it was to replace the running plan",
                1e3 * late
            ),
            Self::ShuttingDown => "the daemon is shutting down; next: start it again".to_owned(),
        }
    }

    /// The readiness of a daemon that refuses an enable for this reason.
    pub fn readiness(&self) -> Readiness {
        match self {
            Self::Unfit(Trip { cause: TripCause::NoMeasurement, .. }) => Readiness::NoMeasurement,
            Self::DrivesNotReady => Readiness::DrivesNotReady,
            _ => Readiness::Unfit,
        }
    }

    /// Remedy for the reason of a refused enable, in a few words; `None` for other refusals.
    pub fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::Unfit(trip) => Some(trip.cause.remedy()),
            Self::DrivesNotReady => Some(DRIVES_ON),
            _ => None,
        }
    }
}
