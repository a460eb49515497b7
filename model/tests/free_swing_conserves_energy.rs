//! Without friction and torque the total energy of the whole chain stays what it was, although masses move against
//! each other in all nine joints.

mod common;

use common::{Golden, SIZES, robot};
use std::convert::Infallible;
use upswing_model::{JointVector, Model, State, Workspace, runge_kutta_step};

/// d/dt x = [qd, qdd] without torque.
fn derivative(model: &Model, x: &State, work: &mut Workspace) -> State {
    let (q, qd) = (x.q(), x.qd());
    let qdd =
        model.forward_dynamics(&q, &qd, &JointVector::zeros(SIZES), work).expect("M is positive definite");
    State::new(&qd, &qdd)
}

#[test]
fn over_one_second_of_free_fall() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all().iter().take(8) {
        let mut x = golden.x();
        let before = model.energy(&x, &mut work);
        for _ in 0..10_000 {
            let step = runge_kutta_step(&x, 1e-4, |x| Ok::<_, Infallible>(derivative(&model, x, &mut work)));
            x = step.expect("no error");
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
        let power = tau.dot(&x.qd_a());
        assert!((rate - power).abs() < 1e-5 * power.abs().max(1.0), "dE/dt {rate} W, tau . qd {power} W");
    }
}
