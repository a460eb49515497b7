//! Domains and child processes for tests.
#![allow(dead_code)] // each test file uses its own part

use std::ops::Deref;
use std::os::unix::process::parent_id;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use upswing_ipc::Domain;

/// A domain that no other test uses; removed when dropped.
pub struct TestDomain(Domain);

impl TestDomain {
    /// A domain whose name begins with `tag` (at most 12 characters).
    pub fn new(tag: &str) -> Self {
        static COUNTER: AtomicU32 = AtomicU32::new(0);
        let name = format!("{tag}-{}-{}", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed));
        let domain = Domain::new(&name).unwrap();
        // A killed run with the same process id may have left files.
        assert!(domain.remove_if_unused().unwrap());
        Self(domain)
    }
}

impl Deref for TestDomain {
    type Target = Domain;

    fn deref(&self) -> &Domain {
        &self.0
    }
}

impl Drop for TestDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_if_unused();
    }
}

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
