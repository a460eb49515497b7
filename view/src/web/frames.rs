//! Frames of JSON with the data that the live page draws, in a buffer for any number of readers.

use crate::live::View;
use crate::page::MotionColumns;
use crate::page::times::{LatencyHistogram, LatencyHistograms};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use upswing_ipc::Telemetry;
use upswing_model::Sizes;

/// Period of the motion samples, ns: shorter than that of a screen.
const STEP_NS: u64 = 8_000_000;
/// Frames in the buffer, 10 s: a new page gets all of them; a reader that is farther behind misses the oldest.
const KEPT: usize = 250;
/// Most events in one frame: the newest.
const EVENTS: usize = 30;

/// Samples the motion from telemetry for the next frame.
pub(super) struct MotionSampler {
    sizes: Sizes,
    frame: Motion,
    times: LatencyHistograms,
    sampled_ns: Option<u64>,
}

/// Motion since the previous frame. Times in s on the clock of the plant.
#[derive(Clone, Serialize)]
struct Motion {
    #[serde(flatten)]
    columns: MotionColumns,
    /// Mode at each sample.
    mode: Vec<String>,
    /// Times of overrun cycles, s.
    late: Vec<f64>,
}

/// One message of the live page: the view, and the motion since the previous message.
#[derive(Serialize)]
struct LiveFrame {
    view: View,
    motion: Motion,
    times: Vec<LatencyHistogram>,
}

impl Motion {
    fn new(sizes: Sizes) -> Self {
        Self { columns: MotionColumns::new(sizes), mode: Vec::new(), late: Vec::new() }
    }
}

impl MotionSampler {
    /// A sampler of the motion of a chain.
    pub fn new(sizes: Sizes) -> Self {
        Self { sizes, frame: Motion::new(sizes), times: LatencyHistograms::default(), sampled_ns: None }
    }

    /// Takes the telemetry of the next cycle.
    pub fn take(&mut self, record: &Telemetry) {
        let t = record.t_ns as f64 * 1e-9;
        self.times.count(record);
        if record.flags & Telemetry::OVERRUN != 0 {
            self.frame.late.push(t);
        }
        // A time before the last sample comes from another plant, whose clock starts at 0.
        let due = |last: u64| record.t_ns < last || record.t_ns - last >= STEP_NS;
        if self.sampled_ns.is_some_and(|last| !due(last)) {
            return;
        }
        self.sampled_ns = Some(record.t_ns);
        self.frame.columns.push(t, record);
        self.frame.mode.push(record.mode_text());
    }

    /// Serializes `view` and the motion since the previous frame as JSON, and clears the motion.
    pub fn frame(&mut self, mut view: View) -> String {
        view.events.drain(..view.events.len().saturating_sub(EVENTS));
        let motion = std::mem::replace(&mut self.frame, Motion::new(self.sizes));
        // Non-finite numbers become null, which the page does not draw.
        serde_json::to_string(&LiveFrame { view, motion, times: self.times.times() }).unwrap_or_default()
    }
}

/// Ring buffer of the newest frames, with any number of readers.
pub(super) struct FrameBuffer {
    frames: Mutex<Frames>,
    /// Number of the next frame, counted from 0.
    next: watch::Sender<u64>,
}

#[derive(Default)]
struct Frames {
    /// Number of the oldest frame in the buffer.
    first: u64,
    kept: VecDeque<Arc<str>>,
}

/// Reader of a [`FrameBuffer`].
pub(super) struct FrameReader {
    frames: Arc<FrameBuffer>,
    pushed: watch::Receiver<u64>,
    next: u64,
}

impl FrameBuffer {
    pub fn new() -> Arc<Self> {
        Arc::new(Self { frames: Mutex::default(), next: watch::Sender::default() })
    }

    pub fn push(&self, frame: String) {
        {
            let mut frames = self.lock();
            if frames.kept.len() == KEPT {
                frames.kept.pop_front();
                frames.first += 1;
            }
            frames.kept.push_back(frame.into());
        }
        self.next.send_modify(|next| *next += 1);
    }

    /// Returns a reader that begins with the oldest frame.
    pub fn reader(self: &Arc<Self>) -> FrameReader {
        FrameReader { frames: Arc::clone(self), pushed: self.next.subscribe(), next: 0 }
    }

    /// Locks the frames. A poisoned lock is used: no critical section can leave the frames inconsistent.
    fn lock(&self) -> MutexGuard<'_, Frames> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the oldest frame in the buffer with a number of at least `next`, and the number after it.
    fn get(&self, next: u64) -> Option<(Arc<str>, u64)> {
        let frames = self.lock();
        let next = next.max(frames.first);
        let frame = frames.kept.get(usize::try_from(next - frames.first).ok()?)?;
        Some((Arc::clone(frame), next + 1))
    }
}

impl FrameReader {
    /// Waits for the next frame; `None` once the buffer is dropped.
    pub async fn next(&mut self) -> Option<Arc<str>> {
        loop {
            // Before the frame is looked up: a frame pushed afterwards then counts as a change.
            self.pushed.mark_unchanged();
            if let Some((frame, next)) = self.frames.get(self.next) {
                self.next = next;
                return Some(frame);
            }
            self.pushed.changed().await.ok()?;
        }
    }
}
