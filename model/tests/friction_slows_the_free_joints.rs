//! Viscous friction D of the unactuated joints acts in f, the torque law and their derivatives like a torque -D qd_U on these joints, and
//! makes another robot.

mod common;

use common::{Random, assert_close, random_chain};
use upswing_model::{ActuatedVector, JointVector, Linearization, State, UnactuatedVector, Workspace};

#[test]
fn like_a_torque_against_their_motion() {
    let mut random = Random(7);
    let mut work = Workspace::default();
    for (n, unactuated) in [(2, 1), (3, 2), (4, 3), (6, 2), (9, 2)] {
        let plain = random_chain(&mut random, n, unactuated);
        let sizes = plain.sizes();
        let friction = UnactuatedVector::from_fn(sizes, |_| 0.3 + 0.2 * random.number());
        let model = plain.with_friction(&friction);
        let x = State::from_fn(sizes, |_| random.number());
        let u = ActuatedVector::from_fn(sizes, |_| random.number());

        // Forward dynamics are those of the bodies: with the torque of the law and that of the friction they give u and qdd_U.
        let (f, torque) = model.derivative_and_torque(&x, &u, &mut work);
        let load = JointVector::joined(&torque, &-x.qd_u().component_mul(&friction));
        let qdd = plain.forward_dynamics(&x.q(), &x.qd(), &load, &mut work).expect("M is positive definite");
        assert_close("qdd", qdd.iter().copied(), f.qd().iter().copied(), 1e-9);

        // Derivatives against central differences of f and of the torque.
        let mut first = Linearization::new(sizes);
        model.linearize(&x, &u, &mut work, &mut first);
        const STEP: f64 = 1e-6;
        for column in 0..sizes.state() {
            let mut at = |step: f64| {
                let mut x = x;
                x[column] += step;
                model.derivative_and_torque(&x, &u, &mut work)
            };
            let ((f_above, tau_above), (f_below, tau_below)) = (at(STEP), at(-STEP));
            for c in 0..unactuated {
                let row = n + sizes.actuated() + c;
                let slope = (f_above[row] - f_below[row]) / (2.0 * STEP);
                assert_close("dqdd_U/dx", [first.qdd_u(c)[column]], [slope], 1e-6);
            }
            for a in 0..sizes.actuated() {
                let slope = (tau_above[a] - tau_below[a]) / (2.0 * STEP);
                assert_close("dtau/dx", [first.tau(a)[column]], [slope], 1e-6);
            }
        }
    }
}

#[test]
fn and_makes_another_robot() {
    let plain = random_chain(&mut Random(1), 3, 1);
    let friction = UnactuatedVector::repeat(plain.sizes(), 0.1);
    assert_ne!(plain.with_friction(&friction).fingerprint(), plain.fingerprint());
    assert_eq!(plain.with_friction(&(friction * 0.0)).fingerprint(), plain.fingerprint());
}
