//! Which payload travels over which service: the only place where a service is named.

use crate::payload::{
    Command, ControlRequest, ControlResponse, Measurement, Plan, PlannerRequest, PlannerResponse,
    PlantRequest, PlantResponse, StepBatch, TelemetryBatch,
};
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;

/// A payload of which only the latest value counts: written every cycle, read every cycle.
pub trait Latest: ZeroCopySend + Copy + Debug + Default + Send + 'static {
    /// Name of the channel; each writer start has its own service `<channel>/<epoch>`.
    const CHANNEL: &'static str;
}

impl Latest for Measurement {
    const CHANNEL: &'static str = "measurement";
}

impl Latest for Command {
    const CHANNEL: &'static str = "command";
}

/// A payload that one process publishes and several receive.
pub trait Topic: ZeroCopySend + Copy + Debug + 'static {
    /// Name of the service.
    const SERVICE: &'static str;
    /// Samples that wait for a slow subscriber before the oldest is replaced.
    const BUFFER: usize;
    /// Samples that a late subscriber still gets.
    const HISTORY: usize;
}

impl Topic for Plan {
    const SERVICE: &'static str = "plan";
    const BUFFER: usize = 2;
    const HISTORY: usize = 1;
}

impl Topic for TelemetryBatch {
    const SERVICE: &'static str = "telemetry";
    const BUFFER: usize = 256;
    const HISTORY: usize = 0;
}

impl Topic for StepBatch {
    const SERVICE: &'static str = "steps";
    const BUFFER: usize = 128;
    const HISTORY: usize = 0;
}

/// A payload that one server answers.
pub trait Request: ZeroCopySend + Copy + Debug + 'static {
    /// The answer.
    type Response: ZeroCopySend + Copy + Debug + 'static;
    /// Name of the service.
    const SERVICE: &'static str;
}

impl Request for ControlRequest {
    type Response = ControlResponse;
    const SERVICE: &'static str = "control";
}

impl Request for PlannerRequest {
    type Response = PlannerResponse;
    const SERVICE: &'static str = "planner";
}

impl Request for PlantRequest {
    type Response = PlantResponse;
    const SERVICE: &'static str = "plant";
}

/// Nodes (in practice: processes) that may have one service open at a time.
pub const MAX_NODES: usize = 24;
/// Readers of one blackboard.
pub const MAX_READERS: usize = 8;
/// Subscribers of one topic.
pub(crate) const MAX_SUBSCRIBERS: usize = 8;
/// Samples of one topic that a subscriber may hold at a time.
pub(crate) const MAX_BORROWED: usize = 2;
/// Clients of one server.
pub(crate) const MAX_CLIENTS: usize = 16;
