//! Notifications of a process to its service manager (sd_notify(3)); without a service manager nothing is sent.

use sd_notify::NotifyState;
use std::time::{Duration, Instant};
use tracing::warn;

/// Interval of the notifications of a process that is not ready yet.
const SIGN_OF_LIFE: Duration = Duration::from_secs(1);
/// Extension of the start timeout by each of these notifications, us.
const PATIENCE_US: u32 = 10_000_000;
/// Number of watchdog notifications per watchdog timeout of the manager.
const SIGNS: u32 = 4;

/// Sender of notifications to the service manager. A notification is a system call: not for the real-time thread.
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
    /// Creates a notifier for the service manager in the environment (`NOTIFY_SOCKET`, `WATCHDOG_USEC`), if any.
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

    /// Notifies that the process is ready. Only the first call sends a notification.
    pub fn ready(&mut self) {
        if !std::mem::replace(&mut self.ready, true) {
            self.tell(&[NotifyState::Ready]);
        }
    }

    /// Sets the status line of the process; an unchanged line is not sent again.
    pub fn status(&mut self, text: &str) {
        if self.managed && self.status != text {
            text.clone_into(&mut self.status);
            // A second line would be another notification.
            self.tell(&[NotifyState::Status(&text.replace('\n', " "))]);
        }
    }

    /// Notifies that the process makes progress. To be called often: notifications are sent only as often as the manager needs.
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

    /// Notifies that the process is about to end. Only the first call sends a notification.
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
