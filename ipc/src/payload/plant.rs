//! The `plant` service: requests to the simulated plant, and its responses.

use super::chain::{self, OtherChain, PerJoint};
use super::codes::{PlantKind, UnknownCode};
use super::text::Text;
use super::words::WORD;
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{ActuatedVector, Order, State};

/// A request to the simulated plant; fields that do not belong to the kind are ignored.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.PlantRequest.v3")]
pub struct PlantRequest {
    /// Code of the [`PlantKind`].
    pub kind: u64,
    /// `ResetState`: n, number of joints.
    pub joints: u64,
    /// `ResetState`: n_A, number of actuated joints.
    pub actuated: u64,
    /// `ResetState`: q, joint positions.
    pub q: PerJoint,
    /// `ResetState`: qd, joint velocities.
    pub qd: PerJoint,
    /// `AdvanceTo`: the last cycle before the plant pauses. `SetFault`, `Push`: the first cycle of it, 0: the next one.
    pub seq: u64,
    /// `SetFault`: code of the fault, as the settings of the plant number them.
    pub fault: u64,
    /// `SetFault`: the joint of an encoder's fault, counted from 1 at the base.
    pub joint: u64,
    /// `SetFault`: how far an encoder jumps, rad or m, or how late measurements are, cycles.
    pub amount: f64,
    /// `SetFault`, `Push`: how many cycles it lasts; a fault of 0 cycles lasts until it is cleared.
    pub cycles: u64,
    /// `Push`: force times its duration, world frame (z up), N s.
    pub impulse: [f64; 3],
}

const _: () = assert!(size_of::<PlantRequest>() == WORD * 11 + 2 * size_of::<PerJoint>());

impl PlantRequest {
    /// A request of `kind` whose other fields are 0.
    pub fn new(kind: PlantKind) -> Self {
        Self { kind: kind.code(), ..Self::default() }
    }

    /// A request to set the state x = [q, qd].
    pub fn reset_state(order: &Order, x: &State) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        let (q, qd) = (order.in_chain(&x.q()), order.in_chain(&x.qd()));
        Self { joints, actuated, q, qd, ..Self::new(PlantKind::ResetState) }
    }

    /// The state x = [q, qd] of a request to set it.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are those of `order`.
    pub fn state(&self, order: &Order) -> Result<State, OtherChain> {
        chain::check("plant request", (self.joints, self.actuated), order.sizes())?;
        Ok(chain::state(order, &self.q, &self.qd))
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
#[type_name("upswing.PlantResponse.v2")]
pub struct PlantResponse {
    /// 1: accepted, 0: refused (see `reason`).
    pub accepted: u64,
    /// Last complete cycle of the plant (measurement answered, state moved on), 0 before the first.
    pub seq: u64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// q, true joint positions.
    pub q: PerJoint,
    /// qd, true joint velocities.
    pub qd: PerJoint,
    /// 1: the brakes hold, 0: they are released.
    pub brakes_closed: u64,
    /// Largest magnitude of each applied torque since the last reset, at least 0.
    pub tau_peak: PerJoint,
    /// Why it was refused, or a remark; for people.
    pub reason: Text,
}

const _: () = assert!(size_of::<PlantResponse>() == WORD * 5 + 3 * size_of::<PerJoint>() + size_of::<Text>());

impl PlantResponse {
    /// A response with the state x = [q, qd] and the peaks of the torques; all else is 0.
    pub fn new(order: &Order, x: &State, tau_peak: &ActuatedVector) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        let (q, qd) = (order.in_chain(&x.q()), order.in_chain(&x.qd()));
        Self { joints, actuated, q, qd, tau_peak: *tau_peak.padded(), ..Self::default() }
    }

    /// The state x = [q, qd] and the peaks of the torques.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are those of `order`.
    pub fn vectors(&self, order: &Order) -> Result<(State, ActuatedVector), OtherChain> {
        chain::check("plant response", (self.joints, self.actuated), order.sizes())?;
        let x = chain::state(order, &self.q, &self.qd);
        Ok((x, chain::actuated(order.sizes(), &self.tau_peak)))
    }
}
