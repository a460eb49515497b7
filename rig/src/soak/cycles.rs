//! Counts of control cycles in the telemetry of a long run: late cycles, missed measurements, lost records.

use serde::Serialize;
use std::collections::BTreeMap;
use upswing_ipc::{Clock, Telemetry};

/// Counts of cycles, late cycles and missed measurements of a long run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CycleCounts {
    /// Telemetry records received, of all daemon processes together.
    pub cycles: u64,
    /// Telemetry records lost between the daemon and this process.
    pub telemetry_lost: u64,
    /// Histogram of gaps in the daemon's measurements: number of consecutive missed measurements to number of gaps.
    pub missed: BTreeMap<u64, u64>,
    /// Cycles without a new measurement, because the plant was late; real-time clocks only.
    pub without_measurement: u64,
    /// Late cycles (the next one was due before their end), by their longest phase: wake, read, compute or write.
    pub late: BTreeMap<&'static str, u64>,
    #[serde(skip)]
    last: Option<Telemetry>,
}

impl CycleCounts {
    /// Counts records, given in their order; `clock` is the clock of the plant.
    pub fn count(&mut self, records: &[Telemetry], clock: Clock) {
        for record in records {
            self.cycles += 1;
            let last = self.last.replace(*record);
            let stale = record.flags & Telemetry::STALE != 0;
            // Before the first measurement of a plant every cycle is stale.
            self.without_measurement +=
                u64::from(stale && clock.is_real_time() && record.measurement_seq > 0);
            if record.flags & Telemetry::OVERRUN != 0 {
                *self.late.entry(longest_phase(record)).or_default() += 1;
            }
            let Some(last) = last.filter(|last| record.seq > last.seq) else { continue };
            self.telemetry_lost += record.seq - last.seq - 1;
            // Only between consecutive records: a lost record is no missed measurement.
            if record.seq == last.seq + 1 && last.measurement_seq > 0 {
                let missed = record.measurement_seq.saturating_sub(last.measurement_seq + 1);
                if missed > 0 {
                    *self.missed.entry(missed).or_default() += 1;
                }
            }
        }
    }

    /// Number of gaps in the measurements, and total number of missed measurements.
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
        // Two lost records, then a restarted daemon, then a restarted plant.
        cycles.count(&[record(6, 17, 0), record(1, 30, 0), record(2, 33, 0), record(3, 1, 0)], Clock::Wall);
        assert_eq!((cycles.cycles, cycles.telemetry_lost, cycles.without_measurement), (7, 2, 1));
        assert_eq!(cycles.missed.into_iter().collect::<Vec<_>>(), [(2, 1), (3, 1)]);
        assert_eq!(cycles.late.into_iter().collect::<Vec<_>>(), [("wake", 1)]);
    }
}
