//! What the telemetry of a long run says: cycles, and which of them came late or not at all.

use serde::Serialize;
use std::collections::BTreeMap;
use upswing_ipc::{Clock, Telemetry};

/// Counts of a long run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CycleCounts {
    /// Cycles of all daemons that arrived here.
    pub cycles: u64,
    /// Cycles that the daemon ran but that did not arrive here.
    pub telemetry_lost: u64,
    /// How often the daemon found how many measurements missed between two that it saw.
    pub missed: BTreeMap<u64, u64>,
    /// Cycles without a new measurement: the plant was late.
    pub without_measurement: u64,
    /// Cycles that ended after the next one should have begun, by their longest phase.
    pub late: BTreeMap<&'static str, u64>,
    #[serde(skip)]
    last: Option<Telemetry>,
}

impl CycleCounts {
    /// Counts records in their order, on `clock`.
    pub fn count(&mut self, records: &[Telemetry], clock: Clock) {
        for record in records {
            self.cycles += 1;
            let last = self.last.replace(*record);
            let stale = record.flags & Telemetry::STALE != 0;
            // Without a plant, or before the first measurement, nothing can be new.
            self.without_measurement +=
                u64::from(stale && clock.is_real_time() && record.measurement_seq > 0);
            if record.flags & Telemetry::OVERRUN != 0 {
                *self.late.entry(longest_phase(record)).or_default() += 1;
            }
            let Some(last) = last.filter(|last| record.seq > last.seq) else { continue };
            self.telemetry_lost += record.seq - last.seq - 1;
            // What the daemon missed, not what was lost on the way here.
            if record.seq == last.seq + 1 && last.measurement_seq > 0 {
                let missed = record.measurement_seq.saturating_sub(last.measurement_seq + 1);
                if missed > 0 {
                    *self.missed.entry(missed).or_default() += 1;
                }
            }
        }
    }

    /// Stretches of missed measurements, and cycles in them.
    pub fn misses(&self) -> (u64, u64) {
        self.missed.iter().fold((0, 0), |(n, sum), (length, count)| (n + count, sum + length * count))
    }
}

fn longest_phase(t: &Telemetry) -> &'static str {
    let phases = [("wake", t.wake_ns), ("read", t.read_ns), ("compute", t.compute_ns), ("write", t.write_ns)];
    phases.into_iter().max_by_key(|(_, ns)| *ns).map_or("", |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::CycleCounts;
    use upswing_ipc::{Clock, Telemetry};

    fn record(seq: u64, measurement_seq: u64, flags: u64) -> Telemetry {
        Telemetry { seq, measurement_seq, flags, wake_ns: 9, read_ns: 1, ..Telemetry::default() }
    }

    #[test]
    fn misses_are_those_of_the_daemon() {
        let mut cycles = CycleCounts::default();
        let first = [record(1, 10, 0), record(2, 14, Telemetry::OVERRUN), record(3, 14, Telemetry::STALE)];
        cycles.count(&first, Clock::Wall);
        // Two records lost on the way here, then another daemon, then another plant.
        cycles.count(&[record(6, 17, 0), record(1, 30, 0), record(2, 33, 0), record(3, 1, 0)], Clock::Wall);
        assert_eq!((cycles.cycles, cycles.telemetry_lost, cycles.without_measurement), (7, 2, 1));
        assert_eq!(cycles.missed.into_iter().collect::<Vec<_>>(), [(2, 1), (3, 1)]);
        assert_eq!(cycles.late.into_iter().collect::<Vec<_>>(), [("wake", 1)]);
    }
}
