//! First and second derivatives agree with extrapolated central differences of the next lower ones, which
//! share no code with them.

mod common;

use common::{Golden, SIZES, assert_close, robot};
use upswing_model::{ActuatedVector, Dims, Linearization, Model, State, UnactuatedVector, Workspace};

/// Fourth-order central difference of `f` along coordinate k of z = [x, u].
fn difference(
    x: &State,
    u: &ActuatedVector,
    k: usize,
    mut f: impl FnMut(&State, &ActuatedVector) -> Vec<f64>,
) -> Vec<f64> {
    // The step balances the error term h^4 against rounding, both about 1e-11.
    let h = 1e-3;
    let mut at = |offset: f64| {
        let (mut x, mut u) = (*x, *u);
        match x.get_mut(k) {
            Some(component) => *component += offset,
            None => u[k - SIZES.state()] += offset,
        }
        f(&x, &u)
    };
    let (near, far) = ([at(h), at(-h)], [at(2.0 * h), at(-2.0 * h)]);
    let slope =
        |i: usize| (near[0][i] - near[1][i]) * (8.0 / (12.0 * h)) - (far[0][i] - far[1][i]) / (12.0 * h);
    (0..near[0].len()).map(slope).collect()
}

fn linearized(model: &Model, x: &State, u: &ActuatedVector, with_coriolis: bool) -> Linearization {
    let (mut work, mut d) = (Workspace::default(), Linearization::new(SIZES));
    if with_coriolis {
        model.linearize(x, u, &mut work, &mut d);
    } else {
        model.linearize_without_coriolis(x, u, &mut work, &mut d);
    }
    d
}

/// Gradient of w . qdd_U + mu . tau with respect to z.
fn gradient(d: &Linearization, w: &UnactuatedVector, mu: &ActuatedVector) -> Vec<f64> {
    let weighted = |k: usize| {
        let tau: f64 = mu.iter().enumerate().map(|(a, mu)| mu * d.tau(a)[k]).sum();
        let qdd_u: f64 = w.iter().enumerate().map(|(c, w)| w * d.qdd_u(c)[k]).sum();
        tau + qdd_u
    };
    (0..SIZES.knot()).map(weighted).collect()
}

#[test]
fn torque_jacobians() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        let exact = linearized(&model, &x, &u, true);
        let paper = linearized(&model, &x, &u, false);
        for k in 0..SIZES.knot() {
            let column = |d: &Linearization| (0..SIZES.actuated()).map(|a| d.tau(a)[k]).collect::<Vec<_>>();
            let want = difference(&x, &u, k, |x, u| model.torque(x, u, &mut work).to_vec());
            assert_close("d tau", column(&exact), want, 1e-8);
            let want = difference(&x, &u, k, |x, u| model.torque_without_coriolis(x, u, &mut work).to_vec());
            assert_close("d tau (11)", column(&paper), want, 1e-8);
        }
    }
}

#[test]
fn hessians() {
    let (model, mut work) = (robot(), Workspace::default());
    let w = UnactuatedVector::from_slice(SIZES, &[0.7, -1.3]).expect("two joints");
    let mu = ActuatedVector::from_fn(SIZES, |i| 0.3 * i as f64 - 0.8);
    let (stride, mut first) = (SIZES.knot_row(), Linearization::new(SIZES));
    let mut h = vec![0.0; SIZES.knot() * stride];
    for golden in Golden::all().iter().take(16) {
        let (x, u) = (golden.x(), golden.u());
        for with_coriolis in [true, false] {
            let w = if with_coriolis { w } else { UnactuatedVector::zeros(SIZES) };
            if with_coriolis {
                model.linearize(&x, &u, &mut work, &mut first);
                model.hessian(&w, &mu, &first, &mut work, &mut h);
            } else {
                model.linearize_without_coriolis(&x, &u, &mut work, &mut first);
                model.hessian_without_coriolis(&mu, &first, &mut work, &mut h);
            }
            for k in 0..SIZES.knot() {
                let row = (0..SIZES.knot()).map(|i| h[k * stride + i]);
                let column: Vec<f64> = (0..SIZES.knot()).map(|i| h[i * stride + k]).collect();
                assert_close("symmetry", row, column.iter().copied(), 1e-12);
                let want =
                    difference(&x, &u, k, |x, u| gradient(&linearized(&model, x, u, with_coriolis), &w, &mu));
                assert_close("Hessian", column, want, 1e-7);
            }
        }
    }
}

#[test]
fn the_input_enters_linearly() {
    let (model, mut work) = (robot(), Workspace::default());
    let step = ActuatedVector::repeat(SIZES, 0.5);
    let along = |row: &[f64]| row[SIZES.state()..].iter().zip(step.iter()).map(|(d, s)| d * s).sum::<f64>();
    for golden in Golden::all() {
        let (x, u) = (golden.x(), golden.u());
        let d = linearized(&model, &x, &u, true);
        let moved = model.hybrid_dynamics(&x, &(u + step), &mut work);
        let tau = ActuatedVector::from_fn(SIZES, |a| d.value().tau[a] + along(d.tau(a)));
        assert_close("tau", moved.tau.iter().copied(), tau.iter().copied(), 1e-11);
        let qdd_u = UnactuatedVector::from_fn(SIZES, |c| d.value().qdd_u[c] + along(d.qdd_u(c)));
        assert_close("qdd_U", moved.qdd_u.iter().copied(), qdd_u.iter().copied(), 1e-11);
    }
}
