//! The recorded input of the controller, for replays.

use super::cycle::Measurement;
use super::words::{WORD, Zeroable, batch, words};
use iceoryx2::prelude::ZeroCopySend;

/// The recorded input of the controller in one step, daemon -> recordings. Together with the plans it determines all modes and
/// commands. Every cycle is a step; on the paced clock there are also steps between two cycles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Step.v2")]
pub struct RecordedStep {
    /// Number of the step since the start of the daemon, counts from 1.
    pub number: u64,
    /// `seq` of the cycle that it is, or that came before it.
    pub cycle: u64,
    /// Planned time of the cycle on the wall clock, CLOCK_MONOTONIC, ns; without meaning on the others.
    pub now_ns: u64,
    /// Cycles in a row that had ended late.
    pub late: u64,
    /// Just before the step, measurements had not come for so many cycles and counted as lost; 0: they had come.
    pub lost: u64,
    /// 1: just before the step, the measurements of another plant began; 0: they did not.
    pub restarted: u64,
    /// Code of the request, as the daemon numbers them; 0: none.
    pub request: u64,
    /// Id of the plan that the request loads or starts, 0: none.
    pub plan_id: u64,
    /// The newest measurement.
    pub measurement: Measurement,
}

const _: () = assert!(size_of::<RecordedStep>() == WORD * 8 + size_of::<Measurement>());

words!(RecordedStep);

/// Steps in one [`StepBatch`].
const STEP_BATCH: usize = 64;

/// Consecutive steps in one message.
#[repr(C)]
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[type_name("upswing.StepBatch.v2")]
pub struct StepBatch {
    /// Steps in use, 0..=64; not to be trusted, read with [`StepBatch::used`].
    pub count: u64,
    /// The steps, oldest first; meaningless from `count` on.
    pub records: [RecordedStep; STEP_BATCH],
}

const _: () = assert!(size_of::<StepBatch>() == WORD + STEP_BATCH * size_of::<RecordedStep>());

batch!(StepBatch of RecordedStep, STEP_BATCH);
