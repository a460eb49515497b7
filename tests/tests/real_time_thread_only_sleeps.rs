//! In 10^5 cycles the real-time thread makes no system call except clock_nanosleep, while planners, plants and clients
//! start, exit and are killed. The test uses strace; if strace is not installed or not allowed, it reports this.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use upswing_ipc::{ControlKind, ControlRequest, TempDomain};
use upswing_tests::running::{LONG, Running, wait_for};

const CYCLES: u64 = 100_000;
/// Under strace a cycle takes several periods.
const PATIENCE: Duration = Duration::from_secs(300);

/// strace on one thread; `None` if there is none here.
fn trace(thread: i32, output: &Path) -> Option<Child> {
    let mut strace = Command::new("strace")
        .args(["-p", &thread.to_string(), "-o"])
        .arg(output)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .inspect_err(|e| println!("skipped: strace: {e}"))
        .ok()?;
    // It writes as soon as it is attached.
    wait_for("strace", || {
        let begun = std::fs::metadata(output).is_ok_and(|file| file.len() > 0);
        let ended = strace.try_wait().expect("a child").is_some();
        (begun || ended).then_some(ended)
    })
    .then(|| println!("skipped: strace is not allowed to attach"))
    .map_or(Some(strace), |()| None)
}

/// How often each call occurs in what strace wrote.
fn calls(text: &str) -> BTreeMap<&str, u64> {
    let mut calls = BTreeMap::new();
    for line in text.lines() {
        let name = line.split_once('(').map_or(line, |(name, _)| name);
        *calls.entry(name).or_default() += 1;
    }
    calls
}

#[test]
fn while_peers_come_and_go() {
    let domain = TempDomain::new("test").expect("a name");
    let name = domain.name();
    let wall = |command: &mut Command| {
        command.args(["--clock", "wall"]);
    };
    let mut plant = Running::start("upswing-plant", name, wall);
    let daemon = Running::start("upswingd", name, |_| {});
    let node = domain.join("operator").expect("a node");
    let client = node.client::<ControlRequest>().expect("a client");
    let seq = || {
        wait_for("the daemon", || client.has_server().then_some(()));
        client.call(&ControlRequest::new(ControlKind::Status), LONG).expect("an answer").seq
    };
    wait_for("the first cycles", || (seq() > 100).then_some(()));

    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("calls");
    let Some(mut strace) = trace(daemon.thread("realtime"), &file) else { return };
    let (first, begin) = (seq(), Instant::now());
    let (mut planner, mut round) = (None, 0_u64);
    while seq() < first + CYCLES {
        assert!(begin.elapsed() < PATIENCE, "{} cycles in {PATIENCE:?}", seq() - first);
        // One of them ends, in turn killed and in order, and another one begins.
        round += 1;
        match round % 4 {
            0 => planner = Some(Running::start("upswing-planner", name, |_| {})),
            1 => plant = Running::start("upswing-plant", name, wall),
            2 => {
                let mut client = Running::start("upswing", name, |command| {
                    command.arg("status");
                });
                assert!(client.wait().success());
            }
            _ => {
                if let (1, Some(planner)) = (round / 4 % 2, &mut planner) {
                    planner.signal(libc::SIGTERM);
                    assert!(planner.wait().success());
                }
                planner = None;
            }
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    drop((planner, plant));
    // SAFETY: plain system call; the child has not been waited for.
    unsafe { libc::kill(libc::pid_t::try_from(strace.id()).expect("an id"), libc::SIGINT) };
    strace.wait().expect("strace ends");

    let text = std::fs::read_to_string(&file).expect("calls");
    let mut found = calls(&text);
    let sleeps = found.remove("clock_nanosleep").unwrap_or(0);
    assert!(sleeps >= CYCLES / 2, "{sleeps} sleeps; traced only a part?");
    // How strace shows that it was attached in the middle of a sleep, and the end of the trace.
    found.retain(|name, _| !name.starts_with("strace: Process") && !name.starts_with("restart_syscall"));
    assert!(round > 10, "only {round} peers came and went");
    assert!(found.is_empty(), "system calls besides sleeping: {found:?}");
}

#[test]
fn other_calls_would_be_seen() {
    let text = "clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, {tv_sec=1}, NULL) = 0\nmmap(NULL, 4096) = 0x7f\n\
                clock_nanosleep(CLOCK_MONOTONIC) = 0\n";
    assert_eq!(calls(text), BTreeMap::from([("clock_nanosleep", 2), ("mmap", 1)]));
}
