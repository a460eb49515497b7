//! Recordings of every cycle in one MCAP file (<https://mcap.dev>), which Foxglove, PlotJuggler and Python read.
//!
//! | topic | type | rate | what |
//! |---|---|---|---|
//! | `/upswing/cycle` | `upswing_msgs/msg/Cycle` | every cycle | all fields of [`upswing_ipc::Telemetry`] |
//! | `/upswing/step` | `upswing_msgs/msg/Step` | every step | the input of the controller, [`upswing_ipc::Step`] |
//! | `/upswing/plan` | `upswing_msgs/msg/Plan` | each plan | [`upswing_ipc::Plan`], before the step that loads it |
//! | `/joint_states` | `sensor_msgs/msg/JointState` | 125 Hz | q, qd, measured torque |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | 125 Hz | frame of each link of the URDF in that of its parent |
//! | `/robot_description` | `std_msgs/msg/String` | once | the URDF |
//!
//! Messages are ROS 2 messages in CDR, with their definitions in the file: all of the named tools know them, no ROS is
//! needed, and a cycle is its bytes in shared memory behind a header of four bytes. Protobuf would need a generated
//! descriptor and is no smaller for arrays of doubles; JSON is four times as large.
//!
//! Times of messages are `t_ns` of the cycle: CLOCK_MONOTONIC on the wall clock, else time since the plant's start.
//! The settings are attachments; what else identifies the run is in the metadata record [`DETAILS`]. Chunks are complete
//! in the file every [`CHUNK`] cycles, so that a killed process loses at most those.

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

/// Name of the metadata record with what identifies the run.
pub const DETAILS: &str = "upswing";
/// Cycles of one chunk: a quarter of a second at 8 kHz, large enough to compress well.
pub const CHUNK: usize = 2048;
/// Topic of the cycles.
const CYCLE_TOPIC: &str = "/upswing/cycle";

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be made.
    #[error("cannot create {}: {cause}{}", path.display(), advice(cause))]
    Create {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: std::io::Error,
    },
    /// The file cannot be written to.
    #[error("cannot write to {}: {cause}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: Box<mcap::McapError>,
    },
    /// The file cannot be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: std::io::Error,
    },
    /// Another kind of file.
    #[error("{}: expected an MCAP recording, got something else ({cause})", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// What the reader says.
        cause: Box<mcap::McapError>,
    },
    /// Cycles of another version.
    #[error("{}: {what}; read it with the version of upswing that wrote it", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// What differs.
        what: String,
    },
    /// Nothing in it to work with.
    #[error("{}: expected {expected}, got none", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What was to be there.
        expected: String,
    },
    /// The robot in it cannot be used.
    #[error("{}: {cause}", path.display())]
    Robot {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: upswing_model::UrdfError,
    },
    /// What is to be recorded does not come.
    #[error(transparent)]
    Ipc(#[from] upswing_ipc::IpcError),
    /// The settings cannot be read any more.
    #[error(transparent)]
    Settings(#[from] upswing_config::ConfigError),
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
            RecordingError::Write { .. } | RecordingError::Ipc(_) => Self::Failed(e.to_string()),
            _ => Self::BadInput(e.to_string()),
        }
    }
}
