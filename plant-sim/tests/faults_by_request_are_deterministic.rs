//! A fault or push requested in lockstep takes effect at its cycle: the process equals the same plant in-process bit for
//! bit, and never waits for an answer to a measurement that a fault hides.

mod common;

use common::{Answerer, Peer, PlantProcess, equal_torques, settings, wait_for};
use upswing_config::{Config, Fault, FaultKind, Push};
use upswing_ipc::{PlantKind, PlantRequest, TempDomain};
use upswing_plant::Plant;

const END: u64 = 120;

/// The plant in-process, with a command for each new measurement as by the [`Answerer`]. `disturb` is called before cycle 11.
fn twin(config: &Config, disturb: impl Fn(&mut Plant)) -> Plant {
    let mut plant = Plant::new(config).unwrap();
    let mut answered = 0;
    while plant.seq() <= END {
        if plant.seq() == 11 {
            disturb(&mut plant);
        }
        let shown = plant.measure().seq;
        let command = (shown != answered).then(|| equal_torques(0.0));
        answered = shown;
        plant.step(command.as_ref());
    }
    plant
}

fn conforms(options: &[&str], config: &Config, request: PlantRequest, twin: &Plant, what: &str) {
    let domain = TempDomain::new("faulty").unwrap();
    let _plant = PlantProcess::start(&domain, &[&["--clock", "lockstep"], options].concat());
    let peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&peer);
    peer.advance_to(10);
    daemon.answer_until("cycle 10", || peer.status().seq == 10);
    let answer = peer.ask(request);
    assert_eq!(answer.accepted, 1, "{what}: {}", answer.reason);
    peer.advance_to(END);
    daemon.answer_until("the last cycle", || peer.status().seq == END);
    let status = wait_for("the pause", || Some(peer.status()).filter(|s| s.seq == END));
    let (x, _) = status.vectors(twin.order()).unwrap();
    assert_eq!((x.q(), x.qd()), (*twin.position(), *twin.velocity()), "{what}");
    assert_eq!(status.brakes_closed == 1, twin.brakes_closed(), "{what}");
    assert_eq!(config.plant.drive.watchdog_cycles, 20, "faults below are longer than that");
}

#[test]
fn every_fault() {
    let config = settings();
    for &kind in FaultKind::all() {
        let fault = Fault { kind, from: 21, cycles: 50, joint: 4, amount: 5.0 };
        let request = PlantRequest {
            seq: fault.from,
            fault: kind.code(),
            joint: 5,
            amount: fault.amount,
            cycles: fault.cycles,
            ..PlantRequest::new(PlantKind::SetFault)
        };
        conforms(
            &[],
            &config,
            request,
            &twin(&config, |plant| plant.set_fault(&fault).unwrap()),
            &format!("{kind:?}"),
        );
    }
}

#[test]
fn a_push_under_a_scenario() {
    let mut config = settings();
    config.use_scenario("everyday").unwrap();
    // Cycle 0 in the request means the next cycle.
    let push = Push { from: 11, cycles: 8, impulse: [0.01, -0.02, 0.03] };
    let request =
        PlantRequest { cycles: push.cycles, impulse: push.impulse, ..PlantRequest::new(PlantKind::Push) };
    let twin = twin(&config, |plant| plant.push(&push).unwrap());
    conforms(&["--scenario", "everyday"], &config, request, &twin, "push");
}

#[test]
fn a_request_in_the_middle_of_a_cycle_takes_effect_with_the_next() {
    let domain = TempDomain::new("middle").unwrap();
    let _plant = PlantProcess::start(&domain, &["--clock", "paced"]);
    let peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&peer);
    daemon.answer_until("released brakes", || peer.status().brakes_closed == 0);
    let fault = FaultKind::DropMeasurement.code();
    let drop = PlantRequest { fault, cycles: 5, ..PlantRequest::new(PlantKind::SetFault) };
    for _ in 0..20 {
        // The measurement is published, and the plant waits for its command while it serves the request.
        let out = wait_for("a measurement", || Some(daemon.measurements.read()).filter(|m| m.seq > 0));
        assert_eq!(peer.ask(drop).accepted, 1);
        let past = peer.ask(PlantRequest { seq: out.seq, ..drop });
        assert!(past.reason.as_str().unwrap().contains("past cycles cannot be changed"), "{}", past.reason);
        let mut seen = vec![out.seq];
        while seen.len() < 30 {
            seen.extend(daemon.answer().map(|m| m.seq).filter(|seq| *seq != out.seq));
        }
        let gaps: Vec<_> = seen.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap != 1).collect();
        assert_eq!(gaps, [6], "five measurements are missing, once: {seen:?}");
    }
}

#[test]
fn faults_are_cleared() {
    let config = settings();
    let domain = TempDomain::new("cleared").unwrap();
    let _plant = PlantProcess::start(&domain, &["--clock", "lockstep"]);
    let peer = Peer::join(&domain);
    let mut daemon = Answerer::join(&peer);
    let fault = FaultKind::DropMeasurement.code();
    let set = PlantRequest { fault, ..PlantRequest::new(PlantKind::SetFault) };
    peer.advance_to(5);
    daemon.answer_until("cycle 5", || peer.status().seq == 5);
    assert_eq!(peer.ask(set).accepted, 1);
    let watchdog = u64::from(config.plant.drive.watchdog_cycles);
    peer.advance_to(5 + watchdog);
    daemon.answer_until("closed brakes", || peer.status().brakes_closed == 1);
    assert_eq!(daemon.measurements.read().seq, 5, "nothing has arrived since");
    let clear = PlantRequest::new(PlantKind::ClearFaults);
    assert_eq!(peer.ask(clear).accepted, 1);
    peer.advance_to(50);
    daemon.answer_until("cycle 50", || peer.status().seq == 50);
    assert_eq!((daemon.measurements.read().seq, peer.status().brakes_closed), (50, 0));
}
