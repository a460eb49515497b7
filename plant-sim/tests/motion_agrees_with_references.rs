//! The simulated motion agrees with the closed-form period of a pendulum and with an integrator of high order.

mod common;

use common::{at_rest, frictionless, level_pose, sizes, torque};
use upswing_config::Config;
use upswing_model::{JointVector, Model, State, Workspace};
use upswing_plant::Plant;

/// Ratio of the period of a pendulum to that of small swings: 1 / agm(1, cos(amplitude / 2)); amplitude in rad.
fn slowing(amplitude: f64) -> f64 {
    let (mut a, mut g) = (1.0_f64, (0.5 * amplitude).cos());
    while (a - g).abs() > 1e-15 {
        (a, g) = (0.5 * (a + g), (a * g).sqrt());
    }
    1.0 / a
}

/// sqrt(m g l / J) of one joint of the hanging pendulum, rad/s: m g l is the torque of gravity a quarter turn away.
fn small_swing_frequency(model: &Model, joint: usize) -> f64 {
    let work = &mut Workspace::default();
    let inertia = model.mass_matrix(&level_pose(), work)[(joint, joint)];
    let mut q = level_pose();
    q[joint] = std::f64::consts::FRAC_PI_2;
    (model.gravity_torque(&q, work)[joint] / inertia).sqrt()
}

/// Mean period of the swings of one joint in ten seconds, s; the arm is braked.
fn swing_period(config: &Config, joint: usize, amplitude: f64) -> f64 {
    let mut q = level_pose();
    q[joint] = amplitude;
    let mut plant = Plant::at(config, &q, &at_rest()).unwrap();
    let h = plant.period().seconds();
    let mut falls = Vec::new();
    for k in 0..80_000 {
        let before = plant.position()[joint];
        plant.step(None);
        let after = plant.position()[joint];
        if before > 0.0 && after <= 0.0 {
            falls.push((f64::from(k) + before / (before - after)) * h);
        }
    }
    (falls[falls.len() - 1] - falls[0]) / (falls.len() - 1) as f64
}

#[test]
fn large_swings_have_the_period_of_the_elliptic_integral() {
    let config = frictionless();
    for (joint, amplitude) in [(7, 0.5), (7, 1.5), (7, 2.6), (7, 3.1), (8, 0.2), (8, 0.75)] {
        let frequency = small_swing_frequency(&config.model, joint);
        let expected = std::f64::consts::TAU / frequency * slowing(amplitude);
        let got = swing_period(&config, joint, amplitude);
        println!(
            "joint {}, {amplitude} rad: {got} s, relative error {:.1e}",
            joint + 1,
            got / expected - 1.0
        );
        assert!(
            (got / expected - 1.0).abs() < 1e-10,
            "joint {}, {amplitude} rad: {got} s, {expected}",
            joint + 1
        );
    }
}

#[test]
fn the_rod_swings_like_a_uniform_rod_of_half_a_metre() {
    // sqrt(J / (m g l)) with m = 0.25 kg, l = 0.25 m, J = 0.0052 + m l^2 of the shipped description.
    let (mass, lever) = (0.25_f64, 0.25_f64);
    let small = std::f64::consts::TAU * ((0.0052 + mass * lever * lever) / (mass * 9.81 * lever)).sqrt();
    let got = swing_period(&frictionless(), 8, 0.3);
    assert!((got / (small * slowing(0.3)) - 1.0).abs() < 1e-10, "{got} s");
}

/// State derivative of the arm without brakes under joint torques `tau` (N m).
fn free(model: &Model, x: &State, tau: &JointVector, work: &mut Workspace) -> State {
    let (q, qd) = (x.q(), x.qd());
    State::new(&qd, &model.forward_dynamics(&q, &qd, tau, work).unwrap())
}

/// Gragg's modified midpoint rule with Richardson extrapolation in the square of the step: order 12.
fn extrapolated(model: &Model, x: &State, tau: &JointVector, h: f64, work: &mut Workspace) -> State {
    const STEPS: [usize; 6] = [2, 4, 6, 8, 10, 12];
    let mut table: Vec<State> = Vec::new();
    for (k, n) in STEPS.into_iter().enumerate() {
        let step = h / n as f64;
        let (mut before, mut now) = (*x, x + free(model, x, tau, work) * step);
        for _ in 1..n {
            (before, now) = (now, before + free(model, &now, tau, work) * (2.0 * step));
        }
        let mut row = (now + before + free(model, &now, tau, work) * step) * 0.5;
        for j in 0..k {
            let ratio = (n as f64 / STEPS[k - 1 - j] as f64).powi(2);
            let better = row + (row - table[j]) / (ratio - 1.0);
            table[j] = row;
            row = better;
        }
        table.push(row);
    }
    table[STEPS.len() - 1]
}

#[test]
fn one_second_under_changing_torques_agrees_with_order_twelve() {
    let mut config = frictionless();
    // A joint turns by 47 rad in this second, far beyond its limits.
    config.plant.integrator.substeps = 2;
    let mut q = level_pose();
    (q[7], q[8]) = (0.5, -0.3);
    let qd = JointVector::from_fn(sizes(), |i| 0.05 * (i as f64 - 4.0));
    let mut plant = Plant::at(&config, &q, &qd).unwrap();
    let mut x = State::new(&q, &qd);
    let (h, work) = (plant.period().seconds(), &mut Workspace::default());
    let holding = config.model.gravity_torque(&q, work);
    for k in 0..8_000 {
        let t = f64::from(k) * h;
        let mut tau = at_rest();
        for (i, tau) in tau.actuated_mut().iter_mut().enumerate() {
            *tau = holding[i]
                + 0.1 * (7.0 * t + i as f64).sin() * config.robot.limits.tau_max[i] / (2.0 + i as f64);
        }
        plant.step(Some(&torque(&tau.actuated())));
        x = extrapolated(&config.model, &x, &tau, h, work);
    }
    let (moved, error) = ((x.q() - q).amax(), (State::new(plant.position(), plant.velocity()) - x).amax());
    println!("moved by {moved} rad, differs by {error:e} rad or rad/s");
    assert!(moved > 0.3);
    assert!(error < 1e-8, "{error:e} rad or rad/s");
}
