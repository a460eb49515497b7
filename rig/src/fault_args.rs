//! Faults of the simulated plant, parsed from the command line and from the tables of the documentation.

use upswing_config::{EventError, Fault, FaultKind};
use upswing_ipc::{PlantKind, PlantRequest};
use upswing_model::Model;
use upswing_process::number::whole;

/// Arguments that describe a fault.
#[derive(Clone, Debug, clap::Args)]
pub struct FaultArgs {
    /// Kind of the fault
    pub kind: FaultKind,
    /// Joint, counted from 1 at the base: any one for an encoder, one with a motor for a torque
    #[arg(long, value_parser = whole(0, u64::MAX))]
    pub joint: Option<u64>,
    /// Size: jump of the encoder, rad or m; delay of measurements, cycles; torque, N m, or force, N
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    pub amount: f64,
    /// Duration of the fault, cycles; 0: until `clear`
    #[arg(long, default_value_t = 0, value_parser = whole(0, u64::MAX))]
    pub cycles: u64,
    /// Cycle of the plant in which it begins [default: the next one]
    #[arg(long, value_name = "CYCLE", value_parser = whole(0, u64::MAX))]
    pub from: Option<u64>,
}

impl FaultArgs {
    /// The fault of the robot `model` that the arguments describe; its first cycle is 0 (the next cycle) without `--from`.
    ///
    /// # Errors
    /// [`EventError`] if joint or amount do not suit the kind.
    pub fn fault(&self, model: &Model) -> Result<Fault, EventError> {
        let (order, joints) = (model.order(), model.sizes().joints());
        // The command line counts joints from 1; joint 0 of the command line becomes invalid here.
        let joint = usize::try_from(self.joint.unwrap_or_default()).unwrap_or(usize::MAX).wrapping_sub(1);
        let joint = if joint < joints { order.coordinate(joint) } else { joint };
        let Self { kind, amount, cycles, .. } = *self;
        let fault = Fault { kind, from: self.from.unwrap_or_default(), cycles, joint, amount };
        fault.check(model.sizes()).map(|()| fault)
    }

    /// The request to the plant that sets the fault.
    ///
    /// # Errors
    /// As [`FaultArgs::fault`].
    pub fn request(&self, model: &Model) -> Result<PlantRequest, EventError> {
        let fault = self.fault(model)?;
        Ok(PlantRequest {
            seq: fault.from,
            fault: fault.kind.code(),
            joint: self.joint.unwrap_or_default(),
            amount: fault.amount,
            cycles: fault.cycles,
            ..PlantRequest::new(PlantKind::SetFault)
        })
    }
}
