//! The daemon process: granted real-time settings are in force, refused ones are named in status and telemetry, and a late
//! cycle is counted and its cause determined.

mod common;

use common::live::{LONG, ask, ask_until, running_plant};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};
use upswing_ipc::{
    Client, Clock, ControlKind, ControlRequest, Degradation, Domain, Mode, Node, Subscriber, Telemetry,
    TelemetryBatch, TempDomain,
};

/// The daemon as a process of its own.
struct System {
    daemon: Child,
    plant: Option<JoinHandle<()>>,
    stop: Arc<AtomicBool>,
    client: Client<ControlRequest>,
    telemetry: Subscriber<TelemetryBatch>,
    _node: Node,
    // Declared last: nobody may use it any more.
    _domain: TempDomain,
}

/// A full set of settings in which each `from` of daemon.toml is a `to`.
fn settings(edits: &[(&str, &str)]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    upswing_planner::export(
        &upswing_config::Config::embedded().expect("embedded settings"),
        dir.path(),
        Default::default(),
    )
    .unwrap();
    let file = dir.path().join("daemon.toml");
    let mut text = std::fs::read_to_string(&file).unwrap();
    for (from, to) in edits {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        text = text.replace(from, to);
    }
    std::fs::write(file, text).unwrap();
    dir
}

fn daemon(settings: &Path, domain: &Domain) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_upswingd"));
    command.arg("--system").arg(settings).args(["--domain", domain.name()]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

impl System {
    fn start(edits: &[(&str, &str)]) -> Self {
        Self::start_on(Clock::Wall, edits)
    }

    fn start_on(clock: Clock, edits: &[(&str, &str)]) -> Self {
        let domain = TempDomain::new("daemon").unwrap();
        let node = domain.join("operator").unwrap();
        let (client, telemetry) =
            (node.client::<ControlRequest>().unwrap(), node.subscriber::<TelemetryBatch>().unwrap());
        let folder = settings(edits);
        let daemon = daemon(folder.path(), &domain).spawn().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let plant = Some(running_plant(&domain, clock, &stop));
        // Settings are read before it answers.
        ask_until(&client, ControlKind::Status, |answer| answer.seq > 100);
        Self { daemon, plant, stop, client, telemetry, _node: node, _domain: domain }
    }

    fn signal(&self, signal: i32) {
        let pid = libc::pid_t::try_from(self.daemon.id()).unwrap();
        // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
        assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
    }

    /// Records from now on until one pleases.
    fn find(&self, pleases: impl Fn(&Telemetry) -> bool) -> Telemetry {
        let begin = Instant::now();
        loop {
            match self.telemetry.receive().unwrap() {
                Some(batch) => {
                    if let Some(found) = batch.used().iter().find(|record| pleases(record)) {
                        return *found;
                    }
                }
                None => sleep(Duration::from_millis(1)),
            }
            assert!(begin.elapsed() < LONG, "no such record");
        }
    }

    /// A line of a file about the real-time thread.
    fn thread(&self, file: &str) -> String {
        self.thread_called("realtime", file)
    }

    /// A line of a file about the thread of this name.
    fn thread_called(&self, name: &str, file: &str) -> String {
        let tasks = format!("/proc/{}/task", self.daemon.id());
        for task in std::fs::read_dir(tasks).unwrap() {
            let path = task.unwrap().path();
            if std::fs::read_to_string(path.join("comm")).is_ok_and(|found| found.trim() == name) {
                return std::fs::read_to_string(path.join(file)).unwrap();
            }
        }
        panic!("no thread {name}");
    }

    /// Waits until a thread has this policy and priority, proc_pid_stat(5).
    fn wait_for_policy(&self, name: &str, policy: i32, priority: u64) {
        let begin = Instant::now();
        loop {
            let line = self.thread_called(name, "stat");
            // SCHED_RESET_ON_FORK is no part of it.
            let found = (stat(&line, 41), stat(&line, 40));
            if found == (policy as u64, priority) {
                return;
            }
            assert!(begin.elapsed() < LONG, "{name} has policy and priority {found:?}");
            sleep(Duration::from_millis(1));
        }
    }
}

impl Drop for System {
    fn drop(&mut self) {
        self.signal(libc::SIGCONT);
        self.signal(libc::SIGTERM);
        let status = self.daemon.wait().unwrap();
        self.stop.store(true, Ordering::Release);
        let plant = self.plant.take().map(JoinHandle::join);
        if !std::thread::panicking() {
            assert!(status.success() && plant.is_some_and(|plant| plant.is_ok()));
        }
    }
}

/// The number after `name:` in a file of lines.
fn number(text: &str, name: &str) -> u64 {
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':')).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// Field `n` of /proc/.../stat, counted from 1.
fn stat(text: &str, n: usize) -> u64 {
    let after_name = text.rsplit_once(')').unwrap().1;
    after_name.split_whitespace().nth(n - 3).unwrap().parse().unwrap()
}

#[test]
fn what_is_not_refused_holds() {
    let system = System::start(&[]);
    let degraded = ask(&system.client, ControlKind::Status).degraded;
    let granted = |what: Degradation| degraded & what.bit() == 0;
    if granted(Degradation::Scheduler) {
        system.wait_for_policy("realtime", libc::SCHED_FIFO, 80);
        // Who serves an operator's stop comes next, who looks for plants has no hurry.
        system.wait_for_policy("upswingd", libc::SCHED_FIFO, 79);
        system.wait_for_policy("finder", libc::SCHED_OTHER, 0);
    }
    if granted(Degradation::Memory) {
        let status = std::fs::read_to_string(format!("/proc/{}/status", system.daemon.id())).unwrap();
        assert!(number(&status, "VmLck") > 0, "{status}");
        let faults = || (stat(&system.thread("stat"), 10), stat(&system.thread("stat"), 12));
        let before = faults();
        let seq = ask(&system.client, ControlKind::Status).seq;
        system.find(|record| record.seq > seq + 4000);
        assert_eq!(faults(), before, "page faults of the real-time thread in 4000 cycles");
    }
    assert_eq!(system.find(|_| true).degraded, degraded);
}

#[test]
fn real_time_priority_belongs_to_the_wall_clock() {
    let system = System::start_on(Clock::Paced, &[]);
    ask_until(&system.client, ControlKind::Enable, |answer| answer.accepted == 1);
    let seq = ask(&system.client, ControlKind::Status).seq;
    system.find(|record| record.seq > seq + 1000);
    for thread in ["realtime", "upswingd", "finder"] {
        let line = system.thread_called(thread, "stat");
        assert_eq!((stat(&line, 41), stat(&line, 40)), (libc::SCHED_OTHER as u64, 0), "{thread}");
    }
}

#[test]
fn a_refusal_is_named_or_ends_a_strict_start() {
    // No machine has this CPU.
    let cpu = ("cpu = -1", "cpu = 1023");
    let system = System::start(&[cpu]);
    let answer = ask(&system.client, ControlKind::Status);
    assert_ne!(answer.degraded & Degradation::Cpu.bit(), 0);
    assert_eq!(system.find(|_| true).degraded, answer.degraded);

    let domain = TempDomain::new("daemon").unwrap();
    let folder = settings(&[cpu, ("mode = \"warn\"", "mode = \"strict\"")]);
    let output = daemon(folder.path(), &domain).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("realtime.mode is strict") && text.contains("CPU 1023"), "{text}");
}

#[test]
fn a_late_cycle_is_counted_and_attributed() {
    let system = System::start(&[]);
    let before = ask(&system.client, ControlKind::Status).overruns;
    // For 20 ms the thread cannot run, whatever its priority.
    system.signal(libc::SIGSTOP);
    sleep(Duration::from_millis(20));
    system.signal(libc::SIGCONT);
    let late = system.find(|record| {
        record.flags & Telemetry::OVERRUN != 0
            && record.wake_ns + record.read_ns + record.compute_ns + record.write_ns > 15_000_000
    });
    // It is counted with the statistics of its batch; another one, shorter, may come first.
    let answer = ask_until(&system.client, ControlKind::Status, |answer| {
        answer.overruns > before && answer.wake.max.max(answer.compute.max) > 15_000_000
    });
    assert!(answer.compute.count > 0 && answer.wake.count > 0);
    let told = answer.overrun.as_str().unwrap();
    assert!(told.contains("late in") && told.contains("page faults"), "{told}");
    // Deadlines move by whole periods: the next cycle is planned on the old grid.
    let next = system.find(|record| record.seq > late.seq);
    assert_eq!((next.t_ns - late.t_ns) % common::PERIOD_NS, 0);
}

#[test]
fn a_daemon_that_missed_the_plants_measurements_faults() {
    // The plant of this test may itself be late.
    let system = System::start(&[(
        "age_cycles = { warn = 4, trip = 20 }",
        "age_cycles = { warn = 4, trip = 1000000 }",
    )]);
    ask_until(&system.client, ControlKind::Enable, |answer| answer.accepted == 1);
    system.signal(libc::SIGSTOP);
    sleep(Duration::from_millis(50));
    system.signal(libc::SIGCONT);
    let answer = ask_until(&system.client, ControlKind::Status, |answer| answer.mode() == Ok(Mode::Fault));
    assert!(answer.reason.as_str().unwrap().contains("measurements were missed"), "{}", answer.reason);
}
