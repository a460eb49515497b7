//! Commands have the set delay, torques the lag of the loop, sensors their offset; watchdog and brakes take their set
//! times.

mod common;

use common::{
    at_rest, brake, equal_torques, frictionless, level_pose, measured_torque, settings, sizes, torque,
};
use upswing_config::Config;
use upswing_ipc::Measurement;
use upswing_model::ActuatedVector;
use upswing_plant::Plant;

fn plant(config: &Config) -> Plant {
    Plant::at(config, &level_pose(), &at_rest()).unwrap()
}

/// An offset of each torque sensor, N m.
fn offset() -> ActuatedVector {
    ActuatedVector::from_slice(sizes(), &[0.5, -0.25, 0.125, 1.0, -0.5, 0.25, -0.125]).unwrap()
}

#[test]
fn a_command_acts_after_its_delay() {
    for delay in [0, 1, 8, 63] {
        let mut config = settings();
        config.plant.drive.command_delay = delay;
        let mut plant = plant(&config);
        for k in 0..150_u32 {
            plant.step(Some(&equal_torques(f64::from(k))));
            let measured = plant.measure();
            assert_eq!(plant.brakes_closed(), k < delay, "delay {delay}, cycle {k}");
            if k >= delay {
                let expected = f64::from(k - delay).min(config.robot.limits.tau_max[0]);
                assert_eq!(measured.tau_measured[0], expected, "delay {delay}, cycle {k}");
            }
        }
    }
}

#[test]
fn the_torque_approaches_its_command_exponentially() {
    let mut config = settings();
    config.plant.drive.torque_lag = 0.001;
    let mut plant = plant(&config);
    // With closed brakes the torque loop settles, so that the first torque acts without lag.
    plant.step(Some(&equal_torques(2.0)));
    assert!(measured_torque(&plant).iter().all(|tau| *tau == 2.0));
    for k in 1..80 {
        plant.step(Some(&equal_torques(10.0)));
        let expected = 10.0 - 8.0 * (-f64::from(k) * 125e-6 / 1e-3).exp();
        let got = plant.measure().tau_measured[3];
        assert!((got - expected).abs() < 1e-12, "cycle {k}: {got} N m, expected {expected}");
    }
}

#[test]
fn closed_brakes_show_their_load_less_the_offset_while_the_arm_stands() {
    let mut config = settings();
    let offset = offset();
    config.plant.drive.torque_offset = offset;
    let mut plant = plant(&config);
    let load = common::holding_torque(&config.plant_model, &plant);
    let sensed = |plant: &Plant| plant.measure().status & Measurement::LOAD_SENSED != 0;
    for _ in 0..10 {
        let shown = plant.measure().tau_measured;
        for i in 0..sizes().actuated() {
            let error = shown[i] - (load[i] - offset[i]);
            assert!(sensed(&plant) && error.abs() < 1e-3, "joint {}: {error} N m", i + 1);
        }
        plant.step(Some(&brake()));
    }
    plant.step(Some(&equal_torques(1.0)));
    assert!(!sensed(&plant), "brakes are open");
    plant.step(Some(&brake()));
    assert!(plant.brakes_closed() && !sensed(&plant), "the arm still moves");
    assert!(measured_torque(&plant).iter().all(|tau| *tau == 0.0));
    for _ in 0..8000 {
        plant.step(Some(&brake()));
    }
    assert!(sensed(&plant), "it stands");
}

#[test]
fn an_offset_moves_the_arm_but_not_the_sensor() {
    let offset = offset();
    let mut config = settings();
    let mut without = plant(&config);
    config.plant.drive.torque_offset = offset;
    let mut with = plant(&config);
    for _ in 0..100 {
        with.step(Some(&equal_torques(1.0)));
        without.step(Some(&torque(&offset.map(|offset| 1.0 + offset))));
        assert_eq!(with.position(), without.position());
        assert!(measured_torque(&with).iter().all(|tau| *tau == 1.0));
    }
}

#[test]
fn silence_closes_the_brakes_after_the_watchdogs_time() {
    let config = settings();
    let cycles = config.plant.drive.watchdog_cycles;
    let (mut silent, mut twin) = (plant(&config), plant(&config));
    for round in 0..3 {
        silent.step(Some(&equal_torques(3.0)));
        twin.step(Some(&equal_torques(3.0)));
        for k in 1..cycles {
            silent.step(None);
            twin.step(Some(&equal_torques(3.0)));
            assert!(!silent.brakes_closed(), "round {round}, silent for {k}");
            assert_eq!(silent.position(), twin.position(), "the last command stays in force");
        }
        silent.step(None);
        twin.step(Some(&brake()));
        assert!(silent.brakes_closed(), "round {round}");
        assert_eq!(silent.position(), twin.position());
    }
}

#[test]
fn brakes_hold_after_their_time_and_the_arm_is_free_until_then() {
    let mut config = frictionless();
    config.plant.drive.brake_engage = 0.01;
    let (mut late, mut free) = (plant(&config), plant(&config));
    for plant in [&mut late, &mut free] {
        plant.step(Some(&equal_torques(0.0)));
    }
    for k in 0..80 {
        late.step(Some(&brake()));
        free.step(Some(&equal_torques(0.0)));
        assert_eq!(late.measure().status, Measurement::DRIVES_READY, "cycle {k}: they do not hold yet");
        assert_eq!(late.position(), free.position());
    }
    let before = late.velocity().actuated().norm();
    assert!(before > 0.01, "it falls with {before} rad/s");
    late.step(Some(&brake()));
    assert_eq!(late.measure().status, Measurement::DRIVES_READY | Measurement::BRAKES_CLOSED);
    for _ in 0..800 {
        late.step(Some(&brake()));
    }
    assert!(late.velocity().actuated().norm() < 1e-3 * before);
}
