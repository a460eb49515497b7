//! Small free swings on a braked arm are those of the linear oscillator that the model states.

mod common;

use common::{frictionless, level_pose};
use std::time::Duration;
use upswing_config::Config;
use upswing_model::{JointVector, Model, N_ACTUATED, Workspace};
use upswing_plant::Plant;

/// sqrt(stiffness of g_U / M_UU) of one joint of the pendulum at rest, rad/s.
fn natural_frequency(model: &Model, joint: usize) -> f64 {
    let work = &mut Workspace::default();
    let delta = 1e-5;
    let mut q = level_pose();
    let mass = model.mass_matrix(&q, work);
    assert!(mass[(7, 8)].abs() < 1e-12, "at rest the two joints do not act on each other");
    q[joint] = delta;
    let above = model.gravity_torque(&q, work)[joint];
    q[joint] = -delta;
    let below = model.gravity_torque(&q, work)[joint];
    ((above - below) / (2.0 * delta) / mass[(joint, joint)]).sqrt()
}

/// 2 pi over the time between the first and the last fall through zero, rad/s.
fn swing_frequency(config: &Config, joint: usize) -> f64 {
    let mut config = config.clone();
    config.daemon.cycle.period = Duration::from_millis(1);
    let mut q = level_pose();
    q[joint] = 0.01;
    let mut plant = Plant::at(&config, &q, &JointVector::zeros()).unwrap();
    let period = plant.period_ns() as f64 * 1e-9;
    let mut falls = Vec::new();
    for k in 0..5_000 {
        let before = plant.position()[joint];
        plant.step(None);
        let after = plant.position()[joint];
        if before > 0.0 && after <= 0.0 {
            falls.push((f64::from(k) + before / (before - after)) * period);
        }
    }
    let swings = falls.len() - 1;
    assert!(swings >= 3, "it swings");
    std::f64::consts::TAU * swings as f64 / (falls[swings] - falls[0])
}

#[test]
fn both_joints_swing_with_their_natural_frequency() {
    let config = frictionless();
    for joint in N_ACTUATED..=8 {
        let expected = natural_frequency(&config.model, joint);
        let got = swing_frequency(&config, joint);
        assert!((got / expected - 1.0).abs() < 2e-5, "joint {}: {got} rad/s, expected {expected}", joint + 1);
    }
}

#[test]
fn the_rod_swings_like_a_uniform_rod_of_half_a_metre() {
    // sqrt(m g l / J) with m = 0.25 kg, l = 0.25 m, J = 0.0052 + m l^2 of the shipped description.
    let (mass, lever) = (0.25_f64, 0.25_f64);
    let expected = (mass * 9.81 * lever / (0.0052 + mass * lever * lever)).sqrt();
    let got = swing_frequency(&frictionless(), 8);
    assert!((got / expected - 1.0).abs() < 1e-3, "{got} rad/s, expected {expected}");
}
