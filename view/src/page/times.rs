//! Distributions of the wake-up and computing times of cycles.

use serde::Serialize;
use std::collections::BTreeMap;
use upswing_ipc::{Clock, Telemetry};
use upswingd::histogram::Histogram;

/// Bins per factor of two.
const BINS_PER_OCTAVE: f64 = 4.0;

/// Distribution of one duration, us.
#[derive(Clone, Debug, Serialize)]
pub struct LatencyHistogram {
    /// Name of the duration.
    pub name: &'static str,
    /// 50, 99, 99.9 and 100 %, us; all but the last at most 7 % too large.
    pub percentiles: [f64; 4],
    /// Lower end of the first bin, us; each bin ends at `ratio` times its lower end.
    pub first: f64,
    /// Upper end of a bin divided by its lower end.
    pub ratio: f64,
    /// Cycles in each bin.
    pub counts: Vec<u64>,
}

/// Counts the wake-up and computing times of cycles.
#[derive(Clone, Debug, Default)]
pub struct LatencyHistograms {
    wake: LatencyCounter,
    compute: LatencyCounter,
}

#[derive(Clone, Debug, Default)]
struct LatencyCounter {
    histogram: Histogram,
    /// Counts of cycles by bin.
    bins: BTreeMap<u32, u64>,
}

impl LatencyHistograms {
    /// Counts the next cycle.
    pub fn count(&mut self, t: &Telemetry) {
        let clock = t.clock();
        if clock.is_ok_and(Clock::is_real_time) {
            self.wake.count(t.wake_ns);
        }
        if clock.is_ok_and(Clock::is_timed) {
            self.compute.count(t.read_ns.saturating_add(t.compute_ns).saturating_add(t.write_ns));
        }
    }

    /// Returns the distributions so far: none with the clock `lockstep`, which measures nothing; no wake-ups with `paced`.
    pub fn times(&self) -> Vec<LatencyHistogram> {
        [self.wake.times("wake-up"), self.compute.times("compute")].into_iter().flatten().collect()
    }
}

impl LatencyCounter {
    fn count(&mut self, ns: u64) {
        self.histogram.add(ns);
        // The scale of the bins is logarithmic and begins at 1 ns.
        let bin = (ns.max(1) as f64).log2() * BINS_PER_OCTAVE;
        *self.bins.entry(bin.floor() as u32).or_default() += 1;
    }

    fn times(&self, name: &'static str) -> Option<LatencyHistogram> {
        let (first, last) = (*self.bins.keys().next()?, *self.bins.keys().next_back()?);
        let p = self.histogram.percentiles();
        Some(LatencyHistogram {
            name,
            percentiles: [p.p50, p.p99, p.p99_9, p.max].map(|ns| ns as f64 * 1e-3),
            first: (f64::from(first) / BINS_PER_OCTAVE).exp2() * 1e-3,
            ratio: (1.0 / BINS_PER_OCTAVE).exp2(),
            counts: (first..=last).map(|bin| self.bins.get(&bin).copied().unwrap_or(0)).collect(),
        })
    }
}
