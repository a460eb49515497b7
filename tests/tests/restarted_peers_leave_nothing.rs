//! Planner, plant and clients that are killed and restarted a hundred times leave no file and no memory, and do not affect
//! the daemon's real-time thread; a second daemon is refused with the process id of the first.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use upswing_ipc::{
    ControlKind, ControlRequest, ControlResponse, Domain, PlannerRequest, PlantRequest, TempDomain,
};
use upswing_tests::programs;
use upswing_tests::running::{LONG, Running, wait_for};

const ROUNDS: u64 = 100;

/// How many files of each kind (folder and suffix) the domain has, by a wider net than the one that removes them.
fn files(domain: &Domain) -> BTreeMap<String, usize> {
    let shared = std::fs::read_dir("/dev/shm").expect("/dev/shm").flatten();
    let own =
        shared.filter(|e| e.file_name().to_string_lossy().contains(&format!("upswing_{}_", domain.name())));
    let mut kinds = BTreeMap::new();
    own.for_each(|entry| count(&mut kinds, "", &entry.path()));
    count(&mut kinds, "", &domain.root());
    kinds
}

fn count(kinds: &mut BTreeMap<String, usize>, folder: &str, path: &Path) {
    let Ok(state) = path.symlink_metadata() else { return };
    let suffix = path.extension().unwrap_or_default().to_string_lossy();
    if !state.is_dir() {
        *kinds.entry(format!("{folder}*.{suffix}")).or_default() += 1;
        return;
    }
    // Names of nodes are numbers.
    let folder = format!("{folder}{}/", if suffix.is_empty() { "*".into() } else { suffix });
    *kinds.entry(folder.clone()).or_default() += 1;
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        count(kinds, &folder, &entry.path());
    }
}

/// Page faults, minor and major, of a thread: proc(5), stat, fields 10 and 12.
fn faults(daemon: &Running, thread: i32) -> (u64, u64) {
    let stat = daemon.proc(&format!("task/{thread}/stat"));
    let fields: Vec<_> = stat.rsplit_once(')').expect("a name").1.split_whitespace().collect();
    (fields[7].parse().expect("a number"), fields[9].parse().expect("a number"))
}

/// Regions of memory, by the endings of the names of their files.
fn mapped(daemon: &Running) -> BTreeMap<String, usize> {
    let mut kinds = BTreeMap::new();
    for line in daemon.proc("maps").lines() {
        let file = line.split_whitespace().nth(5).unwrap_or("no file");
        let kind = file.rsplit(['/', '.']).next().unwrap_or(file);
        let gone = if line.ends_with("(deleted)") { " (deleted)" } else { "" };
        *kinds.entry(format!("{kind}{gone}")).or_default() += 1;
    }
    kinds
}

fn asks_for_status(client: &mut Command) {
    client.arg("status");
}

#[test]
fn a_hundred_times() {
    let domain = TempDomain::new("test").expect("a name");
    let name = domain.name();
    let start = |program: &str| Running::start(program, name, |_| {});
    let daemon = start("upswingd");
    let (mut plant, mut planner) = (start("upswing-plant"), start("upswing-planner"));
    let node = domain.join("operator").expect("a node");
    let (client, plants, planners) = (
        node.client::<ControlRequest>().expect("a client"),
        node.client::<PlantRequest>().expect("a client"),
        node.client::<PlannerRequest>().expect("a client"),
    );
    let status = || -> ControlResponse {
        client.call(&ControlRequest::new(ControlKind::Status), LONG).expect("an answer")
    };
    // All three serve, and the cycle goes on: nothing is under construction.
    let settle = || {
        wait_for("all processes", || {
            (client.has_server() && plants.has_server() && planners.has_server()).then_some(())
        });
        let seq = status().seq;
        wait_for("cycles", || (status().seq > seq + 100).then_some(()));
        // What was never finished counts as an orphan after two seconds, and the rest of a node that was ending two seconds
        // after the last such thing went.
        for _ in 0..2 {
            std::thread::sleep(Duration::from_millis(2_500));
            node.clean_up();
        }
    };
    settle();
    let thread = daemon.thread("realtime");
    // The first restarts use memory that is used again from then on.
    let mut before = None;
    for round in 0..ROUNDS {
        if round == ROUNDS / 10 {
            settle();
            before = Some((files(&domain), daemon.memory(), mapped(&daemon), faults(&daemon, thread)));
        }
        drop((plant, planner));
        (plant, planner) = (start("upswing-plant"), start("upswing-planner"));
        let clients: Vec<_> = (0..2).map(|_| Running::start("upswing", name, asks_for_status)).collect();
        // From the first instructions of a start to a process that serves.
        std::thread::sleep(Duration::from_millis(3 * (round % 40)));
        drop(clients);
    }
    settle();
    let (files_before, own_before, mapped_before, faults_before) = before.expect("a first look");
    assert_eq!(files(&domain), files_before, "files of the domain");
    let (own, mapped) = (daemon.memory(), mapped(&daemon));
    // A reader that is left per restart would be more: each is some pages.
    assert!(own <= own_before + 256, "its own memory grew from {own_before} to {own} KiB");
    // So would a segment: iceoryx2 keeps a few connections of the dead, a region or two each, until others take their place.
    let regions = |mapped: &BTreeMap<String, usize>| mapped.values().sum::<usize>();
    assert!(
        regions(&mapped) <= regions(&mapped_before) + ROUNDS as usize / 5,
        "mapped {mapped:?}, before {mapped_before:?}"
    );
    if status().degraded & upswing_ipc::Degradation::Memory.bit() == 0 {
        assert_eq!(faults(&daemon, thread), faults_before, "page faults of the real-time thread");
    }
    drop((plant, planner, daemon));
    drop((client, plants, planners, node));
    assert!(domain.remove_if_unused().expect("removed"));
    assert_eq!(files(&domain), BTreeMap::new());
}

#[test]
fn a_second_daemon_names_the_first() {
    let domain = TempDomain::new("test").expect("a name");
    let name = domain.name();
    let first = Running::start("upswingd", name, |_| {});
    let node = domain.join("operator").expect("a node");
    let client = node.client::<ControlRequest>().expect("a client");
    wait_for("the first daemon", || client.has_server().then_some(()));
    let second = || {
        let mut command = Command::new(programs().join("upswingd"));
        command.args(["--domain", name]).stdin(Stdio::null());
        let output = command.output().expect("upswingd runs");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, text) = second();
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("has a daemon already") && text.contains(&format!("pid {}", first.id())), "{text}");
    // The place of a killed one is free.
    drop(first);
    let _next = Running::start("upswingd", name, |_| {});
    wait_for("the next daemon", || client.has_server().then_some(()));
}
