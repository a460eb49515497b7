//! The rules of the three clocks, for daemon and plant.

use crate::codes::Clock;

impl Clock {
    /// Whether cycles begin at planned times of CLOCK_MONOTONIC, in daemon and plant alike, however late the other process
    /// is: only then a thread that is late does harm, and needs real-time priority.
    pub const fn is_real_time(self) -> bool {
        matches!(self, Self::Wall)
    }

    /// Whether the plant pauses until it is told to advance: a request may then wait for any time until the next cycle.
    pub const fn stands_still(self) -> bool {
        matches!(self, Self::Lockstep)
    }

    /// Whether telemetry says how long a cycle took. Where time stands still it does not: equal runs give equal telemetry.
    pub const fn is_timed(self) -> bool {
        !self.stands_still()
    }
}
