//! Digest of a recording for its page and figures: its size does not grow with the number of cycles.

use super::ModeSpan;
use super::times::LatencyHistograms;
use std::path::Path;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::{Model, Posture};
use upswing_record::evaluation::{MotionStatistics, MotionStatisticsCounter};
use upswing_record::{Elapsed, Recording, RecordingError, Tally};

/// Shortest time between two samples, ns: 250 per second are smooth on a screen.
const STEP_NS: u64 = 4_000_000;
/// Most samples; a longer recording gets a coarser motion.
const SAMPLES: usize = 30_000;

/// Digest of a recording, built cycle by cycle.
pub struct RecordingDigest {
    /// Model of the recorded robot.
    pub model: Model,
    /// Cycles at least [`Self::step`] apart; `t_ns` counted from the first cycle.
    pub samples: Vec<Telemetry>,
    /// Counts of all cycles.
    pub tally: Tally,
    /// Distribution of the wake-up and computing times of all cycles.
    pub times: LatencyHistograms,
    /// Warnings that occurred in any cycle, bits as in [`Telemetry`].
    pub warnings: u64,
    /// Degradations that occurred in any cycle, bits as in [`Telemetry`].
    pub degraded: u64,
    /// Control period, s.
    pub period: f64,
    step_ns: u64,
    /// Statistics for an end in Balance, and for one in Hold after a plan.
    statistics: [MotionStatisticsCounter; 2],
    /// Mode or fault, begin and end, ns, of each time span in one mode.
    spans: Vec<(String, u64, u64)>,
    state: Option<(u64, u64)>,
    late_ns: Vec<u64>,
    elapsed: Elapsed,
    plan_ns: Option<u64>,
}

impl RecordingDigest {
    /// Creates the digest of no cycle yet; `recording` holds details and attachments of the file `path`.
    ///
    /// # Errors
    /// [`RecordingError`] if the recording has no URDF or the model cannot be built from it.
    pub fn new(path: &Path, recording: &Recording) -> Result<Self, RecordingError> {
        Ok(Self {
            model: recording.model(path)?,
            samples: Vec::new(),
            tally: Tally::default(),
            times: LatencyHistograms::default(),
            warnings: 0,
            degraded: 0,
            period: period(recording),
            step_ns: STEP_NS,
            statistics: [Posture::Standing, Posture::Hanging].map(MotionStatisticsCounter::new),
            spans: Vec::new(),
            state: None,
            late_ns: Vec::new(),
            elapsed: Elapsed::default(),
            plan_ns: None,
        })
    }

    /// Takes the next cycle.
    pub fn take(&mut self, record: &Telemetry) {
        let t = self.elapsed.until(record.t_ns);
        let record = &Telemetry { t_ns: t, ..*record };
        self.tally.count(record);
        self.times.count(record);
        for statistics in &mut self.statistics {
            statistics.count(&self.model, self.model.rated_limits(), record);
        }
        self.warnings |= record.warnings;
        self.degraded |= record.degraded;
        if record.mode() == Ok(Mode::Track) {
            self.plan_ns.get_or_insert(t);
        }
        if record.flags & Telemetry::OVERRUN != 0 && self.late_ns.len() < SAMPLES {
            self.late_ns.push(t);
        }
        if let Some(span) = self.spans.last_mut() {
            span.2 = t;
        }
        if self.state.replace((record.mode, record.fault)) != Some((record.mode, record.fault)) {
            self.spans.push((name(record), t, t));
        }
        if self.samples.last().is_none_or(|last| t - last.t_ns >= self.step_ns) {
            self.samples.push(*record);
        }
        if self.samples.len() > SAMPLES {
            let mut keep = false;
            self.samples.retain(|_| {
                keep = !keep;
                keep
            });
            self.step_ns *= 2;
        }
    }

    /// Time between two samples, s.
    pub fn step(&self) -> f64 {
        (self.step_ns as f64 * 1e-9).max(self.period)
    }

    /// Statistics of the motion in all cycles, with the mode in which it ended: Balance if the recording has it, otherwise Hold.
    pub fn statistics(&self) -> (Mode, MotionStatistics) {
        let [balance, hold] = self.statistics.each_ref().map(|s| s.statistics(self.period, self.tally.lost));
        if balance.balance_s > 0.0 { (Mode::Balance, balance) } else { (Mode::Hold, hold) }
    }

    /// Time spans of the modes in their order, s.
    pub fn spans(&self) -> Vec<ModeSpan> {
        let span = |(name, from, to): &(String, u64, u64)| ModeSpan {
            name: name.clone(),
            from: self.seconds(*from),
            to: self.seconds(*to),
        };
        self.spans.iter().map(span).collect()
    }

    /// Times of overrun cycles, s.
    pub fn late(&self) -> Vec<f64> {
        self.late_ns.iter().map(|t| self.seconds(*t)).collect()
    }

    /// Converts a time in ns since the first cycle to s from the start of the first plan, or from the first cycle without a plan.
    pub fn seconds(&self, t_ns: u64) -> f64 {
        super::motion::round((t_ns as f64 - self.plan_ns.unwrap_or(0) as f64) * 1e-9, 1e6)
    }
}

/// Text of the mode, or of the cause of a fault.
fn name(record: &Telemetry) -> String {
    let mode = record.mode_text();
    let cause = upswingd::fault_text(record.fault).filter(|_| record.mode() == Ok(Mode::Fault));
    cause.map_or_else(|| mode.clone(), |cause| format!("{mode}: {cause}"))
}

/// Control period with which the recording was made, s.
fn period(recording: &Recording) -> f64 {
    /// Period if the recording states none that is valid, us.
    const USUAL_US: f64 = 125.0;
    let us = recording.details.get("period_us").and_then(|us| us.parse().ok());
    us.filter(|us| *us >= 1.0 && *us <= 1e6).unwrap_or(USUAL_US) * 1e-6
}
