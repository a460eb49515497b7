//! Child processes for tests.
#![allow(dead_code)] // each test file uses its own part

use std::os::unix::process::parent_id;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use upswing_ipc::Domain;

const CHILD: &str = "UPSWING_IPC_TEST_CHILD";

/// This test binary once more, running only the test `entry` as a child process; killed when dropped.
pub struct Victim(Child);

impl Victim {
    pub fn start(entry: &str, domain: &Domain) -> Self {
        let child = Command::new(std::env::current_exe().unwrap())
            .args([entry, "--exact", "--nocapture", "--test-threads=1"])
            .env(CHILD, domain.name())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self(child)
    }

    /// SIGKILL, then wait until the process is gone.
    pub fn kill(mut self) {
        self.end();
    }

    /// Whether the process still runs.
    pub fn is_alive(&mut self) -> bool {
        self.0.try_wait().unwrap().is_none()
    }

    /// Whether it is stopped: the state in proc_pid_stat(5).
    pub fn is_stopped(&self) -> bool {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id())).unwrap();
        stat.rsplit_once(')').unwrap().1.trim_start().starts_with('T')
    }

    fn end(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        self.end();
    }
}

/// In a child process: its domain. None in a normal run, where child entries have nothing to do.
pub fn domain_of_child() -> Option<Domain> {
    std::env::var(CHILD).ok().map(|name| Domain::new(&name).unwrap())
}

/// Repeats `step` every millisecond until the process is killed or its parent is gone.
pub fn until_killed(mut step: impl FnMut()) {
    let parent = parent_id();
    while parent_id() == parent {
        step();
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Repeats `attempt` until it yields something; gives up when the test is clearly stuck.
pub fn wait_for<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "stuck while waiting for {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}
