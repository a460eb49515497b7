//! A reader finds a writer that was killed and restarted, and other processes are not disturbed.

mod common;

use common::{Victim, domain_of_child, until_killed, wait_for};
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_ipc::{Command, Domain, FinderThread, Measurement, Node, Reader, TempDomain, WriterEntry};

/// Entry of the child process: writes measurements until it is killed.
#[test]
fn child_writes() {
    let Some(domain) = domain_of_child() else { return };
    let writer = domain.join("plant").unwrap().writer::<Measurement>().unwrap();
    let mut seq = 0;
    until_killed(|| {
        seq += 1;
        writer.write(Measurement { seq, t_ns: writer.epoch(), q: [seq as f64; _], ..Measurement::default() });
    });
}

#[test]
fn each_start_of_a_killed_writer_is_adopted() {
    let domain = TempDomain::new("restart").unwrap();
    let node = domain.join("daemon").unwrap();
    let mut finder = node.finder::<Measurement>();
    assert!(finder.poll().unwrap().is_none());

    let mut previous = None;
    for round in 0..4 {
        let plant = Victim::start("child_writes", &domain);
        let reader = wait_for("a new writer", || finder.poll().unwrap());
        let measurement = wait_for("fresh data", || Some(reader.read()).filter(|m| m.seq > 3));
        assert_eq!(measurement.t_ns, reader.epoch(), "data of this start of the writer");
        assert_eq!(finder.epoch(), Some(reader.epoch()));
        plant.kill();

        let last = reader.read();
        assert!(finder.poll().unwrap().is_none(), "round {round}: the dead writer is not found again");
        assert_eq!(reader.read(), last, "the last value stays readable");
        if let Some(old) = previous.replace(reader) {
            let new = previous.as_ref().unwrap();
            assert!(new.epoch() > old.epoch());
            let old_last = old.read();
            assert_eq!(old_last.t_ns, old.epoch(), "readers of earlier starts stay valid");
        }
    }
}

#[test]
fn a_search_tells_whether_the_writer_lives() {
    let domain = TempDomain::new("lives").unwrap();
    let search = FinderThread::<Measurement>::start(&domain.join("daemon").unwrap()).unwrap();
    assert!(search.first().unwrap().is_none() && !search.writer_is_alive());
    for _ in 0..2 {
        let plant = Victim::start("child_writes", &domain);
        let reader = wait_for("a new writer", || search.poll().unwrap());
        assert!(search.writer_is_alive());
        plant.kill();
        wait_for("its death", || (!search.writer_is_alive()).then_some(()));
        drop(reader);
    }
}

#[test]
fn a_finder_that_comes_late_takes_the_newest_writer() {
    let domain = TempDomain::new("late").unwrap();
    let node = domain.join("daemon").unwrap();
    let older = node.writer::<Command>().unwrap();
    let newer = node.writer::<Command>().unwrap();
    older.write(Command { seq: 1, ..Command::default() });
    newer.write(Command { seq: 2, ..Command::default() });

    let peer = domain.join("plant").unwrap();
    let mut finder = peer.finder::<Command>();
    let reader = finder.poll().unwrap().unwrap();
    assert_eq!((reader.read().seq, reader.epoch()), (2, newer.epoch()));
    assert!(finder.poll().unwrap().is_none(), "the older one is not a newer one");
    drop(newer);
    let reader = finder.poll().unwrap().expect("the one that lives when the newer one has left");
    assert_eq!((reader.read().seq, reader.epoch()), (1, older.epoch()));
    assert!(finder.poll().unwrap().is_none());
}

#[test]
fn a_writer_that_leaves_in_order_is_not_found() {
    let domain = TempDomain::new("left").unwrap();
    let node = domain.join("plant").unwrap();
    drop(node.writer::<Measurement>().unwrap());
    assert!(node.finder::<Measurement>().poll().unwrap().is_none());
}

#[test]
fn entries_work_in_other_threads_and_values_are_never_torn() {
    let domain = TempDomain::new("torn").unwrap();
    let plant = domain.join("plant").unwrap();
    let daemon = domain.join("daemon").unwrap();
    let (entry, _ports) = plant.writer::<Measurement>().unwrap().split();
    let mut finder = daemon.finder::<Measurement>();
    let reader = finder.poll().unwrap().unwrap();
    assert_eq!(reader.read(), Measurement::default());

    let done = AtomicBool::new(false);
    std::thread::scope(|threads| {
        threads.spawn(|| {
            let entry = entry; // dropped in this thread
            for seq in 1..=200_000 {
                entry.write(Measurement { seq, q: [seq as f64; _], status: seq, ..Measurement::default() });
            }
            done.store(true, Ordering::Release);
        });
        threads.spawn(|| {
            let reader = reader; // dropped in this thread
            let mut last = 0;
            while !done.load(Ordering::Acquire) {
                let m = reader.read();
                assert!(
                    m.seq >= last && m.status == m.seq && m.q.iter().all(|&q| q == m.seq as f64),
                    "{m:?}"
                );
                last = m.seq;
            }
            assert_eq!(reader.read().seq, 200_000);
        });
    });
    assert!(finder.poll().unwrap().is_none());
}

#[test]
fn what_is_meant_to_move_between_threads_can() {
    fn movable<T: Send>() {}
    movable::<WriterEntry<Command>>();
    movable::<Reader<Measurement>>();
    movable::<Node>();
    movable::<Domain>();
}

#[test]
fn entries_outlive_their_ports() {
    let domain = TempDomain::new("outlive").unwrap();
    let node = domain.join("both").unwrap();
    let mut finder = node.finder::<Command>();
    let (entry, ports) = node.writer::<Command>().unwrap().split();
    let reader = finder.poll().unwrap().unwrap();
    drop((ports, finder, node));
    std::thread::scope(|threads| {
        threads.spawn(move || {
            entry.write(Command { seq: 3, ..Command::default() });
            assert_eq!(reader.read().seq, 3);
        });
    });
    assert!(domain.remove_if_unused().unwrap());
}
