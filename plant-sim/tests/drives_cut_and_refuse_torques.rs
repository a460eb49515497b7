//! Drives limit torques to their limits, report saturation, and go into fault on a command that is not finite.

mod common;

use common::{
    at_rest, brake, equal_torques, holding_torque, level_pose, measured_torque, settings, sizes, torque,
};
use upswing_ipc::{Command, Measurement};
use upswing_model::{ActuatedVector, JointVector, Sizes, StartError};
use upswing_plant::{Plant, StateError};

fn plant() -> Plant {
    Plant::at(&settings(), &level_pose(), &at_rest()).unwrap()
}

#[test]
fn a_torque_above_the_limit_is_cut_and_reported() {
    let max = settings().robot.limits.tau_max;
    for i in 0..sizes().actuated() {
        for sign in [1.0, -1.0] {
            let (mut cut, mut same) = (plant(), plant());
            let mut tau = ActuatedVector::zeros(sizes());
            tau[i] = sign * max[i];
            same.step(Some(&torque(&tau)));
            assert_eq!(same.measure().status, Measurement::DRIVES_READY, "the limit itself is not cut");
            tau[i] *= 1.5;
            cut.step(Some(&torque(&tau)));
            assert_eq!(cut.measure().status, Measurement::DRIVES_READY | Measurement::SATURATED);
            assert_eq!(cut.measure().tau_measured[i], sign * max[i]);
            assert_eq!(cut.tau_peak()[i], max[i]);
            assert_eq!(cut.velocity(), same.velocity());
            cut.step(Some(&equal_torques(0.0)));
            assert_eq!(cut.measure().status, Measurement::DRIVES_READY, "only the last command counts");
            assert_eq!(cut.tau_peak()[i], max[i], "the peak stays");
        }
    }
}

#[test]
fn a_torque_that_is_no_number_closes_the_brakes_until_they_are_commanded() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for i in 0..sizes().actuated() {
            let mut plant = plant();
            plant.step(Some(&equal_torques(0.0)));
            assert!(!plant.brakes_closed());
            let mut tau = ActuatedVector::repeat(sizes(), 1.0);
            tau[i] = bad;
            let faulted = Measurement::BRAKES_CLOSED | Measurement::DRIVE_FAULT;
            for command in [torque(&tau), equal_torques(1.0), equal_torques(1.0)] {
                plant.step(Some(&command));
                let measured = plant.measure();
                assert_eq!(measured.status, faulted);
                assert!(measured_torque(&plant).iter().all(|tau| *tau == 0.0));
            }
            assert!(plant.position().iter().chain(plant.velocity().iter()).all(|v| v.is_finite()));

            plant.step(None);
            assert_eq!(plant.measure().status, faulted, "silence acknowledges nothing");
            plant.step(Some(&brake()));
            assert_eq!(plant.measure().status, Measurement::BRAKES_CLOSED | Measurement::DRIVES_READY);
            plant.step(Some(&equal_torques(1.0)));
            assert_eq!(plant.measure().status, Measurement::DRIVES_READY);
        }
    }
}

#[test]
fn a_command_for_another_chain_closes_the_brakes_until_they_are_commanded() {
    for (joints, actuated) in [(0, 0), (9, 6), (16, 7), (u64::MAX, u64::MAX)] {
        let mut plant = plant();
        plant.step(Some(&equal_torques(0.0)));
        assert!(!plant.brakes_closed());
        plant.step(Some(&Command { joints, actuated, ..equal_torques(1.0) }));
        let faulted = Measurement::BRAKES_CLOSED | Measurement::DRIVE_FAULT;
        assert_eq!(plant.measure().status, faulted, "{joints} joints, {actuated} of them actuated");
        plant.step(Some(&brake()));
        assert_eq!(plant.measure().status, Measurement::BRAKES_CLOSED | Measurement::DRIVES_READY);
    }
}

#[test]
fn any_brake_code_but_zero_closes_the_brakes() {
    for brake in [1, 2, u64::MAX] {
        let mut plant = plant();
        plant.step(Some(&equal_torques(0.0)));
        assert!(!plant.brakes_closed());
        plant.step(Some(&Command { brake, ..equal_torques(5.0) }));
        assert!(plant.brakes_closed());
        assert!(measured_torque(&plant).iter().all(|tau| *tau == 0.0));
    }
}

#[test]
fn the_torque_law_holds_the_arm() {
    let config = settings();
    let mut plant = plant();
    let start = *plant.position();
    for _ in 0..800 {
        let tau = holding_torque(&config.model, &plant);
        plant.step(Some(&torque(&tau)));
    }
    assert!((plant.position() - start).amax() < 1e-6, "{:?}", plant.position() - start);
}

#[test]
fn a_reset_needs_closed_brakes_and_a_possible_state() {
    let mut plant = plant();
    let (q, qd) = (level_pose(), at_rest());
    plant.step(Some(&equal_torques(9.0)));
    assert_eq!(plant.reset(&q, &qd), Err(StateError::BrakesReleased));
    plant.step(Some(&brake()));
    let before = *plant.position();
    let name = |i: usize| settings().model.joint_name(i).to_owned();
    for (i, value) in [(3, f64::NAN), (3, 2.2), (8, 0.8), (7, -3.6)] {
        let mut bad = q;
        bad[i] = value;
        assert!(
            matches!(plant.reset(&bad, &qd), Err(StateError::Position(StartError::NotFinite { joint, .. } | StartError::OutsideLimits { joint, .. })) if joint == name(i))
        );
    }
    for (i, value) in [(0, f64::INFINITY), (0, 1.6), (8, -3.2)] {
        let mut bad = qd;
        bad[i] = value;
        assert!(matches!(plant.reset(&q, &bad), Err(StateError::Velocity { joint, .. }) if joint == name(i)));
    }
    let other = JointVector::zeros(Sizes::new(9, 6).unwrap());
    assert!(matches!(plant.reset(&other, &qd), Err(StateError::OtherChain { .. })));
    assert_eq!(*plant.position(), before, "a refused reset changes nothing");
    assert_eq!(plant.tau_peak()[0], 9.0);
    plant.reset(&q, &qd).unwrap();
    assert_eq!((*plant.position(), *plant.velocity()), (q, qd));
    assert_eq!(plant.tau_peak()[0], 0.0);
    assert_eq!(plant.seq(), 3, "cycles go on");
}
