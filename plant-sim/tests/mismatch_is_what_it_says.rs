//! The effects of rod length, payload, rotors, stops and pushes agree with independent computations.

mod common;

use common::{at_rest, energy, equal_torques, frictionless, level_pose, sizes, torque};
use upswing_config::{Config, Push};
use upswing_model::{ActuatedVector, JointMatrix, JointVector, Model, Period, Workspace};
use upswing_plant::Plant;

fn pose() -> JointVector {
    level_pose() + JointVector::from_fn(sizes(), |i| 0.3 * (1.3 * i as f64).sin())
}

/// Velocity of `point` at (q, qd) by central differences, m/s.
fn velocity_of(point: impl Fn(&JointVector) -> [f64; 3], q: &JointVector, qd: &JointVector) -> [f64; 3] {
    let h = 1e-5;
    let (after, before) = (point(&(q + qd * h)), point(&(q - qd * h)));
    std::array::from_fn(|i| (after[i] - before[i]) / (2.0 * h))
}

/// Accelerations qdd, rad/s^2: velocities after one period, divided by the period, which is so short that positions do not change.
fn acceleration(config: &Config, tau: &ActuatedVector) -> JointVector {
    let mut config = config.clone();
    config.daemon.cycle.period = Period::from_micros(1);
    let mut plant = Plant::at(&config, &pose(), &at_rest()).unwrap();
    plant.step(Some(&torque(tau)));
    *plant.velocity() / 1e-6
}

fn mass_matrix(model: &Model) -> JointMatrix {
    model.mass_matrix(&pose(), &mut Workspace::default())
}

#[test]
fn the_defaults_change_nothing_about_the_bodies() {
    let config = Config::embedded().unwrap();
    assert_eq!(Plant::model(&config).fingerprint(), config.model.fingerprint());
}

#[test]
fn a_longer_rod_has_its_tip_and_its_gravity_farther_out() {
    let mut config = frictionless();
    let short = Plant::model(&config);
    config.plant.model.unactuated_length_scale = 1.2;
    let long = Plant::model(&config);
    let (q, work) = (pose(), &mut Workspace::default());
    let joint = short.poses(&q)[8].translation.vector;
    assert!((long.tip(&q) - joint - (short.tip(&q) - joint) * 1.2).norm() < 1e-12);
    // About joint 9 the gravity torque is proportional to the length of the rod, and the inertia to its square.
    let (g_short, g_long) = (short.gravity_torque(&q, work)[8], long.gravity_torque(&q, work)[8]);
    assert!((g_long - 1.2 * g_short).abs() < 1e-12 && g_short.abs() > 0.01);
    let (j_short, j_long) = (mass_matrix(&short)[(8, 8)], mass_matrix(&long)[(8, 8)]);
    assert!((j_long - 1.44 * j_short).abs() < 1e-12);
}

#[test]
fn masses_scale_energies() {
    let mut config = frictionless();
    config.plant.model.actuated_mass_scale = 1.1;
    config.plant.model.unactuated_mass_scale = 1.1;
    let heavy = Plant::model(&config);
    assert!((mass_matrix(&heavy) - mass_matrix(&config.model) * 1.1).amax() < 1e-12);
}

#[test]
fn a_payload_adds_the_energy_of_a_point_mass() {
    let mut config = frictionless();
    let (mass, place) = (0.7, [0.02, -0.03, 0.1]);
    (config.plant.model.payload, config.plant.model.payload_position) = (mass, place);
    let (with, without) = (Plant::model(&config), &config.model);
    let point = |q: &JointVector| -> [f64; 3] {
        let flange = without.poses(q)[6];
        (flange * nalgebra::Point3::from(place)).into()
    };
    let q = pose();
    let weight = mass * 9.81 * point(&q)[2];
    assert!((with.potential_energy(&q) - without.potential_energy(&q) - weight).abs() < 1e-10);
    let qd = JointVector::from_fn(sizes(), |i| 0.4 * (0.7 * i as f64).cos());
    let kinetic = 0.5 * mass * velocity_of(point, &q, &qd).iter().map(|v| v * v).sum::<f64>();
    let got = 0.5 * qd.dot(&(&(mass_matrix(&with) - mass_matrix(without)) * &qd));
    assert!((got - kinetic).abs() < 1e-7 * kinetic, "{got} J, expected {kinetic}");
}

#[test]
fn rotors_add_to_the_inertia_of_their_joints() {
    let mut config = frictionless();
    let rotors = [10.0, 9.0, 5.0, 4.0, 1.5, 0.5, 0.4];
    config.plant.model.rotor_inertia.copy_from_slice(&rotors);
    let tau = ActuatedVector::from_slice(sizes(), &[5.0, -60.0, 3.0, 20.0, -1.0, 2.0, 0.2]).unwrap();
    let mut inertia = mass_matrix(&config.model);
    for (i, rotor) in rotors.iter().enumerate() {
        inertia[(i, i)] += rotor;
    }
    let mut load = at_rest();
    load.actuated_mut().copy_from_slice(&tau);
    let force = load - config.model.gravity_torque(&pose(), &mut Workspace::default());
    let residual = &inertia * &acceleration(&config, &tau) - force;
    assert!(residual.amax() < 1e-4, "{residual:?}");
}

#[test]
fn a_push_changes_the_momentum_by_its_impulse() {
    // The work of an impulse on a body that moves with v is impulse . v, along every direction of motion.
    let config = frictionless();
    let q = pose();
    let impulse = [0.02, -0.01, 0.03];
    let mut plant = Plant::at(&config, &q, &at_rest()).unwrap();
    let mut twin = plant.clone();
    // So short that the positions do not change.
    plant.push(&Push { from: 1, cycles: 2, impulse }).unwrap();
    for plant in [&mut plant, &mut twin] {
        for _ in 0..2 {
            plant.step(Some(&equal_torques(0.0)));
        }
    }
    let momentum = &mass_matrix(&config.model) * &(plant.velocity() - twin.velocity());
    for i in 0..sizes().joints() {
        let mut along = at_rest();
        along[i] = 1.0;
        let v = velocity_of(|q| config.model.tip(q).into(), &q, &along);
        let expected: f64 = (0..3).map(|k| impulse[k] * v[k]).sum();
        assert!(
            (momentum[i] - expected).abs() < 2e-5,
            "joint {}: {} N m s, not {expected}",
            i + 1,
            momentum[i]
        );
    }
    let (pushed, free) = (plant.velocity()[8], twin.velocity()[8]);
    for plant in [&mut plant, &mut twin] {
        plant.step(None);
    }
    let still = (plant.velocity()[8] - twin.velocity()[8]) - (pushed - free);
    assert!(still.abs() < 0.02 * (pushed - free).abs(), "after its time it is over");
}

#[test]
fn stops_turn_the_rod_back_and_add_no_energy() {
    let mut config = frictionless();
    config.use_scenario("joint-stops").unwrap();
    config.plant.friction.viscous.unactuated_mut().fill(0.0);
    config.plant.friction.coulomb.unactuated_mut().fill(0.0);
    let stop = config.plant.stops.q_max[8];
    let mut q = level_pose();
    q[8] = 0.7;
    let mut qd = at_rest();
    qd[8] = 3.0;
    let mut plant = Plant::at(&config, &q, &qd).unwrap();
    let start = energy(&config.model, &plant);
    let (mut farthest, mut backwards) = (0.0_f64, 0.0_f64);
    for _ in 0..8_000 {
        plant.step(None);
        farthest = farthest.max(plant.position()[8].abs());
        backwards = backwards.min(plant.velocity()[8]);
        let beyond = (plant.position()[8].abs() - stop).max(0.0);
        let stored = 0.5 * config.plant.stops.stiffness[8] * beyond * beyond;
        assert!(energy(&config.model, &plant) + stored < start + 1e-6, "cycle {}", plant.seq());
    }
    assert!(farthest > stop, "it reaches the stop");
    assert!(farthest < stop + 0.06, "and goes {} rad past it", farthest - stop);
    assert!(backwards < -1.0, "it comes back with {backwards} rad/s");
}

#[test]
fn stops_hold_an_arm_that_is_pressed_against_them() {
    let mut config = frictionless();
    config.use_scenario("joint-stops").unwrap();
    for joint in 0..sizes().actuated() {
        let stop = config.plant.stops.q_max[joint];
        let mut q = level_pose();
        q[joint] = stop - 0.05;
        let mut plant = Plant::at(&config, &q, &at_rest()).unwrap();
        let mut tau = common::holding_torque(&config.model, &plant);
        tau[joint] += 0.25 * config.robot.limits.tau_max[joint];
        let mut farthest = f64::NEG_INFINITY;
        for _ in 0..4_000 {
            plant.step(Some(&torque(&tau)));
            farthest = farthest.max(plant.position()[joint]);
        }
        assert!(farthest > stop, "joint {}: it reaches the stop", joint + 1);
        assert!(farthest < stop + 0.1, "joint {}: {} rad past the stop", joint + 1, farthest - stop);
    }
}
