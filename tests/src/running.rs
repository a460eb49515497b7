//! One program as a process of its own, for tests of what the system sees of it.

use crate::programs;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Far beyond anything that is waited for.
pub const LONG: Duration = Duration::from_secs(60);

/// A process that is killed when dropped.
pub struct Running(Child);

impl Running {
    /// Starts a program of upswing in a domain, with more settings by `set`.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(program: &str, domain: &str, set: impl FnOnce(&mut Command)) -> Self {
        let mut command = Command::new(programs().join(program));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        set(&mut command);
        command.args(["--domain", domain]);
        Self(command.spawn().unwrap_or_else(|e| panic!("{program}: {e}")))
    }

    /// Its id.
    pub fn id(&self) -> u32 {
        self.0.id()
    }

    /// Sends a signal.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn signal(&self, signal: i32) {
        let pid = libc::pid_t::try_from(self.id()).expect("an id");
        // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
        assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If it does not end.
    pub fn wait(&mut self) -> ExitStatus {
        wait_for("the process to end", || self.0.try_wait().expect("a child"))
    }

    /// A file of /proc about it.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn proc(&self, file: &str) -> String {
        let path = format!("/proc/{}/{file}", self.id());
        std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
    }

    /// Its own memory, KiB.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn memory(&self) -> u64 {
        let status = self.proc("status");
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("RssAnon");
        line.split_whitespace().next().and_then(|kb| kb.parse().ok()).expect("a number")
    }

    /// Number of the thread with this name.
    ///
    /// # Panics
    /// If there is none.
    pub fn thread(&self, name: &str) -> i32 {
        wait_for("the thread to start", || {
            let tasks = std::fs::read_dir(format!("/proc/{}/task", self.id())).ok()?;
            let mut ids = tasks.flatten().filter_map(|task| task.file_name().to_str()?.parse::<i32>().ok());
            ids.find(|id| self.proc(&format!("task/{id}/comm")).trim() == name)
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Ok(None) = self.0.try_wait() {
            let _ = self.0.kill();
        }
        let _ = self.0.wait();
    }
}

/// Repeats `look` until it finds something.
///
/// # Panics
/// After a [`LONG`] time, with `what` was awaited.
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let begin = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(begin.elapsed() < LONG, "waited for {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}
