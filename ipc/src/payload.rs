//! Payloads: the messages in shared memory. `#[repr(C)]` structs of 8-byte numbers only, so there is no padding and a program
//! in any language can map them. SI units: positions, velocities, accelerations and torques in rad, rad/s, rad/s^2 and N m for
//! revolute joints, in m, m/s, m/s^2 and N for prismatic ones; times in s unless the name ends in `_ns`.
//!
//! Payloads with values of joints name n = `joints` and n_A = `actuated`. Their arrays have room for
//! [`MOST_JOINTS`](upswing_model::MOST_JOINTS): one value per joint from base to tip, or one per actuated joint from base to tip, then
//! zeros, which readers ignore. Each such payload converts from and to sorted vectors in one place, which refuses the
//! joints of another chain ([`OtherChain`]).

mod chain;
mod codes;
mod control;
mod cycle;
mod manoeuvre;
mod plan;
mod planner;
mod plant;
mod step;
mod text;
mod words;

pub use chain::OtherChain;
pub use codes::{
    Clock, ControlKind, Degradation, Mode, PlannerKind, PlannerStatus, PlantKind, Readiness, UnknownClock,
    UnknownCode,
};
pub use control::{ControlRequest, ControlResponse, Percentiles};
pub use cycle::{Command, CycleVectors, Measurement, Telemetry, TelemetryBatch};
pub use manoeuvre::{ManoeuvreRequest, Name, NoName};
pub use plan::{DamagedPlan, PlanHeader, PlanMessage};
pub use planner::{PlannerRequest, PlannerResponse};
pub use plant::{PlantRequest, PlantResponse};
pub use step::{RecordedStep, StepBatch};
pub use text::{Text, TextError};
