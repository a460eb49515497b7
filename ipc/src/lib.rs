//! Shared memory between the processes of upswing: payload layouts, services and how to join them.
//!
//! | service | pattern | from -> to | payload |
//! |---|---|---|---|
//! | `measurement/<epoch>` | blackboard | plant -> daemon | [`Measurement`] |
//! | `command/<epoch>` | blackboard | daemon -> plant | [`Command`] |
//! | `plan` | pub/sub, history 1 | planner -> daemon | [`Plan`] |
//! | `telemetry` | pub/sub, no history | daemon -> planner, cli | [`TelemetryBatch`] |
//! | `steps` | pub/sub, no history | daemon -> cli | [`StepBatch`] |
//! | `control` | request/response | cli -> daemon | [`ControlRequest`] -> [`ControlResponse`] |
//! | `planner` | request/response | cli, daemon, harness -> planner | [`PlannerRequest`] -> [`PlannerResponse`] |
//! | `plant` | request/response | cli, harness -> plant | [`PlantRequest`] -> [`PlantResponse`] |
//!
//! A process picks a [`Domain`], connects to it and asks its [`Node`] for the ends it needs:
//!
//! ```
//! use upswing_ipc::{Command, OwnDomain};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let domain = OwnDomain::new("example")?;
//! let node = domain.connect("daemon")?;
//! let (command, _ports) = node.writer::<Command>()?.split();
//! command.write(Command { seq: 1, ..Command::default() });
//! # Ok(())
//! # }
//! ```
//!
//! # Two kinds of threads
//! Two objects may enter the real-time thread: [`WriterEntry`] and [`Reader`]. Their methods
//! neither allocate nor enter the kernel. All the rest (nodes, finders, publishers, clients, servers) opens
//! files, maps memory and cleans up after dead peers; it stays in one other thread.
//!
//! # Trust
//! Every process of a domain can write into what it shares with the others. The layouts therefore hold plain
//! numbers only, codes become enums through checked conversions ([`UnknownCode`]), [`Text`] is checked when it
//! is read, a [`Plan`] carries a checksum; sequence, age, range and finiteness are for the reader to check.
//!
//! This is the only crate that sees iceoryx2. Its version is exact, because every version of iceoryx2 has its
//! own layout of shared memory; a payload whose layout changes gets a new version in its type name.

mod blackboard;
mod codes;
mod construction;
mod domain;
mod error;
mod limits;
mod messages;
mod node;
pub mod operator;
mod own;
mod pacing;
mod payload;
mod request;
mod search;
mod services;
mod space;
mod text;
mod time;

pub use blackboard::{Finder, Reader, Writer, WriterEntry, WriterPorts};
pub use codes::{
    Clock, ControlCommand, Degradation, Mode, PlannerKind, PlannerStatus, PlantKind, UnknownClock,
    UnknownCode,
};
pub use domain::{Domain, DomainError};
pub use error::{CallError, Cause, IpcError};
pub use messages::{Publisher, Received, Subscriber};
pub use node::Node;
pub use own::OwnDomain;
pub use pacing::{
    Commands, CycleBegin, CycleStart, CycleTimes, DaemonPacing, DaemonWake, GrantError, PlantPacing,
    PlantWake, Presence,
};
pub use payload::{
    Command, ControlRequest, ControlResponse, DamagedPlan, Measurement, Percentiles, Plan, PlannerRequest,
    PlannerResponse, PlantRequest, PlantResponse, Step, StepBatch, Telemetry, TelemetryBatch,
};
pub use request::{Client, Server};
pub use search::{Search, is_lost};
pub use services::{Latest, MAX_NODES, MAX_READERS, Request, Topic};
pub use text::{Text, TextError};
pub use time::{monotonic_ns, sleep_until};
