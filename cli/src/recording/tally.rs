//! Counts cycles.

use serde::Serialize;
use upswing_ipc::Telemetry;

/// What has arrived so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Cycles that arrived.
    pub cycles: u64,
    /// Cycles missing between two that arrived.
    pub lost: u64,
    /// How often the numbers of the cycles began anew: another daemon.
    pub restarts: u64,
    /// From the first to the last cycle since the last restart, s.
    pub seconds: f64,
    #[serde(skip)]
    first_ns: u64,
    #[serde(skip)]
    last_seq: u64,
}

impl Tally {
    /// Counts the next cycle.
    pub fn count(&mut self, record: &Telemetry) {
        let restarted = record.seq <= self.last_seq;
        if self.cycles == 0 || restarted {
            self.first_ns = record.t_ns;
        } else {
            self.lost += record.seq - self.last_seq - 1;
        }
        self.restarts += u64::from(restarted && self.cycles > 0);
        self.cycles += 1;
        self.last_seq = record.seq;
        self.seconds = record.t_ns.saturating_sub(self.first_ns) as f64 * 1e-9;
    }

    /// Counts cycles in their order.
    pub fn of(records: &[Telemetry]) -> Self {
        let mut tally = Self::default();
        records.iter().for_each(|record| tally.count(record));
        tally
    }
}
