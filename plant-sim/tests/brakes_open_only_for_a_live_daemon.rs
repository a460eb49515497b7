//! On every clock the brakes are closed without a daemon, open for a daemon that answers, and close when the daemon falls silent.

mod common;

use common::{Answerer, Peer, PlantProcess, equal_torques, wait_for};
use upswing_ipc::{Clock, Command, Measurement, TempDomain};

fn brakes_closed(measurement: &Measurement) -> bool {
    measurement.status & Measurement::BRAKES_CLOSED != 0
}

fn start(clock: Clock) -> (TempDomain, PlantProcess, Peer) {
    let domain = TempDomain::new("live").unwrap();
    let plant = PlantProcess::start(&domain, &["--clock", &clock.to_string()]);
    let peer = Peer::join(&domain);
    if clock == Clock::Lockstep {
        assert_eq!(peer.advance_to(u64::MAX).accepted, 1);
    } else {
        let refused = peer.advance_to(5);
        assert_eq!(refused.accepted, 0);
        assert!(refused.reason.as_str().unwrap().contains("advances by itself"), "{}", refused.reason);
    }
    (domain, plant, peer)
}

fn conforms(clock: Clock) {
    let (_domain, plant, peer) = start(clock);
    let mut daemon = Answerer::join(&peer);
    let measurements = peer.measurements();
    if clock != Clock::Lockstep {
        let later = wait_for("time without a daemon", || Some(measurements.read()).filter(|m| m.seq > 50));
        assert!(brakes_closed(&later));
        assert_eq!(later.clock().unwrap(), clock);
    }
    for _ in 0..2 {
        daemon.answer_until("released brakes", || {
            let m = measurements.read();
            m.seq > 0 && !brakes_closed(&m)
        });
        let silent_from = measurements.read().seq;
        let braked = wait_for("closed brakes", || Some(measurements.read()).filter(brakes_closed));
        assert!(braked.seq > silent_from);
        wait_for("time goes on", || Some(measurements.read()).filter(|m| m.seq > braked.seq + 50));
    }
    assert_eq!(plant.terminate(), Some(0));
}

#[test]
fn on_the_wall_clock() {
    conforms(Clock::Wall);
}

#[test]
fn on_the_paced_clock() {
    conforms(Clock::Paced);
}

#[test]
fn on_the_lockstep_clock() {
    conforms(Clock::Lockstep);
}

#[test]
fn a_daemon_that_restarts_is_adopted() {
    let (_domain, _plant, peer) = start(Clock::Paced);
    let measurements = peer.measurements();
    for _ in 0..3 {
        let mut daemon = Answerer::new(peer.measurements(), peer.commands());
        daemon.answer_until("released brakes", || !brakes_closed(&measurements.read()));
        drop(daemon);
        wait_for("closed brakes", || Some(measurements.read()).filter(brakes_closed));
    }
}

#[test]
fn commands_that_answer_nothing_do_not_count() {
    let (_domain, _plant, peer) = start(Clock::Paced);
    let measurements = peer.measurements();
    let commands = peer.commands();
    let mut worst = 0;
    for seq in 1..2_000 {
        // The first command answers a measurement that does not exist; the second has a number that is not new.
        let measurement_seq = if seq % 2 == 0 { 0 } else { u64::MAX };
        commands.write(Command { seq, measurement_seq, ..equal_torques(0.0) });
        commands.write(Command { seq: 0, measurement_seq: measurements.read().seq, ..equal_torques(0.0) });
        std::thread::yield_now();
        worst |= !measurements.read().status & Measurement::BRAKES_CLOSED;
    }
    wait_for("time goes on", || Some(measurements.read()).filter(|m| m.seq > 2_000));
    assert_eq!(worst, 0, "the brakes stayed closed");
}

#[test]
fn a_second_plant_is_refused() {
    let (domain, mut first, _peer) = start(Clock::Paced);
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_upswing-plant"))
        .args(["--domain", domain.name()])
        .output()
        .unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("`plant`"), "{message}");
    assert!(first.is_alive());
}
