//! A single program as a process, for tests of its signals, exit status, memory and threads.

use crate::programs;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for a condition; far longer than any condition needs.
pub const LONG: Duration = Duration::from_secs(60);

/// A process of one program under test; killed when dropped.
pub struct Running(Child);

impl Running {
    /// Starts a program of upswing in a shared-memory domain; `set` adds arguments and streams to the command.
    ///
    /// # Panics
    /// If the program cannot be started.
    pub fn start(program: &str, domain: &str, set: impl FnOnce(&mut Command)) -> Self {
        let mut command = Command::new(programs().join(program));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        set(&mut command);
        command.args(["--domain", domain]);
        Self(command.spawn().unwrap_or_else(|e| panic!("{program}: {e}")))
    }

    /// Process id.
    pub fn id(&self) -> u32 {
        self.0.id()
    }

    /// Sends a signal to the process.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn signal(&self, signal: i32) {
        let pid = libc::pid_t::try_from(self.id()).expect("an id");
        // SAFETY: plain system call; the child has not been reaped, so that its process id is not reused.
        assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
    }

    /// Waits until the process exits.
    ///
    /// # Panics
    /// If the process does not exit within [`LONG`].
    pub fn wait(&mut self) -> ExitStatus {
        wait_for("the process to end", || self.0.try_wait().expect("a child"))
    }

    /// Contents of the file `file` in /proc/PID of the process.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn proc(&self, file: &str) -> String {
        let path = format!("/proc/{}/{file}", self.id());
        std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
    }

    /// Private resident memory of the process (RssAnon), KiB.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn memory(&self) -> u64 {
        let status = self.proc("status");
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("RssAnon");
        line.split_whitespace().next().and_then(|kb| kb.parse().ok()).expect("a number")
    }

    /// Id of the thread with the name `name`; waits until the thread has started.
    ///
    /// # Panics
    /// If no thread has this name within [`LONG`].
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

/// Calls `look` repeatedly until it returns a value.
///
/// # Panics
/// After [`LONG`]; the message names the awaited condition `what`.
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
