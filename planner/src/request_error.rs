//! Reasons for which the planner refuses a request or makes no plan.

use crate::replan::NoPlan;
use std::time::Duration;
use upswing_config::GivenOutsideLimits;
use upswing_ipc::{Mode, OtherChain, PlannerStatus, UnknownCode};
use upswing_model::LimitKind;

/// Error of a request to the planner. Its text is the reason in the response.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PlannerRequestError {
    /// The kind of the request does not exist.
    #[error(transparent)]
    UnknownKind(UnknownCode),
    /// The settings have no manoeuvre of the name in the request.
    #[error("unknown manoeuvre `{got}`: this system has {known}")]
    UnknownManoeuvre { got: String, known: String },
    /// The request gives the wrong number of values.
    #[error("`{manoeuvre}`: expected values of the joints {joints}, got {got}")]
    GivenNumber { manoeuvre: String, joints: String, got: u64 },
    /// A given value is outside the limits of its joint.
    #[error(transparent)]
    GivenOutsideLimits(#[from] GivenOutsideLimits),
    /// The request asks for too many QP iterations.
    #[error("iterations: expected 0 (the setting) to {max}, got {got}")]
    Iterations { got: u64, max: u64 },
    /// The start state has another number of joints than the model.
    #[error(transparent)]
    StartOfOtherChain(OtherChain),
    /// A position or velocity of the start state is not a finite number.
    #[error("start {kind} of joint `{joint}`: expected a number, got {got}")]
    StartNotFinite { kind: LimitKind, joint: String, got: f64 },
    /// A position or velocity of the start state is outside its limits, in `unit`: deg, m, deg/s or m/s.
    #[error("start {kind} of joint `{joint}`: expected {min:.3} to {max:.3} {unit}, got {got:.3} {unit}")]
    StartOutsideLimits { kind: LimitKind, joint: String, min: f64, max: f64, got: f64, unit: String },
    /// The daemon has sent no telemetry since the planner started.
    #[error("no telemetry from the daemon yet: is upswingd running?")]
    NoTelemetry,
    /// The newest telemetry of the daemon is seconds old.
    #[error("no telemetry from the daemon for some seconds: is upswingd running?")]
    DaemonSilent,
    /// The record that the client knows of has not arrived.
    #[error(
        "telemetry of the daemon: expected record {expected} or a later one, got {got}: is the machine overloaded?"
    )]
    TelemetryBehind { expected: u64, got: u64 },
    /// The telemetry has another number of joints than the model.
    #[error(transparent)]
    TelemetryOfOtherChain(OtherChain),
    /// The mode in the telemetry does not exist.
    #[error(transparent)]
    UnknownMode(UnknownCode),
    /// The daemon is not in the mode from which the manoeuvre starts.
    #[error("a {manoeuvre} from now needs the daemon in mode {needed}, it is in {mode}; next: {next}")]
    Mode { manoeuvre: String, needed: Mode, mode: Mode, next: String },
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
            Self::UnknownKind(_)
            | Self::UnknownManoeuvre { .. }
            | Self::GivenNumber { .. }
            | Self::GivenOutsideLimits(_)
            | Self::Iterations { .. }
            | Self::StartOfOtherChain(_)
            | Self::StartNotFinite { .. } => PlannerStatus::BadRequest,
            Self::StartOutsideLimits { .. } => PlannerStatus::StartOutsideLimits,
            Self::NoTelemetry
            | Self::DaemonSilent
            | Self::TelemetryBehind { .. }
            | Self::TelemetryOfOtherChain(_)
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
