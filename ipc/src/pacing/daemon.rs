//! The daemon's side of a clock: when the real-time thread computes a cycle.

use super::{LONG_NAP_NS, Patience};
use crate::payload::{Clock, Measurement};
use crate::services::Reader;
use crate::time::{monotonic_ns, sleep_until};
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_model::Period;

/// Longest wait for a measurement, ns; then the real-time thread has time for what else there is to do.
const LONGEST_WAIT_NS: u64 = 10_000_000;
/// On `paced` the thread sleeps until this share of a period before the next measurement is due.
const EARLY_SHARE: u64 = 16;

/// Why the real-time thread of the daemon is woken.
#[derive(Clone, Copy, Debug)]
pub enum DaemonWake {
    /// A cycle begins: its measurement is [`DaemonPacing::measurement`].
    Cycle(CycleStart),
    /// No measurement has come for so long that the plant counts as lost; comes once for each loss.
    PlantLost {
        /// Periods since the last measurement.
        cycles: u64,
    },
    /// No measurement has come for 10 ms.
    Idle,
}

/// The beginning of a control cycle, CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug)]
pub struct CycleStart {
    /// When the cycle was to begin; `None` where it begins with its measurement.
    pub planned_ns: Option<u64>,
    /// When the thread woke up.
    pub woken_ns: u64,
    /// When it had read the measurement.
    pub read_ns: u64,
}

/// How long the phases of a control cycle took, ns; 0 where the clock does not measure them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CycleTimes {
    /// From the planned begin of the cycle to the actual one.
    pub wake_ns: u64,
    /// Reading the measurement.
    pub read_ns: u64,
    /// Computing the command.
    pub compute_ns: u64,
    /// Writing the command.
    pub write_ns: u64,
    /// Whether the cycle ended after the next one should have begun.
    pub overrun: bool,
}

/// The clock as the real-time thread of the daemon follows it: that of the plant, once it has shown one.
pub struct DaemonPacing {
    period: Period,
    plant: Option<Reader<Measurement>>,
    /// The newest measurement; `seq` 0 before the first one of a plant.
    measurement: Measurement,
    /// On `wall` the planned begin of the next cycle, CLOCK_MONOTONIC, ns; `None`: now.
    planned_ns: Option<u64>,
    patience: Patience,
    lost: bool,
    /// Cycles in a row that ended late on `wall`.
    late: u64,
}

impl DaemonPacing {
    /// A clock without a plant.
    pub fn new(period: Period) -> Self {
        Self {
            period,
            plant: None,
            measurement: Measurement::default(),
            planned_ns: None,
            patience: Patience::default(),
            lost: false,
            late: 0,
        }
    }

    /// Follows another plant, or the same after a restart. Returns whether there was one before.
    pub fn adopt(&mut self, plant: Reader<Measurement>) -> bool {
        // Whatever its number, the first measurement counts as new.
        self.measurement = Measurement { seq: 0, ..plant.read() };
        self.patience = Patience::default();
        self.plant.replace(plant).is_some()
    }

    /// The newest measurement; all zero without a plant, `seq` 0 before the first one of a plant.
    pub fn measurement(&self) -> &Measurement {
        &self.measurement
    }

    /// `seq` of the newest measurement that the plant shows at this moment; 0 without a plant.
    pub fn newest_seq(&self) -> u64 {
        self.plant.as_ref().map_or(0, |plant| plant.read().seq)
    }

    /// Whether time is real: only then the thread needs real-time priority.
    pub fn is_real_time(&self) -> bool {
        self.clock().is_some_and(Clock::is_real_time)
    }

    /// Whether operators' requests wait for the next measurement, which may be long in coming: where time stands still, and
    /// before the first measurement of a plant, whose clock may be of that kind.
    pub fn stands_still(&self) -> bool {
        let unknown = self.plant.is_some() && self.measurement.seq == 0;
        unknown || self.clock().is_some_and(Clock::stands_still)
    }

    /// Cycles in a row that ended late. Where the plant waits for the daemon, a slow machine does no harm: 0.
    pub fn late_cycles(&self) -> u64 {
        self.late
    }

    /// Waits until there is something to do; `None` once `exit` is raised. `plant_lives`: the process of the plant has not
    /// ended.
    pub fn wait(&mut self, exit: &AtomicBool, plant_lives: &AtomicBool) -> Option<DaemonWake> {
        if exit.load(Ordering::Acquire) {
            return None;
        }
        if self.is_real_time() {
            return Some(DaemonWake::Cycle(self.wait_for_deadline()));
        }
        self.planned_ns = None;
        if let Some(start) = self.wait_for_measurement(exit) {
            (self.patience, self.lost) = (Patience::default(), false);
            return Some(DaemonWake::Cycle(start));
        }
        let awaited = self.measurement.seq > 0 && !self.lost && !self.stands_still();
        if awaited && self.patience.is_over(plant_lives.load(Ordering::Relaxed)) {
            self.lost = true;
            return Some(DaemonWake::PlantLost { cycles: self.patience.waited_ns / self.period.nanos() });
        }
        Some(DaemonWake::Idle)
    }

    /// Ends a cycle: how long its phases took. `computed_ns` and `written_ns`: when the command was computed and written,
    /// CLOCK_MONOTONIC.
    pub fn end(&mut self, start: CycleStart, computed_ns: u64, written_ns: u64) -> CycleTimes {
        let Some(planned_ns) = start.planned_ns else {
            self.late = 0;
            let clock = self.clock();
            if clock.is_some_and(Clock::stands_still) {
                return CycleTimes::default();
            }
            return CycleTimes {
                compute_ns: computed_ns - start.read_ns,
                write_ns: written_ns - computed_ns,
                // The first measurement on `wall` comes here too, but no cycle had been planned.
                overrun: clock.is_some_and(Clock::is_paced)
                    && written_ns - start.woken_ns > self.period.nanos(),
                ..CycleTimes::default()
            };
        };
        // A whole number of periods later: a late cycle does not shift all others.
        let missed = written_ns.saturating_sub(planned_ns) / self.period.nanos();
        self.planned_ns = Some(planned_ns + self.period.nanos_of(missed + 1));
        let overrun = missed > 0;
        self.late = if overrun { self.late + 1 } else { 0 };
        CycleTimes {
            wake_ns: start.woken_ns.saturating_sub(planned_ns),
            read_ns: start.read_ns - start.woken_ns,
            compute_ns: computed_ns - start.read_ns,
            write_ns: written_ns - computed_ns,
            overrun,
        }
    }

    fn clock(&self) -> Option<Clock> {
        self.measurement.shown_clock()
    }

    fn wait_for_deadline(&mut self) -> CycleStart {
        let planned_ns = self.planned_ns.unwrap_or_else(monotonic_ns);
        sleep_until(planned_ns);
        let woken_ns = monotonic_ns();
        if let Some(plant) = &self.plant {
            self.measurement = plant.read();
        }
        self.patience = Patience::default();
        CycleStart { planned_ns: Some(planned_ns), woken_ns, read_ns: monotonic_ns() }
    }

    /// Waits until the plant shows a measurement with another number; `None` if it does not for [`LONGEST_WAIT_NS`].
    fn wait_for_measurement(&mut self, exit: &AtomicBool) -> Option<CycleStart> {
        let begin = monotonic_ns();
        let clock = self.clock();
        let Some(plant) = &self.plant else {
            sleep_until(begin + LONG_NAP_NS);
            return None;
        };
        self.patience.resume(begin);
        // The plant keeps its period: until the next measurement is due there is nothing to look for.
        if clock.is_some_and(Clock::is_paced) && self.patience.waited_ns == 0 {
            sleep_until(begin + self.period.nanos() - self.period.nanos() / EARLY_SHARE);
        }
        loop {
            let newest = plant.read();
            let fresh = newest.seq != self.measurement.seq;
            // Also without a new number: what is there before the first measurement tells the clock.
            self.measurement = newest;
            let now = monotonic_ns();
            if fresh {
                return Some(CycleStart { planned_ns: None, woken_ns: now, read_ns: now });
            }
            self.patience.look(now);
            if now - begin > LONGEST_WAIT_NS || exit.load(Ordering::Relaxed) {
                return None;
            }
            match self.patience.nap_ns(clock, self.period) {
                0 => std::hint::spin_loop(),
                nap => sleep_until(now + nap),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CycleStart, DaemonPacing};
    use crate::payload::{Clock, Measurement};
    use upswing_model::Period;

    #[test]
    fn only_a_cycle_that_was_paced_or_planned_can_be_late() {
        let period = Period::from_micros(125);
        let late = |clock: Option<Clock>, planned_ns: Option<u64>| {
            let mut pacing = DaemonPacing::new(period);
            if let Some(clock) = clock {
                pacing.measurement = Measurement {
                    seq: 1,
                    period_ns: period.nanos(),
                    clock: clock.code(),
                    ..Measurement::default()
                };
            }
            let start = CycleStart { planned_ns, woken_ns: 1000, read_ns: 1000 };
            pacing.end(start, 2000, 1001 + period.nanos()).overrun
        };
        assert!(late(Some(Clock::Paced), None) && late(Some(Clock::Wall), Some(1000)));
        // The measurement that first shows that the clock is `wall`, one of an unknown clock, and time that stands still.
        for clock in [Some(Clock::Wall), None, Some(Clock::Lockstep)] {
            assert!(!late(clock, None), "{clock:?}");
        }
    }
}
