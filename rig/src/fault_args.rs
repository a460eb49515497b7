//! Faults of the simulated plant, parsed from the command line and from the tables of the documentation.

use upswing_config::{Fault, FaultError, FaultKind};
use upswing_ipc::{PlantKind, PlantRequest};
use upswing_model::Model;
use upswing_process::number::whole;

/// Arguments that describe a fault.
#[derive(Clone, Debug, clap::Args)]
pub struct FaultArgs {
    /// Kind of the fault
    pub kind: FaultKind,
    /// Joint by its name in the URDF: any for an encoder, an actuated one for a torque
    #[arg(long, value_name = "NAME")]
    pub joint: Option<String>,
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
    /// [`FaultError`] if joint or amount do not suit the kind.
    pub fn fault(&self, model: &Model) -> Result<Fault, FaultError> {
        let joint = self.kind.joint(self.joint.as_deref(), model)?;
        let Self { kind, amount, cycles, .. } = *self;
        let fault = Fault { kind, from: self.from.unwrap_or_default(), cycles, joint, amount };
        fault.check(model.sizes())?;
        Ok(fault)
    }

    /// The request to the plant that sets the fault.
    ///
    /// # Errors
    /// As [`FaultArgs::fault`].
    pub fn request(&self, model: &Model) -> Result<PlantRequest, FaultError> {
        let fault = self.fault(model)?;
        // Counted from 1 at the base; 0 for kinds without a joint.
        let joint = self.joint.as_ref().map_or(0, |_| model.order().joint(fault.joint) as u64 + 1);
        Ok(PlantRequest {
            seq: fault.from,
            fault: fault.kind.code(),
            joint,
            amount: fault.amount,
            cycles: fault.cycles,
            ..PlantRequest::new(PlantKind::SetFault)
        })
    }
}
