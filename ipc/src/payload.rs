//! Payloads: the messages in shared memory. `#[repr(C)]` structs of 8-byte numbers only, so there is no padding and a program
//! in any language can map them. Angles in rad, velocities in rad/s, torques in N m, times in s unless the name ends in `_ns`;
//! joints run from the base to the tip, q = [q_A, q_U].

mod codes;
mod control;
mod cycle;
mod plan;
mod planner;
mod plant;
mod step;
mod text;
mod words;

pub use codes::{
    Clock, ControlKind, Degradation, Mode, PlannerKind, PlannerStatus, PlantKind, Readiness, UnknownClock,
    UnknownCode,
};
pub use control::{ControlRequest, ControlResponse, Percentiles};
pub use cycle::{Command, Measurement, Telemetry, TelemetryBatch};
pub use plan::{DamagedPlan, PlanMessage};
pub use planner::{PlannerRequest, PlannerResponse};
pub use plant::{PlantRequest, PlantResponse};
pub use step::{RecordedStep, StepBatch};
pub use text::{Text, TextError};
