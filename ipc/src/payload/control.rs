//! Operator -> daemon.

use super::WORD;
use crate::codes::{ControlCommand, Mode, UnknownCode};
use crate::text::Text;
use iceoryx2::prelude::ZeroCopySend;

/// What the operator asks.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.ControlRequest.v1")]
pub struct ControlRequest {
    /// Code of the [`ControlCommand`].
    pub command: u64,
}

const _: () = assert!(size_of::<ControlRequest>() == WORD);

impl ControlRequest {
    /// A request for `command`.
    pub fn new(command: ControlCommand) -> Self {
        Self { command: command.code() }
    }

    /// The command.
    ///
    /// # Errors
    /// [`UnknownCode`] if `command` names none.
    pub fn command(&self) -> Result<ControlCommand, UnknownCode> {
        ControlCommand::try_from(self.command)
    }
}

/// What the daemon answers: whether it did it, and its state afterwards.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.ControlResponse.v1")]
pub struct ControlResponse {
    /// 1: accepted, 0: refused (see `reason`).
    pub accepted: u64,
    /// Code of the daemon's [`Mode`].
    pub mode: u64,
    /// Code of the latched fault, 0: none.
    pub fault: u64,
    /// Id of the loaded plan, 0: none.
    pub plan_id: u64,
    /// Id of the running plan, 0: none.
    pub running_plan: u64,
    /// Number of the last cycle.
    pub seq: u64,
    /// 1: running without real-time scheduling or locked memory, 0: as intended.
    pub degraded: u64,
    /// Overrun cycles since the start of the daemon.
    pub overruns: u64,
    /// Why it was refused, or a remark; for people.
    pub reason: Text,
}

const _: () = assert!(size_of::<ControlResponse>() == WORD * 8 + size_of::<Text>());

impl ControlResponse {
    /// The daemon's mode.
    ///
    /// # Errors
    /// [`UnknownCode`] if `mode` names none.
    pub fn mode(&self) -> Result<Mode, UnknownCode> {
        Mode::try_from(self.mode)
    }
}
