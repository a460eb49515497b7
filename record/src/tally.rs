//! Count of recorded and lost cycles, and the time that they span.

use serde::Serialize;
use upswing_ipc::Telemetry;

/// Elapsed time on the clock of the plant. The clock restarts with each plant; the gap between two plants does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Elapsed {
    last_ns: Option<u64>,
    ns: u64,
}

impl Elapsed {
    /// Time from the first cycle to the next cycle in order, which began at `t_ns`; ns.
    pub fn until(&mut self, t_ns: u64) -> u64 {
        let last = self.last_ns.replace(t_ns).unwrap_or(t_ns);
        self.ns = self.ns.saturating_add(t_ns.saturating_sub(last));
        self.ns
    }
}

/// Numbers of received, lost and restarted cycles, and their time span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Number of received cycles.
    pub cycles: u64,
    /// Number of cycles missing between received cycles.
    pub lost: u64,
    /// Number of restarts of the cycle numbers, each by another daemon.
    pub restarts: u64,
    /// Time from the first to the last cycle, as [`Elapsed`], s.
    pub seconds: f64,
    #[serde(skip)]
    elapsed: Elapsed,
    #[serde(skip)]
    last_seq: u64,
}

impl Tally {
    /// Counts the next cycle.
    pub fn count(&mut self, record: &Telemetry) {
        let restarted = record.seq <= self.last_seq;
        if self.cycles > 0 {
            self.restarts += u64::from(restarted);
            self.lost += record.seq.saturating_sub(self.last_seq).saturating_sub(1);
        }
        self.cycles += 1;
        self.last_seq = record.seq;
        self.seconds = self.elapsed.until(record.t_ns) as f64 * 1e-9;
    }

    /// Counts `records`, in their order.
    pub fn of(records: &[Telemetry]) -> Self {
        let mut tally = Self::default();
        records.iter().for_each(|record| tally.count(record));
        tally
    }
}
