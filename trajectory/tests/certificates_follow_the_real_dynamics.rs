//! The figures of a certificate are those of the trajectory; its end error comes from an integrator that shares no code
//! with the trapezoidal rule and finds the end that another one finds. What no integrator can follow has none.

use upswing_model::{ActuatedVector, JointVector, Model, State, Workspace};
use upswing_trajectory::{Certificate, Gains, Trajectory, end_error, open_loop_end};

const N: usize = 100;

fn robot() -> Model {
    Model::from_urdf(include_str!("../../config/systems/iiwa-pendulum/robot.urdf"))
        .expect("the shipped robot")
}

/// Joint 1 swings about the vertical, with the pendulum hanging in the plane of its axis.
fn motion(model: &Model) -> Trajectory {
    let sizes = model.sizes();
    let mut q = JointVector::zeros(sizes);
    (q[1], q[3], q[5]) = (0.2, -1.3, 0.1);
    let q = model.rest_position(&q, &mut Workspace::default()).expect("it hangs");
    let (t_f, h) = (1.0, 1.0 / N as f64);
    let mut u = vec![ActuatedVector::zeros(sizes); N + 1];
    for (k, u) in u.iter_mut().enumerate() {
        u[0] = (2.0 * std::f64::consts::PI * k as f64 * h).cos();
        u[3] = 0.5 * (k as f64 * h);
    }
    let mut x = vec![State::new(&q, &JointVector::zeros(sizes)); N + 1];
    let mut work = Workspace::default();
    // Classical Runge-Kutta with 20 steps per interval, along the linear spline of u.
    for k in 0..N {
        let mut y = x[k];
        for i in 0..20 {
            let (s, d) = (f64::from(i) / 20.0, 0.05 * h);
            let input = |share: f64| u[k] + (u[k + 1] - u[k]) * (s + share / 20.0);
            let k1 = model.f(&y, &input(0.0), &mut work);
            let k2 = model.f(&(y + k1 * (d / 2.0)), &input(0.5), &mut work);
            let k3 = model.f(&(y + k2 * (d / 2.0)), &input(0.5), &mut work);
            let k4 = model.f(&(y + k3 * d), &input(1.0), &mut work);
            y += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (d / 6.0);
        }
        x[k + 1] = y;
    }
    Trajectory { t_f, x, u }
}

#[test]
fn two_integrators_find_the_same_end() {
    let model = robot();
    let trajectory = motion(&model);
    let end = open_loop_end(&trajectory, &model, &mut Workspace::default());
    assert!((end - trajectory.x[N]).amax() < 1e-9, "they differ by {:e}", (end - trajectory.x[N]).amax());
}

#[test]
fn gains_bring_a_disturbed_motion_back() {
    let (model, mut work) = (robot(), Workspace::default());
    let mut trajectory = motion(&model);
    // A push that the states do not know of.
    trajectory.u[50][0] += 1.0;
    let mut gains = Gains::zeros(model.sizes(), N);
    let lost = (open_loop_end(&trajectory, &model, &mut work) - trajectory.end()).amax();
    // Half of 1 rad/s^2 over two intervals of 10 ms.
    assert!(lost > 4e-3, "{lost:e}");
    assert_eq!(end_error(&trajectory, &gains, &model, &mut work), lost);
    let state = model.sizes().state();
    for gain in gains.as_mut_slice().chunks_exact_mut(model.sizes().actuated() * state) {
        // Joint 1 with two poles at -20 1/s.
        (gain[0], gain[model.sizes().joints()]) = (-400.0, -40.0);
    }
    // (1 + 20 t) exp(-20 t) after half a second, with the swing that the pendulum keeps.
    let kept = end_error(&trajectory, &gains, &model, &mut work);
    assert!(kept < 0.2 * lost, "{kept:e} of {lost:e}");
    trajectory.u[50][0] = f64::NAN;
    assert!(end_error(&trajectory, &gains, &model, &mut work).is_infinite());
}

#[test]
fn figures_are_those_of_the_trajectory() {
    let model = robot();
    let trajectory = motion(&model);
    let limits = model.rated_limits();
    let c = Certificate::of(&trajectory, &model, limits, 0.01);
    // J of (6a): t_F and h/2 = 1/200 s times the squares of all inputs, of joint 1 and joint 4 by their formulas.
    let u_1: f64 = (0..=N).map(|k| (2.0 * std::f64::consts::PI * k as f64 / 100.0).cos().powi(2)).sum();
    let u_4: f64 = (0..=N).map(|k| (0.5 * k as f64 / 100.0).powi(2)).sum();
    assert!((c.cost - (1.0 + 0.01 / 200.0 * (u_1 + u_4))).abs() < 1e-12, "cost {}", c.cost);
    assert!(c.end_error < 1e-9 && c.margin_q > 0.0 && c.margin_qd > 0.0 && c.margin_tau > 0.0);
    // The trapezoidal rule differs from the exact solution by O(h^3).
    assert!(c.defect > 1e-9 && c.defect < 1e-4, "defect {:e}", c.defect);
    assert_eq!(c.difference(&c), 0.0);
    assert!(c.difference(&Certificate { end_error: f64::NAN, ..c }).is_infinite());
    let f = trajectory.f(&model);
    assert_eq!(trajectory.spline(&f).state(0.0), trajectory.x[0]);
}

#[test]
fn what_cannot_be_followed_has_no_end() {
    let model = robot();
    let mut trajectory = motion(&model);
    trajectory.u[50][0] = 1e15;
    let c = Certificate::of(&trajectory, &model, model.rated_limits(), 0.01);
    assert!(c.end_error.is_infinite(), "{c:?}");
    assert!(c.difference(&c).is_infinite());
}

#[test]
fn a_defect_that_is_not_a_number_is_infinite() {
    let model = robot();
    let mut trajectory = motion(&model);
    trajectory.u[50][0] = f64::NAN;
    assert!(trajectory.defect(&model).is_infinite());
}
