//! Reasons for which the planner refuses a request or makes no plan.

use crate::replan::NoPlan;
use std::time::Duration;
use upswing_ipc::operator::Manoeuvre;
use upswing_ipc::{Mode, PlannerStatus, UnknownCode};

/// Error of a request to the planner. Its text is the reason in the response.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PlannerRequestError {
    /// The kind of the request does not exist.
    #[error(transparent)]
    UnknownKind(UnknownCode),
    /// The request asks for too many QP iterations.
    #[error("iterations: expected 0 (the setting) to {max}, got {got}")]
    Iterations { got: u64, max: u64 },
    /// An entry of the start state is not a finite number.
    #[error("start state: expected numbers, entry {entry} is {got}")]
    StartNotFinite { entry: usize, got: f64 },
    /// A joint position of the start state is outside its limits, rad; `joint` counts from 1.
    #[error(
        "start of joint {joint}: expected {:.1} to {:.1} deg, got {:.2} deg",
        .min.to_degrees(), .max.to_degrees(), .got.to_degrees()
    )]
    StartPosition { joint: usize, min: f64, max: f64, got: f64 },
    /// A joint velocity of the start state is above its limit, rad/s; `joint` counts from 1.
    #[error(
        "start velocity of joint {joint}: expected at most {:.1} deg/s, got {:.2} deg/s",
        .max.to_degrees(), .got.to_degrees()
    )]
    StartVelocity { joint: usize, max: f64, got: f64 },
    /// The daemon has sent no telemetry since the planner started.
    #[error("no telemetry from the daemon yet: is upswingd running?")]
    NoTelemetry,
    /// The newest telemetry of the daemon is seconds old.
    #[error("no telemetry from the daemon for some seconds: is upswingd running?")]
    DaemonSilent,
    /// The mode in the telemetry does not exist.
    #[error(transparent)]
    UnknownMode(UnknownCode),
    /// The daemon is not in the mode from which the manoeuvre starts.
    #[error(
        "a {manoeuvre} from now needs the daemon in mode {needed}, it is in {mode}; next: {}", .mode.next_action()
    )]
    Mode { manoeuvre: Manoeuvre, needed: Mode, mode: Mode },
    /// The pendulum moves, and the newest telemetry is too old to predict its state.
    #[error(
        "the pendulum moves, and the newest telemetry is {:.0} ms old, expected at most {:.0} ms: is the machine overloaded?",
        ms(.age), ms(.limit)
    )]
    TelemetryTooOld { age: Duration, limit: Duration },
    /// The plan was ready only after its predicted start.
    #[error(
        "the pendulum moves, and planning took {:.0} ms, longer than the {:.0} ms to the predicted start: ask again, or once \
         the pendulum rests",
        ms(.took), ms(.lead)
    )]
    TooLate { took: Duration, lead: Duration },
    /// No plan that keeps the limits was found in time.
    #[error(transparent)]
    NoPlan(#[from] NoPlan),
}

impl PlannerRequestError {
    /// Status code in the response for this error.
    pub(crate) fn status(&self) -> PlannerStatus {
        match self {
            Self::UnknownKind(_) | Self::Iterations { .. } | Self::StartNotFinite { .. } => {
                PlannerStatus::BadRequest
            }
            Self::StartPosition { .. } | Self::StartVelocity { .. } => PlannerStatus::StartOutsideLimits,
            Self::NoTelemetry
            | Self::DaemonSilent
            | Self::UnknownMode(_)
            | Self::Mode { .. }
            | Self::TelemetryTooOld { .. }
            | Self::TooLate { .. } => PlannerStatus::NotReady,
            Self::NoPlan(e) if e.out_of_time() => PlannerStatus::Deadline,
            Self::NoPlan(_) => PlannerStatus::Infeasible,
        }
    }
}

fn ms(duration: &Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
