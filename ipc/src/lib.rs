//! Communication between the processes of upswing over shared memory (iceoryx2): payloads, services and their ports.
//!
//! | service | pattern | from -> to | payload |
//! |---|---|---|---|
//! | `measurement/<epoch>` | blackboard | plant -> daemon | [`Measurement`] |
//! | `command/<epoch>` | blackboard | daemon -> plant | [`Command`] |
//! | `plan` | pub/sub, history 1 | planner -> daemon | [`PlanMessage`]: a header and a slice as long as the plan |
//! | `telemetry` | pub/sub, no history | daemon -> planner, cli | [`TelemetryBatch`] |
//! | `steps` | pub/sub, no history | daemon -> cli | [`StepBatch`] |
//! | `control` | request/response | cli -> daemon | [`ControlRequest`] -> [`ControlResponse`] |
//! | `planner` | request/response | cli, daemon, harness -> planner | [`PlannerRequest`] -> [`PlannerResponse`] |
//! | `plant` | request/response | cli, harness -> plant | [`PlantRequest`] -> [`PlantResponse`] |
//!
//! A process joins a [`Domain`], and its [`Node`] creates the ports of services:
//!
//! ```
//! use upswing_ipc::{Command, TempDomain};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let domain = TempDomain::new("example")?;
//! let node = domain.join("daemon")?;
//! let (command, _ports) = node.writer::<Command>()?.split();
//! command.write(Command { seq: 1, ..Command::default() });
//! # Ok(())
//! # }
//! ```
//!
//! # Two kinds of threads
//! Two objects may move to the real-time thread: [`WriterEntry`] and [`Reader`]. Their methods neither allocate nor make
//! system calls. All other objects (nodes, finders, publishers, subscribers, clients, servers) open files, map memory and
//! clean up after dead peers; they stay in another thread.
//!
//! # Trust
//! Every process of a domain can write into the memory that it shares with the others. Payloads therefore hold numbers
//! only, codes become enumerations through checked conversions ([`UnknownCode`]), [`Text`] is checked when it is read, numbers of
//! joints must be those of the model ([`OtherChain`]), and a [`PlanMessage`] carries its length and a checksum. The reader checks sequence, age, range and finiteness.
//!
//! # Layers
//! From the bottom: `iox` (the private file layout of iceoryx2), domains and nodes, `services` (ports); beside them `payload`
//! (messages). This is the only crate that sees iceoryx2. The version of iceoryx2 is pinned, because each version has its
//! own layout of shared memory. A payload whose layout changes gets a new version in its type name.

mod domain;
mod error;
mod iox;
mod membership;
mod node;
pub mod operator;
mod pacing;
mod payload;
mod process_limits;
mod services;
mod temp_domain;
mod time;

pub use domain::{Domain, DomainError};
pub use error::{CallError, Cause, IpcError};
pub use node::{MAX_NODES, Node};
pub use pacing::{
    Commands, CycleBegin, CycleStart, CycleTimes, DaemonPacing, DaemonWake, GrantError, PlantPacing,
    PlantWake, Presence,
};
pub use payload::{
    Clock, Command, ControlKind, ControlRequest, ControlResponse, CycleVectors, DamagedPlan, Degradation,
    ManoeuvreRequest, Measurement, Mode, Name, NoName, OtherChain, Percentiles, PlanHeader, PlanMessage,
    PlannerKind, PlannerRequest, PlannerResponse, PlannerStatus, PlantKind, PlantRequest, PlantResponse,
    Readiness, RecordedStep, StepBatch, Telemetry, TelemetryBatch, Text, TextError, UnknownClock,
    UnknownCode,
};
pub use services::{
    BlackboardPayload, Client, Finder, FinderThread, MAX_READERS, Publisher, Reader, RequestPayload, Sample,
    Server, Subscriber, TopicPayload, Writer, WriterEntry, WriterPorts,
};
pub use temp_domain::TempDomain;
pub use time::{monotonic_ns, sleep_until};
