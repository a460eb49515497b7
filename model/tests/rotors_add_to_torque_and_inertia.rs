//! Rotors of known inertia B change the torque law by B u, M by B on its diagonal, and nothing else.

mod common;

use common::{Golden, assert_close, robot};
use nalgebra::SMatrix;
use upswing_model::{ActuatedVector, NQ, NU, StateParts, Workspace};

const ROTORS: [f64; NU] = [10.8, 10.9, 4.8, 4.9, 1.4, 0.5, 0.4];

fn flat<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> Vec<f64> {
    m.iter().copied().collect()
}

#[test]
fn to_every_quantity_of_the_control_law() {
    let (plain, mut work) = (robot(), Workspace::default());
    let geared = plain.with_rotors(ROTORS);
    let inertia = SMatrix::<f64, NU, NU>::from_diagonal(&ROTORS.into());
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        let added = inertia * u;
        let torque = geared.torque(&x, &u, &mut work) - plain.torque(&x, &u, &mut work);
        assert_close("torque", flat(&torque), flat(&added), 1e-9);
        let slow = geared.torque_without_coriolis(&x, &u, &mut work);
        let torque = slow - plain.torque_without_coriolis(&x, &u, &mut work);
        assert_close("torque without Coriolis", flat(&torque), flat(&added), 1e-9);
        assert_eq!(geared.f(&x, &u, &mut work), plain.f(&x, &u, &mut work), "f depends on u alone");
        let (with, without) = (geared.derivatives(&x, &u, &mut work), plain.derivatives(&x, &u, &mut work));
        assert_close("d tau / du", flat(&(with.tau_u - without.tau_u)), flat(&inertia), 1e-9);
        assert_eq!((with.tau_x, with.qdd_u_x), (without.tau_x, without.qdd_u_x));

        // M~ a at the same q, from the work of either law.
        geared.torque(&x, &u, &mut work);
        let a = ActuatedVector::from_fn(|i, _| 0.3 - 0.1 * i as f64);
        let carried = geared.reduced_inertia_times(&a, &work) - plain.reduced_inertia_times(&a, &work);
        assert_close("M~ a", flat(&carried), flat(&(inertia * a)), 1e-9);

        // Forward dynamics undo the torque law.
        let (q, qd) = (x.q(), x.qd());
        let mut tau = upswing_model::JointVector::zeros();
        tau.fixed_rows_mut::<NU>(0).copy_from(&geared.torque(&x, &u, &mut work));
        let qdd = geared.forward_dynamics(&q, &qd, &tau, &mut work).expect("M is positive definite");
        assert_close("qdd_A", flat(&qdd.fixed_rows::<NU>(0).into_owned()), flat(&u), 1e-7);
        let mass = geared.mass_matrix(&q, &mut work) - plain.mass_matrix(&q, &mut work);
        let mut expected = SMatrix::<f64, NQ, NQ>::zeros();
        expected.fixed_view_mut::<NU, NU>(0, 0).copy_from(&inertia);
        assert_close("M", flat(&mass), flat(&expected), 1e-9);
    }
}

#[test]
fn and_make_another_robot() {
    let plain = robot();
    assert_ne!(plain.with_rotors(ROTORS).fingerprint(), plain.fingerprint());
    assert_eq!(plain.with_rotors([0.0; NU]).fingerprint(), plain.fingerprint());
}
