//! Without friction and torque the total energy of the whole chain stays what it was, although masses move against
//! each other in all nine joints.

mod common;

use common::{Golden, robot};
use upswing_model::{JointVector, Model, State, StateParts, Workspace, state};

/// d/dt x = [qd, qdd] without torque.
fn derivative(model: &Model, x: &State, work: &mut Workspace) -> State {
    let (q, qd) = (x.q(), x.qd());
    let qdd = model.forward_dynamics(&q, &qd, &JointVector::zeros(), work).expect("M is positive definite");
    state(&qd, &qdd)
}

fn runge_kutta(model: &Model, x: &State, h: f64, work: &mut Workspace) -> State {
    let k1 = derivative(model, x, work);
    let k2 = derivative(model, &(x + k1 * (h / 2.0)), work);
    let k3 = derivative(model, &(x + k2 * (h / 2.0)), work);
    let k4 = derivative(model, &(x + k3 * h), work);
    x + (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0)
}

#[test]
fn over_one_second_of_free_fall() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all().iter().take(8) {
        let mut x = golden.x();
        let before = model.energy(&x, &mut work);
        for _ in 0..10_000 {
            x = runge_kutta(&model, &x, 1e-4, &mut work);
        }
        let after = model.energy(&x, &mut work);
        // The arm falls several metres per second: kinetic energy of order 100 J; the integrator's error is h^4.
        assert!((after - before).abs() < 1e-6, "energy went from {before} J to {after} J");
    }
}

#[test]
fn power_is_torque_times_velocity() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let (x, u) = (golden.x(), golden.u());
        let h = 1e-5;
        let f = model.f(&x, &u, &mut work);
        let energy = |x: &State, work: &mut Workspace| model.energy(x, work);
        let rate = (energy(&(x + f * h), &mut work) - energy(&(x - f * h), &mut work)) / (2.0 * h);
        let tau = model.torque(&x, &u, &mut work);
        let power: f64 = (0..tau.len()).map(|i| tau[i] * x[9 + i]).sum();
        assert!((rate - power).abs() < 1e-5 * power.abs().max(1.0), "dE/dt {rate} W, tau . qd {power} W");
    }
}
