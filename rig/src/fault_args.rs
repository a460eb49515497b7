//! A fault of the plant as the command line and the tables of the documentation state it.

use upswing_config::{EventError, Fault, FaultKind};
use upswing_ipc::{PlantKind, PlantRequest};
use upswing_process::number::whole;

/// A fault as the command line states it.
#[derive(Clone, Debug, clap::Args)]
pub struct FaultArgs {
    /// What breaks
    pub kind: FaultKind,
    /// Joint of an encoder, 1 to 9, or of a torque, 1 to 7
    #[arg(long, value_parser = whole(0, u64::MAX))]
    pub joint: Option<u64>,
    /// How far the encoder jumps, rad, how late measurements are, cycles, or the torque, N m
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    pub amount: f64,
    /// How many cycles it lasts; 0: until `clear`
    #[arg(long, default_value_t = 0, value_parser = whole(0, u64::MAX))]
    pub cycles: u64,
    /// First cycle of the plant [default: the next one]
    #[arg(long, value_name = "CYCLE", value_parser = whole(0, u64::MAX))]
    pub from: Option<u64>,
}

impl FaultArgs {
    /// The fault; one that begins in cycle 0 begins in the next one.
    ///
    /// # Errors
    /// [`EventError`] if it cannot be.
    pub fn fault(&self) -> Result<Fault, EventError> {
        // Joint 0 is none; what counts from 0 here counts from 1 on the command line.
        let joint = usize::try_from(self.joint.unwrap_or_default()).unwrap_or(usize::MAX).wrapping_sub(1);
        let Self { kind, amount, cycles, .. } = *self;
        let fault = Fault { kind, from: self.from.unwrap_or_default(), cycles, joint, amount };
        fault.check().map(|()| fault)
    }

    /// The request for it.
    ///
    /// # Errors
    /// As [`FaultArgs::fault`].
    pub fn request(&self) -> Result<PlantRequest, EventError> {
        let fault = self.fault()?;
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
