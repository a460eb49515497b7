//! Recordings of every cycle in one MCAP file (<https://mcap.dev>), readable with Foxglove, PlotJuggler and Python.
//!
//! | topic | type | rate | contents |
//! |---|---|---|---|
//! | `/upswing/cycle` | `upswing_msgs/msg/Cycle` | every cycle | all fields of [`upswing_ipc::Telemetry`] |
//! | `/upswing/step` | `upswing_msgs/msg/Step` | every step | the input of the controller, [`upswing_ipc::RecordedStep`] |
//! | `/upswing/plan` | `upswing_msgs/msg/Plan` | each plan | [`upswing_ipc::PlanMessage`], before the step that loads it |
//! | `/joint_states` | `sensor_msgs/msg/JointState` | 125 Hz | q, qd, measured torque |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | 125 Hz | pose of each link of the URDF in the frame of its parent |
//! | `/robot_description` | `std_msgs/msg/String` | once | the URDF |
//!
//! Messages are ROS 2 messages in CDR, with their definitions in the file: all of these tools read them without ROS. Values of joints are
//! lists as long as the robot has joints, in the chain's order; the metadata contain the names of the joints ([`JOINTS`]). Protobuf would need a generated
//! descriptor and is no smaller for arrays of doubles; JSON is four times as large.
//!
//! Times of messages are `t_ns` of the cycle: CLOCK_MONOTONIC on the wall clock, otherwise time since the start of the plant.
//! The settings are attachments; further data that identify the run are in the metadata record [`DETAILS`]. A chunk is
//! completed every [`CHUNK`] cycles, so that a killed process loses at most one chunk.

mod cdr;
pub mod cycle;
pub mod evaluation;
mod flight;
mod messages;
mod parts;
mod reader;
pub mod replay;
pub mod robot;
mod tally;
mod tap;
mod writer;

pub use flight::RecordingFile;
pub use reader::{Message, Recording, Window, read, scan};
pub use tally::{Elapsed, Tally};
pub use tap::Tap;
pub use writer::Recorder;

use std::path::PathBuf;
use upswing_process::Failure;

/// Name of the metadata record with the data that identify the run.
pub const DETAILS: &str = "upswing";
/// Key of the names of the joints in that record, in the chain's order, separated by commas.
pub const JOINTS: &str = "joints";
/// Number of cycles per chunk: a quarter of a second at 8 kHz, large enough to compress well.
pub const CHUNK: usize = 2048;
/// Topic of the cycles.
const CYCLE_TOPIC: &str = "/upswing/cycle";
/// Topic of the steps.
const STEP_TOPIC: &str = "/upswing/step";

/// Error of writing or reading a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be created.
    #[error("cannot create {}: {cause}{}", path.display(), advice(cause))]
    Create {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// The file cannot be written to.
    #[error("cannot write to {}: {cause}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the writer.
        cause: Box<mcap::McapError>,
    },
    /// The file cannot be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// The file is no MCAP file.
    #[error("{}: expected an MCAP recording, got something else ({cause})", path.display())]
    NotMcap {
        /// Path of the file.
        path: PathBuf,
        /// Error of the MCAP reader.
        cause: Box<mcap::McapError>,
    },
    /// A message of another version: its length differs.
    #[error("{}: message {number} has {bytes} bytes; read it with the version of upswing that wrote it", path.display())]
    MessageLength {
        /// Path of the file.
        path: PathBuf,
        /// Number of the message.
        number: u32,
        /// Length of the message, bytes.
        bytes: usize,
    },
    /// A cycle of another robot than the cycles before it.
    #[error(
        "{}: message {number} is of {} joints, {} of them actuated, expected {} and {} as in the cycles before it",
        path.display(), .got.0, .got.1, .expected.0, .expected.1
    )]
    Joints {
        /// Path of the file.
        path: PathBuf,
        /// Number of the message.
        number: u32,
        /// Numbers of joints of the cycle, all and actuated.
        got: (u64, u64),
        /// Numbers of joints of the cycles before it.
        expected: (u64, u64),
    },
    /// A cycle to be recorded is of another robot.
    #[error(transparent)]
    OtherChain(#[from] upswing_ipc::OtherChain),
    /// A plan to be recorded has other sizes than its header states.
    #[error(transparent)]
    Plan(#[from] upswing_ipc::DamagedPlan),
    /// Messages of another version: their name or a field differs.
    #[error(
        "{}: the messages are `{name}` with {difference}, expected `{expected}`; read it with the version of upswing that \
         wrote it",
        path.display()
    )]
    Definition {
        /// Path of the file.
        path: PathBuf,
        /// Name of the message type in the file.
        name: String,
        /// Difference of the fields.
        difference: FieldDifference,
        /// Name of the message type in this version.
        expected: &'static str,
    },
    /// The recording lacks required contents.
    #[error("{}: expected {expected}, got none", path.display())]
    Missing {
        /// Path of the file.
        path: PathBuf,
        /// Missing contents.
        expected: String,
    },
    /// The URDF of the settings to be recorded cannot be used.
    #[error("{}: {cause}", path.display())]
    Robot {
        /// Path of the file.
        path: PathBuf,
        /// Error of the URDF.
        cause: upswing_model::UrdfError,
    },
    /// The messages to be recorded cannot be received.
    #[error(transparent)]
    Ipc(#[from] upswing_ipc::IpcError),
    /// The settings can no longer be read from their files.
    #[error(transparent)]
    Settings(#[from] upswing_config::ConfigError),
}

/// Difference between the fields of a message type in a file and those of this version.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldDifference {
    /// The number of fields.
    #[error("{got} fields, expected {expected}")]
    Count {
        /// Number of fields in the file.
        got: usize,
        /// Number of fields in this version.
        expected: usize,
    },
    /// The first field that differs.
    #[error("`{got}`, expected `{expected}`")]
    Field {
        /// The field in the file.
        got: String,
        /// The field in this version.
        expected: String,
    },
}

fn advice(cause: &std::io::Error) -> &'static str {
    match cause.kind() {
        std::io::ErrorKind::AlreadyExists => "; choose another name",
        _ => "",
    }
}

impl From<RecordingError> for Failure {
    fn from(e: RecordingError) -> Self {
        match e {
            RecordingError::Write { .. } | RecordingError::Ipc(_) | RecordingError::Plan(_) => {
                Self::failed(e)
            }
            _ => Self::bad_input(e),
        }
    }
}
