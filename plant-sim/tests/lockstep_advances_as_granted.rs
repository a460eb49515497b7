//! In lockstep time advances only by granted cycles, and all of them are answered.

mod common;

use common::{Answerer, Peer, PlantProcess, equal_torques, settings};
use std::time::Duration;
use upswing_config::FaultKind;
use upswing_ipc::{Clock, Measurement, PlantKind, PlantRequest, TempDomain};
use upswing_model::State;
use upswing_plant::Plant;

const LOCKSTEP: &[&str] = &["--clock", "lockstep"];

#[test]
fn granted_cycles_are_answered_one_by_one_and_equal_those_in_process() {
    let domain = TempDomain::new("granted").unwrap();
    let plant = PlantProcess::start(&domain, LOCKSTEP);
    let peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&peer);
    let mut twin = Plant::new(&settings()).unwrap();

    for granted in [1, 100, 100, 150] {
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(daemon.answer(), None, "nothing is measured before it is granted");
        let answer = peer.advance_to(granted);
        assert_eq!(answer.accepted, 1, "{}", answer.reason);
        while twin.seq() <= granted {
            let measured = common::wait_for("the next measurement", || daemon.answer());
            assert_eq!(measured, twin.measure(), "no cycle is left out");
            twin.step(Some(&equal_torques(0.0)));
        }
        let status = common::wait_for("the pause", || Some(peer.status()).filter(|s| s.seq == granted));
        let (x, _) = status.vectors(twin.order()).unwrap();
        assert_eq!((x.q(), x.qd()), (*twin.position(), *twin.velocity()), "the same state to the last bit");
        assert_eq!(status.brakes_closed, 0);
    }
    let refused = peer.advance_to(149);
    assert_eq!((refused.accepted, refused.seq), (0, 150));
    assert!(refused.reason.as_str().unwrap().contains("cycle 150 is granted already"), "{}", refused.reason);
    assert_eq!(plant.terminate(), Some(0));
}

#[test]
fn cycle_one_waits_for_the_first_daemon() {
    let domain = TempDomain::new("first").unwrap();
    let _plant = PlantProcess::start(&domain, LOCKSTEP);
    let peer = Peer::join(&domain);
    let measurements = peer.measurements();
    peer.advance_to(10);
    common::wait_for("cycle 1", || Some(measurements.read().seq).filter(|s| *s == 1));
    // A daemon that falls silent is lost after one second; cycle 1 waits for the first daemon without limit.
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!((measurements.read().seq, peer.status().seq), (1, 0));
    drop(measurements);

    let daemon_peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&daemon_peer);
    daemon.answer_until("cycle 10", || peer.status().seq == 10);
    let last = daemon.measurements.read();
    assert_eq!((last.seq, last.status & Measurement::BRAKES_CLOSED), (10, 0));
    assert_eq!(last.clock().unwrap(), Clock::Lockstep);
}

#[test]
fn without_answers_the_brakes_close_and_granted_time_goes_on() {
    let domain = TempDomain::new("silent").unwrap();
    let _plant = PlantProcess::start(&domain, LOCKSTEP);
    let peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&peer);
    peer.advance_to(50);
    daemon.answer_until("cycle 50", || peer.status().seq == 50);
    assert_eq!(peer.status().brakes_closed, 0);

    peer.advance_to(100);
    let status = common::wait_for("cycle 100", || Some(peer.status()).filter(|s| s.seq == 100));
    assert_eq!(status.brakes_closed, 1);
    let last = daemon.measurements.read();
    assert_eq!((last.seq, last.status & Measurement::BRAKES_CLOSED), (100, Measurement::BRAKES_CLOSED));

    // The daemon answers again: the next cycle waits for it.
    daemon.answer();
    peer.advance_to(120);
    daemon.answer_until("cycle 120", || peer.status().seq == 120);
    assert_eq!(peer.status().brakes_closed, 0);
}

#[test]
fn a_state_is_set_only_with_closed_brakes() {
    let domain = TempDomain::new("reset").unwrap();
    let _plant = PlantProcess::start(&domain, LOCKSTEP);
    let peer = Peer::join(&domain);
    let order = *settings().model.order();
    let mut x = State::zeros(order.sizes());
    (x.q_mut()[3], x.q_mut()[8], x.qd_mut()[7]) = (-1.5, 0.1, 0.5);
    let request = PlantRequest::reset_state(&order, &x);
    let done = peer.ask(request);
    assert_eq!((done.accepted, done.q, done.qd, done.seq), (1, request.q, request.qd, 0), "{}", done.reason);

    let mut bad = request;
    bad.q[3] = f64::NAN;
    let refused = peer.ask(bad);
    assert_eq!((refused.accepted, refused.q), (0, request.q));
    assert!(
        refused.reason.as_str().unwrap().starts_with("position of joint `joint_4`: "),
        "{}",
        refused.reason
    );

    let refused = peer.ask(PlantRequest { actuated: 6, ..request });
    assert_eq!((refused.accepted, refused.q), (0, request.q));
    assert!(refused.reason.as_str().unwrap().contains("expected 9 and 7"), "{}", refused.reason);

    let mut daemon = Answerer::join(&peer);
    peer.advance_to(1);
    let first = common::wait_for("cycle 1", || daemon.answer());
    assert!((first.q[3] + 1.5).abs() < 1e-4, "the state is that of the next cycle");
    daemon.answer_until("cycle 1", || peer.status().seq == 1);
    let refused = peer.ask(request);
    assert_eq!(refused.accepted, 0);
    assert!(refused.reason.as_str().unwrap().contains("brakes are released"), "{}", refused.reason);
}

#[test]
fn what_cannot_be_is_refused_with_a_reason() {
    let domain = TempDomain::new("refused").unwrap();
    let _plant = PlantProcess::start(&domain, LOCKSTEP);
    let peer = Peer::join(&domain);
    let nan = FaultKind::EncoderNan.code();
    let ask = |kind: PlantKind, request: PlantRequest| PlantRequest { kind: kind.code(), ..request };
    for (request, reason) in [
        (PlantRequest { kind: 99, ..PlantRequest::default() }, "unknown plant request code 99"),
        (ask(PlantKind::SetFault, PlantRequest { fault: 11, ..Default::default() }), "from 0 to 10, got 11"),
        (
            ask(PlantKind::SetFault, PlantRequest { fault: nan, ..Default::default() }),
            "joint: expected 1 to 9, got 0",
        ),
        (ask(PlantKind::Push, PlantRequest::default()), "cycles: expected 1 or more for a push, got 0"),
    ] {
        let refused = peer.ask(request);
        assert_eq!(refused.accepted, 0);
        assert!(refused.reason.as_str().unwrap().contains(reason), "{}", refused.reason);
    }
}
