//! Waiting for another process, and wake-ups without slack.

use std::time::{Duration, Instant};

/// Waiting rounds without giving up the CPU: most answers come within these few ten microseconds.
const SPINS: u32 = 1_000;
/// Rounds after these that only let others run.
const YIELDS: u32 = 100;
/// Rounds after these with a short pause; then the longer one keeps an idle process from using the CPU.
const SHORT_PAUSES: u32 = 1_000;
const SHORT_PAUSE: Duration = Duration::from_micros(30);
const LONG_PAUSE: Duration = Duration::from_micros(300);
/// Longest time that one round counts for: an interruption of this process is not the other one's silence.
const LONGEST_ROUND: Duration = Duration::from_millis(10);

/// Waiting for another process, at first eagerly where speed counts, then gently.
pub(crate) struct Patience {
    rounds: u32,
    waited: Duration,
    last: Instant,
}

impl Patience {
    pub(crate) fn new() -> Self {
        Self { rounds: 0, waited: Duration::ZERO, last: Instant::now() }
    }

    /// Waits with short pauses from the beginning.
    pub(crate) fn gentle() -> Self {
        Self { rounds: SPINS + YIELDS, ..Self::new() }
    }

    /// One round. True if it was no mere spin: then, and at least once per ms, there is time for other work.
    pub(crate) fn pause(&mut self) -> bool {
        self.rounds = self.rounds.saturating_add(1);
        if self.rounds <= SPINS {
            std::hint::spin_loop();
            return false;
        }
        match self.rounds - SPINS {
            ..=YIELDS => std::thread::yield_now(),
            n if n <= YIELDS + SHORT_PAUSES => std::thread::sleep(SHORT_PAUSE),
            _ => std::thread::sleep(LONG_PAUSE),
        }
        let now = Instant::now();
        self.waited += (now - self.last).min(LONGEST_ROUND);
        self.last = now;
        true
    }

    /// How long this process has been waiting (not counting when it could not run).
    pub(crate) fn waited(&self) -> Duration {
        self.waited
    }
}

/// Asks for wake-ups of this thread without the usual slack of 50 us, which is half a control period.
pub(crate) fn wake_precisely() {
    const SLACK_NS: libc::c_ulong = 1;
    // SAFETY: this option takes one number and concerns the calling thread only. If refused, wake-ups are later.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, SLACK_NS) };
}
