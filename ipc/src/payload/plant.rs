//! The `plant` service: requests to the simulated plant, and its responses.

use super::codes::{PlantKind, UnknownCode};
use super::text::Text;
use super::words::WORD;
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{NQ, NU};

/// A request to the simulated plant; fields that do not belong to the kind are ignored.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.PlantRequest.v2")]
pub struct PlantRequest {
    /// Code of the [`PlantKind`].
    pub kind: u64,
    /// `ResetState`: q, joint positions, joint frames, rad.
    pub q: [f64; NQ],
    /// `ResetState`: qd, joint velocities, joint frames, rad/s.
    pub qd: [f64; NQ],
    /// `AdvanceTo`: the last cycle before the plant pauses. `SetFault`, `Push`: the first cycle of it, 0: the next one.
    pub seq: u64,
    /// `SetFault`: code of the fault, as the settings of the plant number them.
    pub fault: u64,
    /// `SetFault`: the joint of an encoder's fault, 1..=9.
    pub joint: u64,
    /// `SetFault`: how far an encoder jumps, rad, or how late measurements are, cycles.
    pub amount: f64,
    /// `SetFault`, `Push`: how many cycles it lasts; a fault of 0 cycles lasts until it is cleared.
    pub cycles: u64,
    /// `Push`: force times its duration, world frame (z up), N s.
    pub impulse: [f64; 3],
}

const _: () = assert!(size_of::<PlantRequest>() == WORD * (9 + 2 * NQ));

impl PlantRequest {
    /// A request of `kind` whose other fields are 0.
    pub fn new(kind: PlantKind) -> Self {
        Self { kind: kind.code(), ..Self::default() }
    }

    /// The kind of request.
    ///
    /// # Errors
    /// [`UnknownCode`] if `kind` names none.
    pub fn kind(&self) -> Result<PlantKind, UnknownCode> {
        PlantKind::try_from(self.kind)
    }
}

/// Response of the plant to a [`PlantRequest`]: whether it accepted the request, and its true state (not the measured one)
/// afterwards.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.PlantResponse.v1")]
pub struct PlantResponse {
    /// 1: accepted, 0: refused (see `reason`).
    pub accepted: u64,
    /// Last complete cycle of the plant (measurement answered, state moved on), 0 before the first.
    pub seq: u64,
    /// q, true joint positions, joint frames, rad.
    pub q: [f64; NQ],
    /// qd, true joint velocities, joint frames, rad/s.
    pub qd: [f64; NQ],
    /// 1: the brakes hold, 0: they are released.
    pub brakes_closed: u64,
    /// Largest magnitude of each applied torque since the last reset, N m, at least 0.
    pub tau_peak: [f64; NU],
    /// Why it was refused, or a remark; for people.
    pub reason: Text,
}

const _: () = assert!(size_of::<PlantResponse>() == WORD * (3 + 2 * NQ + NU) + size_of::<Text>());
