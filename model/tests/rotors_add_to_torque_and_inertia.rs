//! Rotors of known inertia B change the torque law by B u, M by B on its diagonal, and nothing else.

mod common;

use common::{Golden, SIZES, assert_close, robot};
use upswing_model::{
    ActuatedMatrix, ActuatedVector, JointMatrix, JointVector, Linearization, UnactuatedVector, Workspace,
};

fn rotors() -> ActuatedVector {
    ActuatedVector::from_slice(SIZES, &[10.8, 10.9, 4.8, 4.9, 1.4, 0.5, 0.4]).expect("seven joints")
}

#[test]
fn to_every_quantity_of_the_control_law() {
    let (plain, mut work) = (robot(), Workspace::default());
    let geared = plain.with_rotors(&rotors());
    let inertia = ActuatedMatrix::from_diagonal(&rotors());
    let (mut with, mut without) = (Linearization::new(SIZES), Linearization::new(SIZES));
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        let added = &inertia * &u;
        let torque = geared.torque(&x, &u, &mut work) - plain.torque(&x, &u, &mut work);
        assert_close("torque", torque.iter().copied(), added.iter().copied(), 1e-9);
        let slow = geared.torque_without_coriolis(&x, &u, &mut work);
        let torque = slow - plain.torque_without_coriolis(&x, &u, &mut work);
        assert_close("torque without Coriolis", torque.iter().copied(), added.iter().copied(), 1e-9);
        assert_eq!(geared.f(&x, &u, &mut work), plain.f(&x, &u, &mut work), "f depends on u alone");
        geared.linearize(&x, &u, &mut work, &mut with);
        plain.linearize(&x, &u, &mut work, &mut without);
        for a in 0..SIZES.actuated() {
            let (with_x, with_u) = with.tau(a).split_at(SIZES.state());
            let (without_x, without_u) = without.tau(a).split_at(SIZES.state());
            assert_eq!(with_x, without_x);
            let difference = with_u.iter().zip(without_u).map(|(with, without)| with - without);
            assert_close("d tau / du", difference, inertia.row(a).iter().copied(), 1e-9);
        }
        assert!((0..SIZES.unactuated()).all(|c| with.qdd_u(c) == without.qdd_u(c)));

        // M~ a at the same q, from the work of either law.
        let a = ActuatedVector::from_fn(SIZES, |i| 0.3 - 0.1 * i as f64);
        geared.torque(&x, &u, &mut work);
        let carried =
            geared.reduced_inertia_times(&a, &mut work) - plain.reduced_inertia_times(&a, &mut work);
        assert_close("M~ a", carried.iter().copied(), (&inertia * &a).iter().copied(), 1e-9);

        // Forward dynamics undo the torque law.
        let (q, qd) = (x.q(), x.qd());
        let tau = JointVector::joined(&geared.torque(&x, &u, &mut work), &UnactuatedVector::zeros(SIZES));
        let qdd = geared.forward_dynamics(&q, &qd, &tau, &mut work).expect("M is positive definite");
        assert_close("qdd_A", qdd.actuated().iter().copied(), u.iter().copied(), 1e-7);
        let mass = geared.mass_matrix(&q, &mut work) - plain.mass_matrix(&q, &mut work);
        let all = JointVector::joined(&rotors(), &UnactuatedVector::zeros(SIZES));
        assert!((mass - JointMatrix::from_diagonal(&all)).amax() < 1e-9);
    }
}

#[test]
fn and_make_another_robot() {
    let plain = robot();
    assert_ne!(plain.with_rotors(&rotors()).fingerprint(), plain.fingerprint());
    assert_eq!(plain.with_rotors(&ActuatedVector::zeros(SIZES)).fingerprint(), plain.fingerprint());
}
