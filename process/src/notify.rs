//! What a process tells the service manager that started it (sd_notify(3)); without one it tells nobody.

use sd_notify::NotifyState;
use std::time::{Duration, Instant};
use tracing::warn;

/// How often a process that is not ready yet says that it lives; each time the manager may wait for it this much longer.
const SIGN_OF_LIFE: Duration = Duration::from_secs(1);
const PATIENCE_US: u32 = 10_000_000;
/// Signs of life within the time after which the manager takes a process for dead.
const SIGNS: u32 = 4;

/// Tells the service manager how a process is. Each call that tells something is a system call: not for the real-time
/// thread.
#[derive(Debug)]
pub struct Notifier {
    managed: bool,
    watchdog: Option<Duration>,
    ready: bool,
    stopping: bool,
    told: Instant,
    status: String,
    failed: bool,
}

impl Notifier {
    /// For the manager that the environment names (`NOTIFY_SOCKET`, `WATCHDOG_USEC`), if any.
    pub fn new() -> Self {
        Self {
            managed: std::env::var_os("NOTIFY_SOCKET").is_some(),
            watchdog: sd_notify::watchdog_enabled(),
            ready: false,
            stopping: false,
            told: Instant::now(),
            status: String::new(),
            failed: false,
        }
    }

    /// The process does its work from now on. Only the first call counts.
    pub fn ready(&mut self) {
        if !std::mem::replace(&mut self.ready, true) {
            self.tell(&[NotifyState::Ready]);
        }
    }

    /// One line for people; repeated ones are dropped.
    pub fn status(&mut self, text: &str) {
        if self.managed && self.status != text {
            text.clone_into(&mut self.status);
            // A second line would be another message.
            self.tell(&[NotifyState::Status(&text.replace('\n', " "))]);
        }
    }

    /// The process makes progress: call it often, it tells as much as the manager needs.
    pub fn alive(&mut self) {
        if !self.managed {
            return;
        }
        let (pause, state) = match (self.ready, self.watchdog) {
            (false, _) => (SIGN_OF_LIFE, NotifyState::ExtendTimeoutUsec(PATIENCE_US)),
            (true, Some(watchdog)) => (watchdog / SIGNS, NotifyState::Watchdog),
            (true, None) => return,
        };
        if self.told.elapsed() >= pause {
            self.told = Instant::now();
            self.tell(&[state]);
        }
    }

    /// The process is about to end. Only the first call counts.
    pub fn stopping(&mut self) {
        if !std::mem::replace(&mut self.stopping, true) {
            self.tell(&[NotifyState::Stopping]);
        }
    }

    fn tell(&mut self, states: &[NotifyState<'_>]) {
        if let Err(e) = sd_notify::notify(states)
            && !std::mem::replace(&mut self.failed, true)
        {
            warn!("cannot notify the service manager: {e}; check NOTIFY_SOCKET");
        }
    }
}

impl Default for Notifier {
    fn default() -> Self {
        Self::new()
    }
}
