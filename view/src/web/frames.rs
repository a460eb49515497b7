//! What the page draws, in frames of JSON that any number of readers follow.

use crate::live::View;
use crate::page::round;
use crate::page::times::{LatencyHistogram, LatencyHistograms};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use upswing_ipc::Telemetry;
use upswing_model::{NQ, NU};

/// Time between two samples of the motion, ns: more than a screen shows.
const STEP_NS: u64 = 8_000_000;
/// Frames that a new page gets at once, 10 s; a reader that falls behind farther misses some.
const KEPT: usize = 250;
/// Events in one frame.
const EVENTS: usize = 30;

/// Picks samples of the motion.
#[derive(Default)]
pub(super) struct MotionSampler {
    frame: Motion,
    times: LatencyHistograms,
    sampled_ns: Option<u64>,
}

/// The motion since the frame before. Times in s on the clock of the plant, rad, rad/s, N m; columns of one joint each.
#[derive(Clone, Serialize)]
struct Motion {
    t: Vec<f64>,
    mode: Vec<String>,
    q: Vec<Vec<f64>>,
    q_d: Vec<Vec<f64>>,
    qd: Vec<Vec<f64>>,
    qd_d: Vec<Vec<f64>>,
    tau: Vec<Vec<f64>>,
    /// Times of cycles that ended late.
    late: Vec<f64>,
}

impl Default for Motion {
    fn default() -> Self {
        let columns = |n| vec![Vec::new(); n];
        Self {
            t: Vec::new(),
            mode: Vec::new(),
            q: columns(NQ),
            q_d: columns(NQ),
            qd: columns(NQ),
            qd_d: columns(NQ),
            tau: columns(NU),
            late: Vec::new(),
        }
    }
}

#[derive(Serialize)]
struct Frame {
    view: View,
    motion: Motion,
    times: Vec<LatencyHistogram>,
}

impl MotionSampler {
    /// The next cycle.
    pub fn take(&mut self, record: &Telemetry) {
        let t = record.t_ns as f64 * 1e-9;
        self.times.count(record);
        if record.flags & Telemetry::OVERRUN != 0 {
            self.frame.late.push(t);
        }
        // Another plant may have begun at 0 again.
        let due = |last: u64| record.t_ns < last || record.t_ns - last >= STEP_NS;
        if self.sampled_ns.is_some_and(|last| !due(last)) {
            return;
        }
        self.sampled_ns = Some(record.t_ns);
        let m = &mut self.frame;
        m.t.push(t);
        m.mode.push(record.mode_text());
        for (columns, values) in [
            (&mut m.q, &record.q[..]),
            (&mut m.q_d, &record.q_d),
            (&mut m.qd, &record.qd),
            (&mut m.qd_d, &record.qd_d),
            (&mut m.tau, &record.tau),
        ] {
            for (column, value) in columns.iter_mut().zip(values) {
                column.push(round(*value, 1e4));
            }
        }
    }

    /// What has come since the last frame.
    pub fn frame(&mut self, mut view: View) -> String {
        view.events.drain(..view.events.len().saturating_sub(EVENTS));
        let motion = std::mem::take(&mut self.frame);
        // Numbers that are not finite become null, which the page does not draw.
        serde_json::to_string(&Frame { view, motion, times: self.times.times() }).unwrap_or_default()
    }
}

/// The newest frames.
pub(super) struct FrameBuffer {
    frames: Mutex<Frames>,
    /// Number of the next frame.
    next: watch::Sender<u64>,
}

#[derive(Default)]
struct Frames {
    /// Number of the first one kept.
    first: u64,
    kept: VecDeque<Arc<str>>,
}

/// Reads the frames in order.
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

    /// Begins with the oldest frame.
    pub fn reader(self: &Arc<Self>) -> FrameReader {
        FrameReader { frames: Arc::clone(self), pushed: self.next.subscribe(), next: 0 }
    }

    /// Nothing is left half done by a thread that panics.
    fn lock(&self) -> MutexGuard<'_, Frames> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The first frame kept from number `next` on, and the number after it.
    fn get(&self, next: u64) -> Option<(Arc<str>, u64)> {
        let frames = self.lock();
        let next = next.max(frames.first);
        let frame = frames.kept.get(usize::try_from(next - frames.first).ok()?)?;
        Some((Arc::clone(frame), next + 1))
    }
}

impl FrameReader {
    /// Waits for the next frame; `None`: none follows.
    pub async fn next(&mut self) -> Option<Arc<str>> {
        loop {
            // Before the look: a frame that comes after it is a change.
            self.pushed.mark_unchanged();
            if let Some((frame, next)) = self.frames.get(self.next) {
                self.next = next;
                return Some(frame);
            }
            self.pushed.changed().await.ok()?;
        }
    }
}
