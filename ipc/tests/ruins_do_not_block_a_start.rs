//! Files of processes that were killed while they created services do not keep others from starting.

mod common;

use common::{Victim, domain_of_child, until_killed, wait_for};
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};
use upswing_ipc::{CallError, ControlKind, ControlRequest, Domain, Measurement, TelemetryBatch, TempDomain};

/// Entry of the child process: holds some ends until it is killed.
#[test]
fn child_holds_ends() {
    let Some(domain) = domain_of_child() else { return };
    let node = domain.join("victim").unwrap();
    let _server = node.server::<ControlRequest>().unwrap();
    let _publisher = node.publisher::<TelemetryBatch>().unwrap();
    let writer = node.writer::<Measurement>().unwrap();
    writer.write(Measurement { seq: 1, ..Measurement::default() });
    until_killed(|| {});
}

/// Entry of the child process: sends to whoever listens until it is killed.
#[test]
fn child_publishes() {
    let Some(domain) = domain_of_child() else { return };
    let publisher = domain.join("victim").unwrap().publisher::<TelemetryBatch>().unwrap();
    until_killed(|| {
        publisher.publish(&TelemetryBatch::boxed_zeroed()).unwrap();
    });
}

fn files(directory: PathBuf, part_of_name: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(directory).unwrap().map(|e| e.unwrap());
    let named = entries.filter(|e| e.file_name().to_str().unwrap().contains(part_of_name));
    named.map(|e| e.path()).collect()
}

fn descriptions(domain: &Domain) -> Vec<PathBuf> {
    files(domain.root().join("services"), ".service")
}

fn memory(domain: &Domain) -> Vec<PathBuf> {
    files("/dev/shm".into(), &format!("upswing_{}_", domain.name()))
}

/// A domain in which a process was killed after it had created its services.
fn deserted(tag: &str) -> TempDomain {
    let domain = TempDomain::new(tag).unwrap();
    let victim = Victim::start("child_holds_ends", &domain);
    wait_for("its services", || {
        (domain.root().join("services").exists() && descriptions(&domain).len() == 3).then_some(())
    });
    let node = domain.join("observer").unwrap();
    let mut finder = node.finder::<Measurement>();
    let reader = wait_for("its writer", || finder.poll().unwrap());
    wait_for("its data", || (reader.read().seq == 1).then_some(()));
    drop((reader, finder, node));
    victim.kill();
    assert!(!memory(&domain).is_empty() && !descriptions(&domain).is_empty());
    domain
}

fn all_can_start(domain: &Domain) {
    let node = domain.join("survivor").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let error = client.call(&ControlRequest::new(ControlKind::Status), Duration::from_secs(30)).unwrap_err();
    assert!(matches!(error, CallError::NoServer { .. }), "{error}");
    let _server = node.server::<ControlRequest>().unwrap();
    let _publisher = node.publisher::<TelemetryBatch>().unwrap();
    let writer = node.writer::<Measurement>().unwrap();
    let reader = node.finder::<Measurement>().poll().unwrap().unwrap();
    assert_eq!(reader.epoch(), writer.epoch());
}

#[test]
fn intact_leftovers_do_not() {
    all_can_start(&deserted("intact"));
}

#[test]
fn unfinished_shared_memory_does_not() {
    let domain = deserted("memory");
    for path in memory(&domain) {
        // As after shm_open, before ftruncate.
        std::fs::File::create(&path).unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(0o200)).unwrap();
    }
    all_can_start(&domain);
}

#[test]
fn unfinished_descriptions_of_services_do_not() {
    let domain = deserted("text");
    for path in descriptions(&domain) {
        // As after open, before the contents are written.
        std::fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
        std::fs::File::create(&path).unwrap();
    }
    all_can_start(&domain);
}

#[test]
fn unfinished_nodes_and_connections_without_a_port_are_removed_when_they_are_old() {
    let domain = TempDomain::new("nodes").unwrap();
    let node = domain.join("first").unwrap();
    let nodes = domain.root().join("nodes");
    let complete = files(nodes.clone(), "").len();
    let prefix = format!("upswing_{}_", domain.name());
    let context = nodes.join(format!("{prefix}42.node_monitor_context"));
    let connection = PathBuf::from(format!("/dev/shm/{prefix}{}_42_43.connection", "0".repeat(40)));
    // As after the folder and the first two files of a node, before the context can be read.
    std::fs::create_dir(nodes.join("42")).unwrap();
    std::fs::File::create(nodes.join("42").join(format!("{prefix}node.details"))).unwrap();
    for file in [&nodes.join(format!("{prefix}42.node_monitor")), &context, &connection] {
        std::fs::File::create(file).unwrap();
    }
    std::fs::set_permissions(&context, Permissions::from_mode(0o200)).unwrap();
    // What is left of a node whose removal was cut off.
    let orphan = nodes.join(format!("{prefix}44.node_monitor_context"));
    std::fs::write(&orphan, "0123456789abcdef").unwrap();
    let found = || (files(nodes.clone(), "").len(), connection.exists());
    node.clean_up();
    assert_eq!(found(), (complete + 4, true), "somebody may be at it");

    let long_ago = SystemTime::now() - Duration::from_secs(3);
    for path in files(nodes.clone(), "").iter().chain([&connection]) {
        if path != &context {
            std::fs::File::open(path).unwrap().set_modified(long_ago).unwrap();
        }
    }
    std::fs::OpenOptions::new().write(true).open(&context).unwrap().set_modified(long_ago).unwrap();
    std::fs::File::open(&nodes).unwrap().set_modified(long_ago).unwrap();
    node.clean_up();
    assert_eq!(found(), (complete, false), "those of the living node stay");
    let _server = node.server::<ControlRequest>().unwrap();
}

#[test]
fn an_unfinished_connection_of_a_dead_port_does_not_stop_the_clean_up() {
    let domain = TempDomain::new("connection").unwrap();
    let victim = Victim::start("child_publishes", &domain);
    let node = domain.join("observer").unwrap();
    let subscriber = node.subscriber::<TelemetryBatch>().unwrap();
    wait_for("telemetry", || subscriber.receive().unwrap());
    victim.kill();
    let connections = files("/dev/shm".into(), &format!("upswing_{}_", domain.name()));
    let connection = connections.into_iter().find(|path| path.extension().is_some_and(|e| e == "connection"));
    // As after shm_open, before ftruncate, a moment ago; the observer keeps what it has mapped.
    let connection = connection.expect("one to the observer");
    std::fs::remove_file(&connection).unwrap();
    std::fs::File::create(&connection).unwrap();
    std::fs::set_permissions(&connection, Permissions::from_mode(0o200)).unwrap();

    let (tell, told) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        node.clean_up();
        tell.send(()).unwrap();
    });
    told.recv_timeout(Duration::from_secs(30)).expect("the clean-up ends");
    assert_eq!(domain.count_dead().unwrap(), 0);
    assert!(!connection.exists());
}

#[test]
fn an_unfinished_tag_does_not_keep_a_dead_node() {
    let domain = deserted("tag");
    let nodes = domain.root().join("nodes");
    let folders = || files(nodes.clone(), "").into_iter().filter(|path| path.is_dir()).collect::<Vec<_>>();
    let [folder] = &folders()[..] else { panic!("one dead node, not {:?}", folders()) };
    let tag = folder.join(format!("upswing_{}_{}.service_tag", domain.name(), "0".repeat(40)));
    // As after open, before it is made read-only.
    std::fs::set_permissions(folder, Permissions::from_mode(0o700)).unwrap();
    std::fs::File::create(&tag).unwrap().set_modified(SystemTime::now() - Duration::from_secs(3)).unwrap();
    std::fs::set_permissions(&tag, Permissions::from_mode(0o600)).unwrap();
    let node = domain.join("survivor").unwrap();
    node.clean_up();
    assert!(!folder.exists(), "{:?}", files(folder.clone(), ""));
    drop(node);
    assert!(!domain.exists(), "{:?}", files(nodes, ""));
}

#[test]
fn kills_at_any_moment_of_a_start_do_not() {
    let domain = TempDomain::new("moments").unwrap();
    for delay_us in (0..15_000).step_by(500) {
        let victim = Victim::start("child_holds_ends", &domain);
        std::thread::sleep(Duration::from_micros(delay_us));
        victim.kill();
    }
    all_can_start(&domain);
}
