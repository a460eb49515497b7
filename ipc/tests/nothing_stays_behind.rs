//! A removed domain leaves no file; a domain in use is not removed.

mod common;

use common::{SIZES, Victim, domain_of_child, until_killed, wait_for};
use std::os::unix::fs::{PermissionsExt, symlink};
use upswing_ipc::{
    Command, ControlRequest, Domain, IpcError, Measurement, PlanMessage, PlantRequest, TelemetryBatch,
    TempDomain,
};

/// Entry of the child process: holds every kind of end until it is killed.
#[test]
fn child_holds_everything() {
    let Some(domain) = domain_of_child() else { return };
    let node = domain.join("victim").unwrap();
    let writer = node.writer::<Measurement>().unwrap();
    let publisher = node.publisher::<TelemetryBatch>().unwrap();
    let _subscriber = node.subscriber::<PlanMessage>().unwrap();
    let _server = node.server::<PlantRequest>().unwrap();
    let _client = node.client::<ControlRequest>().unwrap();
    let batch = TelemetryBatch::boxed_zeroed();
    until_killed(|| {
        writer.write(Measurement { seq: 1, ..Measurement::default() });
        publisher.publish(&batch).unwrap();
    });
}

/// All files of a domain, by a wider net than the one that removes them.
fn traces(domain: &Domain) -> Vec<String> {
    let names = std::fs::read_dir("/dev/shm").unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    names.filter(|n| n.contains(domain.name())).collect()
}

#[test]
fn after_an_orderly_end() {
    let domain = TempDomain::new("orderly").unwrap();
    let node = domain.join("daemon").unwrap();
    let writer = node.writer::<Command>().unwrap();
    writer.write(Command::default());
    let mut finder = node.finder::<Command>();
    let reader = finder.poll().unwrap();
    let ends = (
        (node.plan_publisher(SIZES.0, SIZES.1).unwrap(), node.subscriber::<PlanMessage>().unwrap()),
        (node.publisher::<TelemetryBatch>().unwrap(), node.subscriber::<TelemetryBatch>().unwrap()),
        (node.server::<ControlRequest>().unwrap(), node.client::<ControlRequest>().unwrap()),
    );
    assert!(traces(&domain).len() > 1);
    assert!(!domain.remove_if_unused().unwrap(), "it is in use");
    drop(node);
    assert!(!domain.remove_if_unused().unwrap(), "ends of services count as well");
    let other = domain.join("cli").unwrap();
    drop((writer, finder, reader, ends));
    assert!(domain.exists(), "somebody is still there");
    drop(other);
    assert_eq!(traces(&domain), [""; 0], "the last one out removes them");
    assert!(domain.remove_if_unused().unwrap(), "nothing to do is no error");
    assert_eq!(traces(&domain), [""; 0]);
}

#[test]
fn after_processes_were_killed() {
    let domain = TempDomain::new("victims").unwrap();
    {
        let node = domain.join("observer").unwrap();
        for _ in 0..3 {
            let victim = Victim::start("child_holds_everything", &domain);
            let mut finder = node.finder::<Measurement>();
            let reader = wait_for("the victim", || finder.poll().unwrap());
            wait_for("its data", || (reader.read().seq == 1).then_some(()));
            assert!(!domain.remove_if_unused().unwrap());
            victim.kill();
        }
    }
    let victim = Victim::start("child_holds_everything", &domain);
    // Until it has joined there is nothing to keep; then it keeps the domain.
    wait_for("the victim to join", || (!domain.remove_if_unused().unwrap()).then_some(()));
    victim.kill();
    assert!(domain.remove_if_unused().unwrap());
    assert_eq!(traces(&domain), [""; 0]);
}

#[test]
fn after_processes_were_killed_while_they_started() {
    let domain = TempDomain::new("births").unwrap();
    for delay_us in (0..20_000).step_by(1000) {
        let victim = Victim::start("child_holds_everything", &domain);
        std::thread::sleep(std::time::Duration::from_micros(delay_us));
        victim.kill();
    }
    // A domain full of stillbirths still works.
    let node = domain.join("survivor").unwrap();
    let writer = node.writer::<Measurement>().unwrap();
    assert_eq!(node.finder::<Measurement>().poll().unwrap().unwrap().epoch(), writer.epoch());
    node.server::<PlantRequest>().unwrap();
    node.publisher::<TelemetryBatch>().unwrap();
    drop((writer, node));
    assert!(domain.remove_if_unused().unwrap());
    assert_eq!(traces(&domain), [""; 0]);
}

#[test]
fn a_removed_domain_can_be_used_again() {
    let domain = TempDomain::new("again").unwrap();
    for seq in 1..=3 {
        let node = domain.join("daemon").unwrap();
        let writer = node.writer::<Command>().unwrap();
        writer.write(Command { seq, ..Command::default() });
        let reader = node.finder::<Command>().poll().unwrap().unwrap();
        assert_eq!(reader.read().seq, seq);
        drop((reader, writer, node));
        assert!(domain.remove_if_unused().unwrap());
    }
}

#[test]
fn joining_and_removing_at_the_same_time_is_safe() {
    let domain = TempDomain::new("race").unwrap();
    std::thread::scope(|threads| {
        for _ in 0..2 {
            threads.spawn(|| {
                for seq in 1..=10 {
                    let node = domain.join("daemon").unwrap();
                    let writer = node.writer::<Command>().unwrap();
                    writer.write(Command { seq, ..Command::default() });
                    assert!(domain.root().exists(), "a domain in use is not removed");
                }
            });
        }
        threads.spawn(|| {
            for _ in 0..50 {
                domain.remove_if_unused().unwrap();
                std::thread::yield_now();
            }
        });
    });
    assert!(domain.remove_if_unused().unwrap());
    assert_eq!(traces(&domain), [""; 0]);
}

#[test]
fn only_this_user_can_enter_the_directory() {
    let domain = TempDomain::new("private").unwrap();
    std::fs::create_dir(domain.root()).unwrap();
    std::fs::set_permissions(domain.root(), std::fs::Permissions::from_mode(0o777)).unwrap();
    let _node = domain.join("daemon").unwrap();
    assert_eq!(domain.root().metadata().unwrap().permissions().mode() & 0o777, 0o700);
}

#[test]
fn a_path_that_is_not_our_directory_is_refused() {
    let domain = TempDomain::new("foreign").unwrap();
    let link = domain.root();
    let target = std::env::temp_dir();
    symlink(&target, &link).unwrap();
    let error = domain.join("daemon").err().unwrap();
    assert!(matches!(error, IpcError::Foreign { .. }), "{error}");
    let error = domain.remove_if_unused().err().unwrap();
    assert!(matches!(error, IpcError::Foreign { .. }), "{error}");
    assert!(target.exists());
    std::fs::remove_file(link).unwrap();
}

#[test]
fn no_configuration_of_somebody_else_is_in_force() {
    let domain = TempDomain::new("config").unwrap();
    let _node = domain.join("daemon").unwrap();
    // Where iceoryx2 falls back to the global configuration it must be that of a domain (the first one of this
    // process), not that of a file in the working directory.
    let global = &iceoryx2::prelude::Config::global_config().global;
    let (root, prefix) = (global.root_path().to_string(), global.prefix.to_string());
    assert!(root.starts_with("/dev/shm/upswing.") && prefix.starts_with("upswing_"), "{root} {prefix}");
}
