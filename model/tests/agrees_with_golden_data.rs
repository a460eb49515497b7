//! The model agrees with Pinocchio and with automatic differentiation of an independent model at 64 random
//! states, to 1e-10.

mod common;

use common::{Golden, assert_close, robot};
use upswing_model::{Linearization, Workspace};

const TOLERANCE: f64 = 1e-10;

#[test]
fn mass_matrix_and_forces() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let m = model.mass_matrix(&golden.q(), &mut work);
        assert_close("M", m.iter_rows().flatten().copied(), golden.m.concat(), TOLERANCE);
        let nle = model.nonlinear_effects(&golden.q(), &golden.qd(), &mut work);
        assert_close("C qd + g", nle.iter().copied(), golden.nle.clone(), TOLERANCE);
        let g = model.gravity_torque(&golden.q(), &mut work);
        assert_close("g", g.iter().copied(), golden.g.clone(), TOLERANCE);
    }
}

#[test]
fn dynamics_and_torque_laws() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let (x, u) = (golden.x(), golden.u());
        assert_close("f", model.f(&x, &u, &mut work).iter().copied(), golden.f.clone(), TOLERANCE);
        let tau = model.torque(&x, &u, &mut work);
        assert_close("tau (9)", tau.iter().copied(), golden.tau.clone(), TOLERANCE);
        let tau = model.torque_without_coriolis(&x, &u, &mut work);
        assert_close("tau (11)", tau.iter().copied(), golden.tau_without_coriolis.clone(), TOLERANCE);
    }
}

#[test]
fn first_derivatives() {
    let (model, mut work) = (robot(), Workspace::default());
    let mut d = Linearization::new(model.sizes());
    for golden in Golden::all() {
        model.linearize(&golden.x(), &golden.u(), &mut work, &mut d);
        let (a, b) = (d.a(), d.b());
        assert_close("A", a.transpose().iter().copied(), golden.a.concat(), TOLERANCE);
        assert_close("B", b.transpose().iter().copied(), golden.b.concat(), TOLERANCE);
        assert_close("f", d.f(&golden.x(), &golden.u()).iter().copied(), golden.f.clone(), TOLERANCE);
    }
}
