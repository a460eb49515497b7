//! First and second derivatives agree with extrapolated central differences of the next lower ones, which
//! share no code with them.

mod common;

use common::{Golden, assert_close, robot};
use nalgebra::SMatrix;
use upswing_model::{ActuatedVector, Model, NX, NZ, State, UnactuatedVector, Workspace};

/// Fourth-order central difference of `f` along coordinate k of z = [x, u].
fn difference<const R: usize>(
    x: &State,
    u: &ActuatedVector,
    k: usize,
    mut f: impl FnMut(&State, &ActuatedVector) -> SMatrix<f64, R, 1>,
) -> SMatrix<f64, R, 1> {
    // The step balances the error term h^4 against rounding, both about 1e-11.
    let h = 1e-3;
    let mut at = |offset: f64| {
        let (mut x, mut u) = (*x, *u);
        if k < NX {
            x[k] += offset
        } else {
            u[k - NX] += offset
        }
        f(&x, &u)
    };
    (at(h) - at(-h)) * (8.0 / (12.0 * h)) - (at(2.0 * h) - at(-2.0 * h)) / (12.0 * h)
}

fn torque_gradient(
    model: &Model,
    w: &UnactuatedVector,
    mu: &ActuatedVector,
    x: &State,
    u: &ActuatedVector,
    with_coriolis: bool,
) -> SMatrix<f64, NZ, 1> {
    let mut work = Workspace::default();
    let d = if with_coriolis {
        model.derivatives(x, u, &mut work)
    } else {
        model.derivatives_without_coriolis(x, u, &mut work)
    };
    let on_x = d.qdd_u_x.transpose() * w + d.tau_x.transpose() * mu;
    let on_u = d.qdd_u_u.transpose() * w + d.tau_u.transpose() * mu;
    SMatrix::from_fn(|i, _| if i < NX { on_x[i] } else { on_u[i - NX] })
}

#[test]
fn torque_jacobians() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        let exact = model.derivatives(&x, &u, &mut work);
        let paper = model.derivatives_without_coriolis(&x, &u, &mut work);
        for k in 0..NZ {
            let column = |d: &upswing_model::Derivatives| {
                if k < NX { d.tau_x.column(k).into_owned() } else { d.tau_u.column(k - NX).into_owned() }
            };
            let want = difference(&x, &u, k, |x, u| model.torque(x, u, &mut work));
            assert_close("d tau", column(&exact).iter().copied(), want.iter().copied(), 1e-8);
            let want = difference(&x, &u, k, |x, u| model.torque_without_coriolis(x, u, &mut work));
            assert_close("d tau (11)", column(&paper).iter().copied(), want.iter().copied(), 1e-8);
        }
    }
}

#[test]
fn hessians() {
    let (model, mut work) = (robot(), Workspace::default());
    let w = UnactuatedVector::new(0.7, -1.3);
    let mu = ActuatedVector::from_fn(|i, _| 0.3 * i as f64 - 0.8);
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        for with_coriolis in [true, false] {
            let w = if with_coriolis { w } else { UnactuatedVector::zeros() };
            let h = if with_coriolis {
                let first = model.derivatives(&x, &u, &mut work);
                model.hessian(&w, &mu, &first, &work)
            } else {
                let first = model.derivatives_without_coriolis(&x, &u, &mut work);
                model.hessian_without_coriolis(&mu, &first, &work)
            };
            assert_close("symmetry", h.iter().copied(), h.transpose().iter().copied(), 1e-12);
            for k in 0..NZ {
                let want =
                    difference(&x, &u, k, |x, u| torque_gradient(&model, &w, &mu, x, u, with_coriolis));
                assert_close("Hessian", h.column(k).iter().copied(), want.iter().copied(), 1e-7);
            }
        }
    }
}

#[test]
fn the_input_enters_linearly() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let (x, u) = (golden.x(), golden.u());
        let d = model.derivatives(&x, &u, &mut work);
        let step = ActuatedVector::repeat(0.5);
        let moved = model.hybrid_dynamics(&x, &(u + step), &mut work);
        assert_close("tau", moved.tau.iter().copied(), (d.value.tau + d.tau_u * step).iter().copied(), 1e-11);
        let qdd_u = d.value.qdd_u + d.qdd_u_u * step;
        assert_close("qdd_U", moved.qdd_u.iter().copied(), qdd_u.iter().copied(), 1e-11);
    }
}
