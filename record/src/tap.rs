//! From a running system into a recording.

use super::{Recorder, RecordingError};
use upswing_ipc::{IpcError, Node, Plan, StepBatch, Subscriber, Telemetry, TelemetryBatch};

/// All that a recording is made of, as it comes from a running system.
pub struct Tap {
    telemetry: Subscriber<TelemetryBatch>,
    steps: Subscriber<StepBatch>,
    plans: Subscriber<Plan>,
}

impl Tap {
    /// Listens from now on.
    ///
    /// # Errors
    /// If there are too many listeners, or shared memory cannot be used.
    pub fn new(node: &Node) -> Result<Self, IpcError> {
        Ok(Self { telemetry: node.subscriber()?, steps: node.subscriber()?, plans: node.subscriber()? })
    }

    /// Takes all that is waiting: into `recorder` where there is one, and the cycles to `see`, too.
    ///
    /// # Errors
    /// [`RecordingError::Ipc`], [`RecordingError::Write`].
    pub fn drain(
        &self,
        mut recorder: Option<&mut Recorder>,
        mut see: impl FnMut(&[Telemetry]),
    ) -> Result<(), RecordingError> {
        while let Some(steps) = self.steps.receive()? {
            // A plan was published before the step that loads it: it is there by now.
            while let Some(plan) = self.plans.receive()? {
                if let Some(recorder) = &mut recorder {
                    recorder.write_plan(&plan)?;
                }
            }
            if let Some(recorder) = &mut recorder {
                recorder.write_steps(steps.used())?;
            }
        }
        while let Some(batch) = self.telemetry.receive()? {
            if let Some(recorder) = &mut recorder {
                recorder.write(batch.used())?;
            }
            see(batch.used());
        }
        Ok(())
    }
}
