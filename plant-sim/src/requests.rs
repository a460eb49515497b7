//! The `plant` service: resets, grants of cycles, faults, pushes, status.

use crate::{Plant, SetEventError};
use tracing::warn;
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::{IpcError, Node, PlantKind, PlantPacing, PlantRequest, PlantResponse, Server, Text};
use upswing_model::JointVector;

/// The server of the `plant` service.
pub(crate) struct RequestServer {
    server: Server<PlantRequest>,
    /// Whether the last look at the service failed.
    failing: bool,
}

impl RequestServer {
    /// # Errors
    /// If the domain has a plant already, or shared memory cannot be used.
    pub(crate) fn new(node: &Node) -> Result<Self, IpcError> {
        Ok(Self { server: node.server::<PlantRequest>()?, failing: false })
    }

    /// Answers all waiting requests.
    pub(crate) fn serve(&mut self, plant: &mut Plant, pacing: &mut PlantPacing) {
        let outcome = self.server.poll(|request| answer(plant, pacing, request));
        // An error that persists is logged once.
        if let Err(e) = &outcome
            && !self.failing
        {
            warn!("{e}");
        }
        self.failing = outcome.is_err();
    }
}

/// Executes a request; the answer has the reason where it is refused.
fn answer(plant: &mut Plant, pacing: &mut PlantPacing, request: &PlantRequest) -> PlantResponse {
    // A cycle whose measurement is published cannot change any more.
    let next = plant.seq() + u64::from(pacing.is_published());
    let outcome = match request.kind() {
        Err(e) => Err(e.to_string()),
        Ok(PlantKind::Status) => Ok(()),
        Ok(PlantKind::ResetState) => plant
            .reset(&JointVector::from(request.q), &JointVector::from(request.qd))
            .map_err(|e| e.to_string()),
        Ok(PlantKind::AdvanceTo) => pacing.grant(request.seq).map_err(|e| e.to_string()),
        Ok(PlantKind::SetFault) => {
            first_cycle(next, request).and_then(|from| set_fault(plant, from, request))
        }
        Ok(PlantKind::ClearFaults) => {
            plant.clear_faults();
            Ok(())
        }
        Ok(PlantKind::Push) => first_cycle(next, request).and_then(|from| {
            let push = Push { from, cycles: request.cycles, impulse: request.impulse };
            plant.push(&push).map_err(|e| e.to_string())
        }),
    };
    PlantResponse {
        accepted: outcome.is_ok().into(),
        seq: plant.completed(),
        q: (*plant.position()).into(),
        qd: (*plant.velocity()).into(),
        brakes_closed: plant.brakes_closed().into(),
        tau_peak: (*plant.tau_peak()).into(),
        reason: Text::new(&outcome.err().unwrap_or_default()),
    }
}

fn set_fault(plant: &mut Plant, from: u64, request: &PlantRequest) -> Result<(), String> {
    let kind = usize::try_from(request.fault).ok().and_then(|code| FaultKind::all().get(code));
    let Some(kind) = kind.copied() else {
        let max = FaultKind::all().len() - 1;
        return Err(format!("fault: expected a code from 0 to {max}, got {}", request.fault));
    };
    // Kinds that concern no joint come with joint 0, which is no joint either.
    let joint = usize::try_from(request.joint).unwrap_or(usize::MAX).wrapping_sub(1);
    let (cycles, amount) = (request.cycles, request.amount);
    let fault = Fault { kind, from, cycles, joint, amount };
    plant.set_fault(&fault).map_err(|e| e.to_string())
}

/// The first cycle of the fault or push of a request; `next`: the first cycle that can still change.
fn first_cycle(next: u64, request: &PlantRequest) -> Result<u64, String> {
    match request.seq {
        0 => Ok(next),
        got if got < next => Err(SetEventError::Past { next, got }.to_string()),
        seq => Ok(seq),
    }
}
