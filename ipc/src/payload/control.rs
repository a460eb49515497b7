//! The `control` service: requests of an operator to the daemon, and its responses.

use super::codes::{ControlKind, Mode, Readiness, UnknownCode};
use super::text::Text;
use super::words::WORD;
use iceoryx2::prelude::ZeroCopySend;

/// A request of an operator to the daemon.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.ControlRequest.v2")]
pub struct ControlRequest {
    /// Code of the [`ControlKind`].
    pub kind: u64,
    /// Id of the plan to start; without meaning for the other kinds.
    pub plan_id: u64,
}

const _: () = assert!(size_of::<ControlRequest>() == WORD * 2);

impl ControlRequest {
    /// A request of `kind`, other than a start.
    pub fn new(kind: ControlKind) -> Self {
        Self { kind: kind.code(), plan_id: 0 }
    }

    /// A request to start the plan `plan_id`.
    pub fn start(plan_id: u64) -> Self {
        Self { kind: ControlKind::Start.code(), plan_id }
    }

    /// The kind of request.
    ///
    /// # Errors
    /// [`UnknownCode`] if `kind` names none.
    pub fn kind(&self) -> Result<ControlKind, UnknownCode> {
        ControlKind::try_from(self.kind)
    }
}

/// Percentiles of a duration since the start of the daemon, ns; upper ends of the buckets of a histogram, at most 7 %
/// too large. All 0 if nothing was measured.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("upswing.Percentiles.v1")]
pub struct Percentiles {
    /// Number of durations.
    pub count: u64,
    /// Half of them were at most this, ns.
    pub p50: u64,
    /// 99 % of them, ns.
    pub p99: u64,
    /// 99.9 % of them, ns.
    pub p99_9: u64,
    /// 99.99 % of them, ns.
    pub p99_99: u64,
    /// The longest, ns; exact.
    pub max: u64,
}

/// Response of the daemon to a [`ControlRequest`]: whether it accepted the request, and its state afterwards.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.ControlResponse.v5")]
pub struct ControlResponse {
    /// 1: accepted, 0: refused (see `reason`).
    pub accepted: u64,
    /// Code of the daemon's [`Mode`].
    pub mode: u64,
    /// Code of the [`Readiness`]: why an enable would be refused in mode Idle; `Ready` in all other modes.
    pub readiness: u64,
    /// Code of the latched fault, 0: none.
    pub fault: u64,
    /// Warnings since the last enable, start or reset; bits as in the telemetry.
    pub warnings: u64,
    /// Id of the newest accepted plan, which waits for its start or runs; 0: none.
    pub plan_id: u64,
    /// Id of the running plan, 0: none.
    pub running_plan: u64,
    /// Number of the last cycle.
    pub seq: u64,
    /// Time of the last cycle, ns on the daemon's clock, as `t_ns` of its telemetry.
    pub t_ns: u64,
    /// Parts of the real-time set-up that the operating system refused: bits of [`crate::Degradation`]; 0: none.
    pub degraded: u64,
    /// Overrun cycles since the start of the daemon.
    pub overruns: u64,
    /// Wake-up latency on the clock `wall`.
    pub wake: Percentiles,
    /// Computing time of a cycle, from reading the measurement to the written command.
    pub compute: Percentiles,
    /// The last overrun: time, phase and cause; for people.
    pub overrun: Text,
    /// Why it was refused, or a remark; for people.
    pub reason: Text,
    /// What the operator does next; for people.
    pub next: Text,
}

const _: () = assert!(size_of::<Percentiles>() == WORD * 6);
const _: () =
    assert!(size_of::<ControlResponse>() == WORD * 11 + 2 * size_of::<Percentiles>() + 3 * size_of::<Text>());

impl ControlResponse {
    /// The daemon's mode.
    ///
    /// # Errors
    /// [`UnknownCode`] if `mode` names none.
    pub fn mode(&self) -> Result<Mode, UnknownCode> {
        Mode::try_from(self.mode)
    }

    /// Whether the daemon can be enabled.
    ///
    /// # Errors
    /// [`UnknownCode`] if `readiness` names none.
    pub fn readiness(&self) -> Result<Readiness, UnknownCode> {
        Readiness::try_from(self.readiness)
    }

    /// The daemon's mode as text; an unknown code gives the text of the error.
    pub fn mode_text(&self) -> String {
        self.mode().map_or_else(|e| e.to_string(), |mode| mode.to_string())
    }
}
