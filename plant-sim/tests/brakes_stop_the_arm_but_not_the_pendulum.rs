//! Closed brakes stop the arm exponentially and hold it; the pendulum keeps swinging and reacts to the deceleration.

mod common;

use common::{at_rest, brake, equal_torques, frictionless, level_pose, settings, sizes};
use upswing_model::{ActuatedVector, JointVector, Period, Workspace};
use upswing_plant::Plant;

#[test]
fn the_arm_stops_with_its_time_constant_and_the_pendulum_swings_on() {
    let config = settings();
    let mut qd = at_rest();
    qd.actuated_mut().copy_from_slice(&ActuatedVector::from_fn(sizes(), |i| 0.1 * (i as f64 + 1.0)));
    let time_constant = config.plant.drive.brake_time_constant;
    let mut plant = Plant::at(&config, &level_pose(), &qd).unwrap();
    for _ in 0..80 {
        plant.step(Some(&brake()));
    }
    let decay = (-80.0 * 125e-6 / time_constant).exp();
    for i in 0..sizes().actuated() {
        assert!((plant.velocity()[i] - qd[i] * decay).abs() < 1e-9, "joint {}", i + 1);
    }
    for _ in 0..1_200 {
        plant.step(None);
    }
    let stopped = *plant.position();
    for i in 0..sizes().actuated() {
        assert_eq!(plant.velocity()[i], 0.0);
        let way = stopped[i] - level_pose()[i];
        assert!((way - qd[i] * time_constant).abs() < 1e-6, "joint {}: {way} rad", i + 1);
    }
    let mut swing = 0.0_f64;
    for _ in 0..1_600 {
        plant.step(None);
        swing = swing.max(plant.velocity()[7].abs());
    }
    assert!(swing > 0.1, "the stop has set the pendulum in motion: {swing} rad/s");
    assert_eq!(plant.position().actuated(), stopped.actuated(), "and the arm stays exactly");
}

#[test]
fn a_pendulum_at_rest_stays_at_rest() {
    let mut plant = Plant::new(&settings()).unwrap();
    let start = *plant.position();
    for _ in 0..1_600 {
        plant.step(None);
    }
    assert!((plant.position() - start).amax() < 1e-9);
}

#[test]
fn friction_is_the_torque_that_the_settings_state() {
    // One period of two plants that differ in friction only: M (qdd' - qdd) = -friction.
    for compensation in [0.0, 0.75] {
        let mut with = settings();
        with.plant.friction.compensation = compensation;
        let mut without = frictionless();
        // So short that the change of velocity affects neither friction nor Coriolis torques.
        let period = Period::from_micros(2);
        with.daemon.cycle.period = period;
        without.daemon.cycle.period = period;
        let qd = JointVector::from_fn(sizes(), |i| if i % 2 == 0 { 0.3 } else { -0.2 });
        let f = &with.plant.friction;
        let felt = |friction: &JointVector| {
            JointVector::joined(&(friction.actuated() * (1.0 - compensation)), &friction.unactuated())
        };
        let (viscous, coulomb) = (felt(&f.viscous), felt(&f.coulomb));
        let expected = JointVector::from_fn(sizes(), |i| {
            -(viscous[i] * qd[i] + coulomb[i] * (qd[i] / f.coulomb_smoothing).tanh())
        });
        let next = |config| {
            let mut plant = Plant::at(config, &level_pose(), &qd).unwrap();
            plant.step(Some(&equal_torques(0.0)));
            *plant.velocity()
        };
        let mass = with.model.mass_matrix(&level_pose(), &mut Workspace::default());
        let got = &mass * &((next(&with) - next(&without)) / period.seconds());
        for i in 0..sizes().joints() {
            let tolerance = 0.02 * expected[i].abs() + 1e-4;
            assert!(
                (got[i] - expected[i]).abs() < tolerance,
                "joint {}: {} N m, not {}",
                i + 1,
                got[i],
                expected[i]
            );
        }
    }
}

#[test]
fn braked_friction_takes_energy_from_the_pendulum_only() {
    let config = settings();
    let mut q = level_pose();
    q[7] = 0.5;
    let mut plant = Plant::at(&config, &q, &at_rest()).unwrap();
    let mut last = common::energy(&config.model, &plant);
    for _ in 0..10 {
        for _ in 0..100 {
            plant.step(None);
        }
        let now = common::energy(&config.model, &plant);
        assert!(now < last);
        last = now;
    }
}
