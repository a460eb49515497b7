//! How long the phases of a cycle took.

use serde::Serialize;
use upswing_ipc::Telemetry;

/// Bins per factor of two.
const BINS_PER_OCTAVE: f64 = 4.0;

/// Distribution of one duration, us.
#[derive(Clone, Debug, Serialize)]
pub struct Times {
    /// What took so long.
    pub name: &'static str,
    /// 50, 99, 99.9 and 100 %, us.
    pub percentiles: [f64; 4],
    /// Lower end of the first bin, us; each bin ends at `ratio` times its lower end.
    pub first: f64,
    /// See `first`.
    pub ratio: f64,
    /// Cycles in each bin.
    pub counts: Vec<u64>,
}

impl Times {
    /// Wake-up and computing time, as far as they were measured: on `lockstep` they are not.
    pub fn of(records: &[Telemetry]) -> Vec<Self> {
        let wake = records.iter().map(|t| t.wake_ns).collect();
        let compute = |t: &Telemetry| t.read_ns.saturating_add(t.compute_ns).saturating_add(t.write_ns);
        let compute = records.iter().map(compute).collect();
        [Self::new("wake-up", wake), Self::new("compute", compute)].into_iter().flatten().collect()
    }

    fn new(name: &'static str, mut ns: Vec<u64>) -> Option<Self> {
        ns.retain(|ns| *ns > 0);
        ns.sort_unstable();
        let longest = *ns.last()?;
        let bin = |ns: u64| ((ns as f64).log2() * BINS_PER_OCTAVE).floor() as usize;
        let lowest = bin(ns[0]);
        let mut counts = vec![0; bin(longest) - lowest + 1];
        ns.iter().for_each(|ns| counts[bin(*ns) - lowest] += 1);
        let share = |share: f64| ns[((ns.len() as f64 * share).ceil() as usize).clamp(1, ns.len()) - 1];
        Some(Self {
            name,
            percentiles: [0.5, 0.99, 0.999, 1.0].map(|p| share(p) as f64 * 1e-3),
            first: (lowest as f64 / BINS_PER_OCTAVE).exp2() * 1e-3,
            ratio: (1.0 / BINS_PER_OCTAVE).exp2(),
            counts,
        })
    }
}
