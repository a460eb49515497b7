//! Each fault has the effect that its name states in its cycles, and no effect before and after.

mod common;

use common::{at_rest, equal_torques, level_pose, settings, sizes, torque};
use upswing_config::{EventError, Fault, FaultKind, MAX_DELAY, Push};
use upswing_ipc::Measurement;
use upswing_model::{ActuatedVector, JointVector};
use upswing_plant::{Plant, SetEventError};

const FROM: u64 = 100;
const CYCLES: u64 = 10;
const END: u64 = 140;

/// Measurements by cycle under `faults`; index 0 is unused.
fn measurements(faults: impl IntoIterator<Item = Fault>) -> Vec<Measurement> {
    let mut config = settings();
    config.plant.faults.extend(faults);
    let mut plant =
        Plant::at(&config, &level_pose(), &JointVector::from_fn(sizes(), |i| 0.1 * i as f64)).unwrap();
    let mut seen = vec![Measurement::default()];
    while plant.seq() <= END {
        seen.push(plant.measure());
        plant.step(Some(&equal_torques(plant.seq() as f64 / 10.0)));
    }
    seen
}

/// Numbers of the measurements received in the cycles of the fault, relative to its first cycle.
fn order(kind: FaultKind, amount: f64) -> Vec<i64> {
    let truth = measurements(None);
    let seen = measurements([Fault { amount, ..Fault::new(kind, FROM, CYCLES) }]);
    for seq in (1..FROM).chain(FROM + CYCLES..=END) {
        assert_eq!(seen[seq as usize], truth[seq as usize], "{kind:?}: cycle {seq} is none of the fault");
    }
    let during = &seen[FROM as usize..(FROM + CYCLES) as usize];
    for m in during {
        assert_eq!(*m, truth[m.seq as usize], "{kind:?}: old or new, it is a true measurement");
    }
    during.iter().map(|m| m.seq as i64 - FROM as i64).collect()
}

#[test]
fn measurements_are_dropped_delayed_duplicated_and_reordered() {
    assert_eq!(order(FaultKind::DropMeasurement, 0.0), [-1; 10]);
    assert_eq!(order(FaultKind::DelayMeasurement, 3.0), [-1, -1, -1, 0, 1, 2, 3, 4, 5, 6]);
    assert_eq!(order(FaultKind::DuplicateMeasurement, 0.0), [-1, 1, 1, 3, 3, 5, 5, 7, 7, 9]);
    assert_eq!(order(FaultKind::ReorderMeasurement, 0.0), [0, -1, 2, 1, 4, 3, 6, 5, 8, 7]);
}

/// Pairs of received and true measurements in the cycles of an endless fault, and the true measurement of its first cycle.
fn corrupted(kind: FaultKind, joint: usize, amount: f64) -> (Vec<(Measurement, Measurement)>, Measurement) {
    let truth = measurements(None);
    let seen = measurements([Fault { kind, from: FROM, cycles: 0, joint, amount }]);
    assert_eq!(seen[..FROM as usize], truth[..FROM as usize]);
    let pairs = seen.into_iter().zip(truth.clone()).skip(FROM as usize).collect();
    (pairs, truth[FROM as usize])
}

#[test]
fn a_torque_from_outside_acts_as_one_of_the_drives() {
    let moved = |faults: &[Fault], tau: f64| {
        let mut config = settings();
        config.plant.faults.extend(faults);
        let mut plant = Plant::at(&config, &level_pose(), &at_rest()).unwrap();
        let command =
            |tau: f64| torque(&ActuatedVector::from_fn(sizes(), |i| if i == 3 { tau } else { 0.0 }));
        while plant.seq() <= END {
            let during = (FROM..FROM + CYCLES).contains(&plant.seq());
            plant.step(Some(&command(if during { tau } else { 0.0 })));
        }
        (*plant.position(), plant.tau_peak()[3])
    };
    let push = Fault { joint: 3, amount: 20.0, ..Fault::new(FaultKind::ArmTorque, FROM, CYCLES) };
    let ((pushed, shown), (driven, _), (free, _)) = (moved(&[push], 0.0), moved(&[], 20.0), moved(&[], 0.0));
    assert!((driven - free).amax() > 1e-5 && (pushed - driven).amax() < 1e-12, "{:?}", pushed - driven);
    assert_eq!(shown, 0.0, "no drive gives it");
    let half = Fault { amount: 10.0, ..push };
    assert!((moved(&[half, half], 0.0).0 - driven).amax() < 1e-12, "two add up");
}

#[test]
fn frozen_measurements_keep_angles_and_torques() {
    for (seen, truth) in corrupted(FaultKind::FreezeMeasurement, 0, 0.0).0 {
        let first = measurements(None)[FROM as usize];
        assert_eq!(seen, Measurement { q: first.q, tau_measured: first.tau_measured, ..truth });
    }
}

#[test]
fn a_stale_time_stays() {
    let (pairs, first) = corrupted(FaultKind::StaleTime, 0, 0.0);
    for (seen, truth) in pairs {
        assert_eq!(seen, Measurement { t_ns: first.t_ns, ..truth });
    }
}

#[test]
fn one_encoder_is_stuck_jumps_or_dies_and_the_others_do_not() {
    for joint in 0..sizes().joints() {
        let (pairs, first) = corrupted(FaultKind::EncoderStuck, joint, 0.0);
        for (seen, mut truth) in pairs {
            truth.q[joint] = first.q[joint];
            assert_eq!(seen, truth);
        }
        for (seen, mut truth) in corrupted(FaultKind::EncoderJump, joint, -0.25).0 {
            truth.q[joint] -= 0.25;
            assert_eq!(seen, truth);
        }
        for (mut seen, truth) in corrupted(FaultKind::EncoderNan, joint, 0.0).0 {
            assert!(seen.q[joint].is_nan());
            seen.q[joint] = truth.q[joint];
            assert_eq!(seen, truth);
        }
    }
}

#[test]
fn an_encoder_is_as_broken_in_an_old_measurement_whichever_broke_first() {
    let truth = measurements(None);
    let late = Fault { amount: 3.0, ..Fault::new(FaultKind::DelayMeasurement, FROM, 0) };
    let frozen = Fault::new(FaultKind::FreezeMeasurement, FROM, 0);
    let jump = Fault { joint: 4, amount: 0.1, ..Fault::new(FaultKind::EncoderJump, FROM, 0) };
    let orders = [[late, frozen, jump], [jump, frozen, late], [frozen, jump, late]];
    for seen in orders.map(measurements) {
        for seq in FROM + 3..=END {
            let mut expected = truth[seq as usize - 3];
            let held = truth[FROM as usize];
            (expected.q, expected.tau_measured) = (held.q, held.tau_measured);
            expected.q[4] += 0.1;
            assert_eq!(seen[seq as usize], expected, "cycle {seq}");
        }
    }
    // The same for faults that are set in a run.
    for faults in [[late, jump], [jump, late]] {
        let mut plant = Plant::at(&settings(), &level_pose(), &at_rest()).unwrap();
        for fault in faults {
            plant.set_fault(&Fault { from: 1, ..fault }).unwrap();
        }
        (1..10).for_each(|_| plant.step(None));
        let seen = plant.measure();
        plant.clear_faults();
        assert_eq!((seen.seq, seen.q[4]), (plant.seq() - 3, plant.measure().q[4] + 0.1));
    }
}

#[test]
fn lost_commands_leave_the_last_one_in_force_until_the_watchdog_closes_the_brakes() {
    let mut config = settings();
    config.plant.faults.push(Fault::new(FaultKind::LoseCommand, FROM, 30));
    let mut plant = Plant::at(&config, &level_pose(), &at_rest()).unwrap();
    let watchdog = u64::from(config.plant.drive.watchdog_cycles);
    while plant.seq() <= END {
        let seq = plant.seq();
        plant.step(Some(&equal_torques(seq as f64)));
        let lost = (FROM..FROM + 30).contains(&seq);
        let braked = lost && seq - FROM + 1 >= watchdog;
        assert_eq!(plant.brakes_closed(), braked, "cycle {seq}");
        let sent = if lost { FROM - 1 } else { seq } as f64;
        let expected = if braked { 0.0 } else { sent.min(176.0) };
        assert_eq!(plant.measure().tau_measured[2], expected, "cycle {seq}");
    }
}

#[test]
fn a_fault_set_in_a_run_begins_with_the_next_measurement() {
    let mut plant = Plant::at(&settings(), &level_pose(), &at_rest()).unwrap();
    for _ in 0..sizes().joints() {
        plant.step(None);
    }
    let before = plant.measure();
    plant.set_fault(&Fault::new(FaultKind::EncoderNan, 10, 0)).unwrap();
    assert!(plant.measure().q[0].is_nan());
    plant.clear_faults();
    assert_eq!(plant.measure(), before);
    plant.set_fault(&Fault::new(FaultKind::DropMeasurement, 10, 2)).unwrap();
    assert_eq!(plant.measure().seq, 9);
    plant.step(None);
    assert_eq!(plant.measure().seq, 9);
    plant.step(None);
    assert_eq!(plant.measure().seq, 12);
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut plant = Plant::at(&settings(), &level_pose(), &at_rest()).unwrap();
    plant.step(None);
    let fault = Fault::new(FaultKind::EncoderStuck, 2, 0);
    let delay = |amount| Fault { amount, ..Fault::new(FaultKind::DelayMeasurement, 2, 0) };
    let late = f64::from(MAX_DELAY) + 1.0;
    for (bad, error) in [
        (Fault { joint: 9, ..fault }, EventError::Joint { most: 9, got: 10 }),
        (Fault { joint: 7, ..Fault::new(FaultKind::ArmTorque, 2, 0) }, EventError::Joint { most: 7, got: 8 }),
        (Fault::new(FaultKind::ArmTorque, 2, 0), EventError::Torque { got: 0.0 }),
        (Fault { amount: f64::INFINITY, ..fault }, EventError::Amount { got: f64::INFINITY }),
        (delay(0.0), EventError::Delay { got: 0.0 }),
        (delay(1.5), EventError::Delay { got: 1.5 }),
        (delay(late), EventError::Delay { got: late }),
    ] {
        assert_eq!(plant.set_fault(&bad), Err(SetEventError::Impossible(error)));
    }
    let past = Err(SetEventError::Past { next: 2, got: 1 });
    assert_eq!(plant.set_fault(&Fault { from: 1, ..fault }), past);
    assert_eq!(plant.push(&Push { from: 1, cycles: 1, impulse: [0.0; 3] }), past);
    let push = Push { from: 2, cycles: 1, impulse: [0.0; 3] };
    assert_eq!(plant.push(&Push { cycles: 0, ..push }), Err(EventError::Duration.into()));
    let accepted = (0..1000).take_while(|_| plant.set_fault(&fault).is_ok()).count();
    assert_eq!(plant.set_fault(&fault), Err(SetEventError::TooMany));
    assert!((1..1000).contains(&accepted));
    plant.clear_faults();
    // Faults that have ended make room.
    for _ in 0..2 * accepted {
        plant.set_fault(&Fault { from: plant.seq(), cycles: 1, ..fault }).unwrap();
        plant.push(&Push { from: plant.seq(), ..push }).unwrap();
        plant.step(None);
    }
}
