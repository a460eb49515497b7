//! Counts cycles and the time that they take.

use serde::Serialize;
use upswing_ipc::Telemetry;

/// Time on the clock of the plant, which begins anew with another plant; the gap between two plants counts nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Elapsed {
    last_ns: Option<u64>,
    ns: u64,
}

impl Elapsed {
    /// Time from the first cycle to this one, the next, which began at `t_ns`; ns.
    pub fn until(&mut self, t_ns: u64) -> u64 {
        let last = self.last_ns.replace(t_ns).unwrap_or(t_ns);
        self.ns = self.ns.saturating_add(t_ns.saturating_sub(last));
        self.ns
    }
}

/// What has arrived so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Cycles that arrived.
    pub cycles: u64,
    /// Cycles missing between two that arrived.
    pub lost: u64,
    /// How often the numbers of the cycles began anew: another daemon.
    pub restarts: u64,
    /// From the first to the last cycle, as [`Elapsed`], s.
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

    /// Counts cycles in their order.
    pub fn of(records: &[Telemetry]) -> Self {
        let mut tally = Self::default();
        records.iter().for_each(|record| tally.count(record));
        tally
    }
}
