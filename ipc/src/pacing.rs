//! The rules of the three clocks: when a cycle of the plant begins and ends, and when the daemon computes one.
//!
//! | | `wall` | `paced` | `lockstep` |
//! |---|---|---|---|
//! | the plant begins a cycle | at its deadline | at once | once `AdvanceTo` has granted it |
//! | and ends it | at once, with the newest command | at its deadline, once the command came that answers the measurement | once that command came |
//! | who has to catch up | the plant; behind by more than the watchdog's time it moves its deadlines | nobody: a late answer moves all later deadlines | nobody |
//! | a daemon counts as lost | after `drive.watchdog_cycles` without a command | 1 s after its end, or after 20 s without an answer | as on `paced` |
//! | the plant waits for a first daemon | no | no | yes |
//! | the daemon begins a cycle | at its deadline | with each measurement | with each measurement |
//! | a late cycle of the daemon | skips whole periods | is counted | is not noticed |
//! | a plant counts as lost | by the age of its measurement, which the controller watches | 1 s after its end, or after 20 s without a measurement | never: time may stand still |
//! | operators' requests take effect | in the next cycle | in the next cycle; without measurements at once | in the next cycle |
//! | telemetry has | all phase times | times of computing and writing | no times |
//!
//! The plant leads ([`PlantPacing`]), the daemon follows ([`DaemonPacing`]). The loop of both processes is
//! `while let Some(wake) = pacing.wait(..) { work }`. Waiting enters the kernel for sleep by CLOCK_MONOTONIC alone, and allocates
//! nothing.

mod daemon;
mod plant;

pub use daemon::{CycleStart, CycleTimes, DaemonPacing, DaemonWake};
pub use plant::{Commands, CycleBegin, GrantError, PlantPacing, PlantWake, Presence};

use crate::payload::{Clock, Measurement};
use std::time::Duration;
use upswing_model::Period;

impl Clock {
    /// Whether cycles begin at planned times of CLOCK_MONOTONIC, in daemon and plant alike, however late the other process
    /// is (`wall`): only then a late thread does harm and needs real-time priority.
    pub const fn is_real_time(self) -> bool {
        matches!(self, Self::Wall)
    }

    /// Whether the plant pauses until it is told to advance (`lockstep`): the next cycle may be long in coming.
    pub const fn stands_still(self) -> bool {
        matches!(self, Self::Lockstep)
    }

    /// Whether the plant keeps its period although it waits for the daemon (`paced`).
    pub const fn is_paced(self) -> bool {
        matches!(self, Self::Paced)
    }

    /// Whether telemetry says how long a cycle took (`wall`, `paced`). On `lockstep` it does not: equal runs give equal
    /// telemetry.
    pub const fn is_timed(self) -> bool {
        !self.stands_still()
    }
}

impl Measurement {
    /// The clock of the plant; `None` before the plant has shown one that there is.
    pub fn shown_clock(&self) -> Option<Clock> {
        if self.period_ns == 0 { None } else { self.clock().ok() }
    }
}

/// How long a process waits for the next value of another one that has ended, and of one that lives: its machine may have no
/// time for it, or fetch its program from a disk that is busy.
const LOST_AFTER: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(20));
/// Longest time that the pause between two looks counts for, ns: an interruption of this process is no silence of the other
/// one.
const LONGEST_PAUSE_NS: u64 = 2 * LONG_NAP_NS;

/// Without a deadline, by the time already waited, ns: up to these a process spins, then naps ever longer.
const SPIN_NS: u64 = 10_000;
const SHORTEST_NAPS_NS: u64 = 60_000;
const SHORT_NAPS_NS: u64 = 5_000_000;
const SHORTEST_NAP_NS: u64 = 5_000;
const SHORT_NAP_NS: u64 = 25_000;
const LONG_NAP_NS: u64 = 500_000;
/// On `paced` a nap is this share of a period, or of the time already waited.
const NAP_SHARE: u64 = 8;

/// How long a process has been waiting for another one.
#[derive(Clone, Copy, Debug, Default)]
struct Patience {
    /// Time waited, without interruptions of this process, ns.
    waited_ns: u64,
    /// The last look, CLOCK_MONOTONIC, ns.
    last_ns: u64,
}

impl Patience {
    /// Waiting begins, at CLOCK_MONOTONIC `now_ns`.
    fn since(now_ns: u64) -> Self {
        Self { waited_ns: 0, last_ns: now_ns }
    }

    /// Waiting goes on after other work.
    fn resume(&mut self, now_ns: u64) {
        self.last_ns = now_ns;
    }

    /// The other process was looked at in vain.
    fn look(&mut self, now_ns: u64) {
        self.waited_ns += now_ns.saturating_sub(self.last_ns).min(LONGEST_PAUSE_NS);
        self.last_ns = now_ns;
    }

    /// Whether the other process counts as lost; `lives`: it has not ended.
    fn is_over(&self, lives: bool) -> bool {
        Duration::from_nanos(self.waited_ns) > if lives { LOST_AFTER.1 } else { LOST_AFTER.0 }
    }

    /// The pause until the next look, ns; 0: none, the other process is about to answer.
    fn nap_ns(&self, clock: Option<Clock>, period: Period) -> u64 {
        match (clock, self.waited_ns) {
            (Some(Clock::Paced), waited) => (waited.max(period.nanos()) / NAP_SHARE).min(LONG_NAP_NS),
            (_, ..SPIN_NS) => 0,
            (_, ..SHORTEST_NAPS_NS) => SHORTEST_NAP_NS,
            (_, ..SHORT_NAPS_NS) => SHORT_NAP_NS,
            _ => LONG_NAP_NS,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{LONG_NAP_NS, Patience};
    use crate::payload::Clock;
    use upswing_model::Period;

    /// Patience after so many looks, 1 ms apart.
    fn after(looks: u64) -> Patience {
        let mut patience = Patience::since(5);
        (1..=looks).for_each(|ms| patience.look(5 + ms * 1_000_000));
        patience
    }

    #[test]
    fn a_process_that_lives_is_waited_for_longer_than_one_that_has_ended() {
        for (lives, ms, over) in
            [(false, 1000, false), (false, 1001, true), (true, 20_000, false), (true, 20_001, true)]
        {
            assert_eq!(after(ms).is_over(lives), over, "{lives}, {ms} ms");
        }
    }

    #[test]
    fn an_interruption_of_the_waiting_process_is_no_silence_of_the_other_one() {
        let mut patience = Patience::since(0);
        (1..100).for_each(|minute| patience.look(minute * 60_000_000_000));
        assert!(!patience.is_over(false), "{patience:?}");
        patience.resume(u64::MAX);
        patience.look(u64::MAX);
        assert!(!patience.is_over(false), "{patience:?}");
    }

    #[test]
    fn naps_grow_and_stay_short_whatever_the_period() {
        for clock in [None, Some(Clock::Paced), Some(Clock::Lockstep)] {
            for period in [1, 125, 100_000].map(Period::from_micros) {
                let naps = [0, 1, 10, 1000, 30_000].map(|ms| after(ms).nap_ns(clock, period));
                assert!(naps.is_sorted() && naps[4] == LONG_NAP_NS, "{clock:?}, {period}: {naps:?}");
                // Who keeps a period does not spin.
                assert_eq!(naps[0] == 0, clock != Some(Clock::Paced), "{clock:?}, {period}");
            }
        }
    }
}
