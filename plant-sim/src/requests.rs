//! Server of the `plant` service: resets, grants of cycles, faults, pushes, status.

use crate::{Plant, SetEventError, StateError};
use tracing::warn;
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::{
    GrantError, IpcError, Node, OtherChain, PlantKind, PlantPacing, PlantRequest, PlantResponse, Server,
    Text, UnknownCode,
};
use upswing_model::State;

/// The server of the `plant` service.
pub(crate) struct RequestServer {
    server: Server<PlantRequest>,
    /// Whether the last poll of the service failed.
    failing: bool,
}

impl RequestServer {
    /// Creates the server of the service.
    ///
    /// # Errors
    /// [`IpcError`] if the domain has a plant already, or shared memory cannot be used.
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

/// Error of a request to the plant. Its text is the reason in the response.
#[derive(Debug, thiserror::Error)]
enum PlantRequestError {
    /// The kind of the request does not exist.
    #[error(transparent)]
    UnknownKind(#[from] UnknownCode),
    /// The requested state is that of another chain.
    #[error(transparent)]
    OtherChain(#[from] OtherChain),
    /// The plant cannot be put into the requested state.
    #[error(transparent)]
    State(#[from] StateError),
    /// The cycles cannot be granted.
    #[error(transparent)]
    Grant(#[from] GrantError),
    /// The fault or push cannot be added.
    #[error(transparent)]
    Event(#[from] SetEventError),
    /// The kind of the fault does not exist.
    #[error("fault: expected a code from 0 to {max}, got {got}")]
    UnknownFault { got: u64, max: usize },
}

/// Executes a request; the response to a refused request contains the reason.
fn answer(plant: &mut Plant, pacing: &mut PlantPacing, request: &PlantRequest) -> PlantResponse {
    // A cycle whose measurement is published cannot change any more.
    let next = plant.seq() + u64::from(pacing.is_published());
    let outcome = execute(plant, pacing, next, request);
    PlantResponse {
        accepted: outcome.is_ok().into(),
        seq: plant.completed(),
        brakes_closed: plant.brakes_closed().into(),
        reason: outcome.map_or_else(|e| Text::new(&e.to_string()), |()| Text::default()),
        ..PlantResponse::new(plant.order(), &State::new(plant.position(), plant.velocity()), plant.tau_peak())
    }
}

fn execute(
    plant: &mut Plant,
    pacing: &mut PlantPacing,
    next: u64,
    request: &PlantRequest,
) -> Result<(), PlantRequestError> {
    match request.kind()? {
        PlantKind::Status => {}
        PlantKind::ResetState => {
            let x = request.state(plant.order())?;
            plant.reset(&x.q(), &x.qd())?;
        }
        PlantKind::AdvanceTo => pacing.grant(request.seq)?,
        PlantKind::SetFault => set_fault(plant, first_cycle(next, request)?, request)?,
        PlantKind::ClearFaults => plant.clear_faults(),
        PlantKind::Push => {
            let from = first_cycle(next, request)?;
            plant.push(&Push { from, cycles: request.cycles, impulse: request.impulse })?;
        }
    }
    Ok(())
}

fn set_fault(plant: &mut Plant, from: u64, request: &PlantRequest) -> Result<(), PlantRequestError> {
    let kind = usize::try_from(request.fault).ok().and_then(|code| FaultKind::all().get(code));
    let Some(kind) = kind.copied() else {
        return Err(PlantRequestError::UnknownFault { got: request.fault, max: FaultKind::all().len() - 1 });
    };
    // Kinds of faults without a joint come with joint 0, which becomes an invalid index.
    let joint = usize::try_from(request.joint).unwrap_or(usize::MAX).wrapping_sub(1);
    let order = plant.order();
    let joint = if joint < order.sizes().joints() { order.coordinate(joint) } else { joint };
    let (cycles, amount) = (request.cycles, request.amount);
    let fault = Fault { kind, from, cycles, joint, amount };
    Ok(plant.set_fault(&fault)?)
}

/// The first cycle of the fault or push in a request; `next`: the first cycle that can still change.
fn first_cycle(next: u64, request: &PlantRequest) -> Result<u64, SetEventError> {
    match request.seq {
        0 => Ok(next),
        got if got < next => Err(SetEventError::Past { next, got }),
        seq => Ok(seq),
    }
}
