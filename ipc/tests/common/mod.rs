//! Child processes for tests.
#![allow(dead_code)] // each test file uses its own part

use std::os::unix::process::parent_id;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use upswing_ipc::{Domain, PlanHeader, PlanMessage};
use upswing_model::{Model, Sizes};

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

/// A chain of revolute joints about x, one per entry of `actuated`.
pub fn chain(actuated: &[bool]) -> Model {
    let mut urdf = "<robot name=\"chain\"><link name=\"l0\"/>".to_owned();
    for (i, actuated) in actuated.iter().enumerate() {
        let (effort, next) = (if *actuated { 10 } else { 0 }, i + 1);
        urdf += &format!(
            "<joint name=\"j{next}\" type=\"revolute\"><parent link=\"l{i}\"/><child link=\"l{next}\"/>\
             <origin xyz=\"0 0 0.3\"/><axis xyz=\"1 0 0\"/>\
             <limit lower=\"-3\" upper=\"3\" velocity=\"10\" effort=\"{effort}\"/></joint>\
             <link name=\"l{next}\"><inertial><origin xyz=\"0 0 0.15\"/><mass value=\"1\"/>\
             <inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.01\" iyz=\"0\" izz=\"0.01\"/></inertial></link>"
        );
    }
    Model::from_urdf(&(urdf + "</robot>")).unwrap()
}

/// Chains with unactuated joints in all places.
pub fn chains() -> [Model; 7] {
    const A: bool = true;
    const U: bool = false;
    let paper = [A, A, A, A, A, A, A, U, U];
    let (mut longest, mut longest_free) = ([A; 16], [U; 16]);
    (longest[3], longest_free[8]) = (U, A);
    let all: [&[bool]; 7] = [&[A, U], &[U, A], &[A, U, A], &[U, A, U, A, U], &paper, &longest, &longest_free];
    all.map(chain)
}

/// Sizes of the plans of [`plan`].
pub const SIZES: (Sizes, usize) = (Sizes::new(3, 2).unwrap(), 25);

/// A sealed plan without a zero byte pattern that a truncation could reproduce.
pub fn plan(id: u64) -> PlanMessage {
    let number = |i: usize| id as f64 + i as f64 / 3.0;
    let header = PlanHeader {
        id,
        fingerprint: 0x0123_4567_89ab_cdef,
        activation_ns: 0,
        replaces: 0,
        t_f: number(1),
        joints: SIZES.0.joints() as u64,
        actuated: SIZES.0.actuated() as u64,
        intervals: SIZES.1 as u64,
        checksum: 0,
    };
    let values = (2..2 + PlanMessage::length(SIZES.0, SIZES.1)).map(number).collect();
    let mut plan = PlanMessage { header, values };
    plan.seal();
    plan
}
