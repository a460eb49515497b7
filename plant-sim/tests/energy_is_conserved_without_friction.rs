//! Without friction, brakes and drives the integration conserves the energy.

mod common;

use common::{at_rest, energy, equal_torques, frictionless, level_pose};
use upswing_model::Period;
use upswing_plant::Plant;

#[test]
fn a_pendulum_on_a_braked_arm_keeps_its_energy_for_ten_seconds() {
    let mut config = frictionless();
    // Eight times the real period: at the real period the drift is too small to measure.
    config.daemon.cycle.period = Period::from_micros(1000);
    let mut plant = Plant::at(&config, &level_pose(), &at_rest()).unwrap();
    let lowest = energy(&config.model, &plant);
    let mut q = level_pose();
    (q[7], q[8]) = (1.2, 0.3);
    plant.reset(&q, &at_rest()).unwrap();
    let of_swing = energy(&config.model, &plant) - lowest;
    assert!(of_swing > 0.3, "a swing of {of_swing} J is none");

    let mut speed: f64 = 0.0;
    let mut drift: f64 = 0.0;
    for _ in 0..10_000 {
        plant.step(None);
        speed = speed.max(plant.velocity()[7].abs());
        if plant.seq().is_multiple_of(25) {
            drift = drift.max((energy(&config.model, &plant) - lowest - of_swing).abs() / of_swing);
        }
    }
    assert!(speed > 5.0, "the pendulum swings: {speed} rad/s");
    assert!(drift < 1e-8, "relative drift {drift:e}");
    assert_eq!(plant.position().actuated(), level_pose().actuated(), "the arm stood still");
}

#[test]
fn the_whole_robot_keeps_its_energy_in_ten_seconds_of_free_fall() {
    let mut config = frictionless();
    // In this motion light joints reach twenty times their velocity limits.
    config.plant.integrator.substeps = 2;
    let mut q = level_pose();
    (q[1], q[5], q[7]) = (0.4, 0.3, 1.0);
    let mut plant = Plant::at(&config, &q, &at_rest()).unwrap();
    let before = energy(&config.model, &plant);
    let (mut drift, mut kinetic): (f64, f64) = (0.0, 0.0);
    for _ in 0..80_000 {
        plant.step(Some(&equal_torques(0.0)));
        if plant.seq().is_multiple_of(16) {
            drift = drift.max((energy(&config.model, &plant) - before).abs());
            kinetic = kinetic.max(before - config.model.potential_energy(plant.position()));
        }
    }
    println!("largest drift {drift:e} J, largest kinetic energy {kinetic} J");
    assert!(kinetic > 10.0, "it falls: {kinetic} J");
    assert!(drift < 1e-8 * kinetic, "drift {drift:e} J of {kinetic} J");
}
