//! Recording of a running system: subscriptions to its telemetry, steps and plans.

use super::{Recorder, RecordingError};
use upswing_ipc::{IpcError, Node, PlanMessage, StepBatch, Subscriber, Telemetry, TelemetryBatch};

/// Subscriptions to the messages of a running system that a recording contains.
pub struct Tap {
    telemetry: Subscriber<TelemetryBatch>,
    steps: Subscriber<StepBatch>,
    plans: Subscriber<PlanMessage>,
}

impl Tap {
    /// Subscribes; messages published from now on are received.
    ///
    /// # Errors
    /// [`IpcError`] if there are too many subscribers, or shared memory cannot be used.
    pub fn new(node: &Node) -> Result<Self, IpcError> {
        Ok(Self { telemetry: node.subscriber()?, steps: node.subscriber()?, plans: node.subscriber()? })
    }

    /// Receives all waiting messages and writes them to `recorder`, if given; `see` gets the cycles, too.
    ///
    /// # Errors
    /// [`RecordingError::Ipc`], [`RecordingError::Write`].
    pub fn drain(
        &self,
        mut recorder: Option<&mut Recorder>,
        mut see: impl FnMut(&[Telemetry]),
    ) -> Result<(), RecordingError> {
        while let Some(steps) = self.steps.receive()? {
            // A plan is published before the step that loads it, so that it has arrived by now.
            while let Some(plan) = self.plans.receive()? {
                // The daemon refuses a plan of impossible sizes.
                if let (Some(recorder), Ok(plan)) = (&mut recorder, plan.copied()) {
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
