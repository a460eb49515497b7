//! Derivatives of 200 random chains of 2 to 16 joints, revolute and prismatic in any order and with unactuated joints anywhere, agree
//! with automatic differentiation by dual numbers; motions conserve energy; numbers side by side have the bits of single ones.

mod common;

use common::{Random, assert_close, random_chain};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};
use upswing_model::{
    ActuatedVector, Dims, JointVector, Lanes, Linearization, Model, Scalar, State, UnactuatedVector,
    Workspace,
};

const CHAINS: usize = 200;

/// A value and its derivative along one direction.
#[derive(Clone, Copy, Debug)]
struct Dual {
    v: f64,
    d: f64,
}

impl Add for Dual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self { v: self.v + o.v, d: self.d + o.d }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self { v: self.v - o.v, d: self.d - o.d }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self { v: self.v * o.v, d: self.d * o.v + self.v * o.d }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let v = self.v / o.v;
        Self { v, d: (self.d - v * o.d) / o.v }
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self { v: -self.v, d: -self.d }
    }
}

impl AddAssign for Dual {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl SubAssign for Dual {
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl Mul<f64> for Dual {
    type Output = Self;
    fn mul(self, s: f64) -> Self {
        Self { v: self.v * s, d: self.d * s }
    }
}

impl Scalar for Dual {
    const ZERO: Self = Self { v: 0.0, d: 0.0 };

    fn constant(v: f64) -> Self {
        Self { v, d: 0.0 }
    }

    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.v.sin_cos();
        (Self { v: sin, d: cos * self.d }, Self { v: cos, d: -sin * self.d })
    }
}

/// z = [x, u], differentiated along its component `k`.
fn along(z: &[f64], k: usize) -> Vec<Dual> {
    z.iter().enumerate().map(|(i, v)| Dual { v: *v, d: f64::from(u8::from(i == k)) }).collect()
}

/// Each chain with a point z = [x, u] and multipliers w, mu of qdd_U and tau.
fn for_each_chain(mut check: impl FnMut(&Model, &[f64], &UnactuatedVector, &ActuatedVector)) {
    let mut random = Random(11);
    for case in 0..CHAINS {
        let n = 2 + case % 15;
        let unactuated = 1 + random.below(n - 1).min(3);
        let model = random_chain(&mut random, n, unactuated);
        let sizes = model.sizes();
        let z = random.vector(sizes.knot());
        let w = UnactuatedVector::from_fn(sizes, |_| random.number());
        let mu = ActuatedVector::from_fn(sizes, |_| random.number());
        check(&model, &z, &w, &mu);
    }
}

#[test]
fn first_and_second_derivatives() {
    for_each_chain(|model, z, w, mu| {
        let sizes = model.sizes();
        let (x, u) = z.split_at(sizes.state());
        let (mut work, mut first) = (Workspace::default(), Linearization::new(sizes));
        let mut h = vec![0.0; sizes.knot() * sizes.knot_row()];
        model.linearize(x, u, &mut work, &mut first);
        model.hessian(w, mu, &first, &mut work, &mut h);
        let largest = |of: &[f64]| of.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
        let (scale, scale_h) = (largest(first.rows()), largest(&h));
        let (mut dual_work, mut dual) = (Workspace::default(), Linearization::<Dual>::new(sizes));
        for k in 0..sizes.knot() {
            let z = along(z, k);
            let (x, u) = z.split_at(sizes.state());
            model.linearize(x, u, &mut dual_work, &mut dual);
            let tau = |a: usize| first.tau(a)[k] / scale;
            let want = |a: usize| dual.tau_values()[a].d / scale;
            assert_close("d tau", (0..mu.len()).map(tau), (0..mu.len()).map(want), 1e-9);
            let qdd_u = |c: usize| first.qdd_u(c)[k] / scale;
            let want = |c: usize| dual.qdd_u_values()[c].d / scale;
            assert_close("d qdd_U", (0..w.len()).map(qdd_u), (0..w.len()).map(want), 1e-9);
            let row = |i: usize| h[k * sizes.knot_row() + i] / scale_h;
            let want = |i: usize| {
                let tau: f64 = mu.iter().enumerate().map(|(a, mu)| mu * dual.tau(a)[i].d).sum();
                let qdd_u: f64 = w.iter().enumerate().map(|(c, w)| w * dual.qdd_u(c)[i].d).sum();
                (tau + qdd_u) / scale_h
            };
            assert_close("Hessian", (0..sizes.knot()).map(row), (0..sizes.knot()).map(want), 1e-9);
        }
    });
}

#[test]
fn power_of_the_motors_is_the_rate_of_the_energy() {
    for_each_chain(|model, z, _, _| {
        let sizes = model.sizes();
        let mut work = Workspace::default();
        let x = State::from_slice(sizes, &z[..sizes.state()]).expect("a state");
        let u = ActuatedVector::from_slice(sizes, &z[sizes.state()..]).expect("an input");
        let (f, tau) = model.derivative_and_torque(&x, &u, &mut work);
        let h = 1e-4;
        let mut energy = |step: f64| model.energy(&(x + f * step), &mut work);
        let rate =
            (energy(h) - energy(-h)) * (8.0 / (12.0 * h)) - (energy(2.0 * h) - energy(-2.0 * h)) / (12.0 * h);
        let power = tau.dot(&x.qd_a());
        let scale = tau.amax().max(f.amax()).max(1.0);
        assert!((rate - power).abs() < 1e-6 * scale, "dE/dt {rate} W, tau . qd {power} W");
    });
}

#[test]
fn inverse_forward_and_hybrid_dynamics_are_one() {
    for_each_chain(|model, z, _, _| {
        let sizes = model.sizes();
        let mut work = Workspace::default();
        let x = State::from_slice(sizes, &z[..sizes.state()]).expect("a state");
        let u = ActuatedVector::from_slice(sizes, &z[sizes.state()..]).expect("an input");
        let hybrid = model.hybrid_dynamics(&x, &u, &mut work);
        let scale = hybrid.tau.amax().max(hybrid.qdd_u.amax()).max(1.0);
        // M~ is dtau/du of (9).
        let reduced = model.reduced_inertia(&mut work);
        let mut first = Linearization::new(sizes);
        model.linearize(&x, &u, &mut work, &mut first);
        for a in 0..sizes.actuated() {
            let want = first.tau(a)[sizes.state()..].iter().copied();
            assert_close("M~", reduced.row(a).iter().copied(), want, 1e-9);
        }
        let qdd = JointVector::joined(&u, &hybrid.qdd_u);
        let all = model.inverse_dynamics(&x.q(), &x.qd(), &qdd, &mut work);
        assert!((all.actuated() - hybrid.tau).amax() < 1e-10 * scale);
        assert!(all.unactuated().amax() < 1e-10 * scale);
        let got = model.forward_dynamics(&x.q(), &x.qd(), &all, &mut work).expect("M is positive definite");
        assert!((got - qdd).amax() < 1e-8 * scale, "{got:?}, expected {qdd:?}");
    });
}

#[test]
fn lanes_have_the_bits_of_single_numbers() {
    let mut random = Random(5);
    for case in 0..30 {
        let n = 2 + case % 15;
        let model = random_chain(&mut random, n, 1 + case % (n - 1).min(3));
        let sizes = model.sizes();
        let states: [Vec<f64>; 4] = std::array::from_fn(|_| random.vector(sizes.knot()));
        let (w, mu) = (random.vector(sizes.unactuated()), random.vector(sizes.actuated()));
        let length = sizes.knot() * sizes.knot_row();
        let lanes = |v: &[f64]| v.iter().map(|v| Lanes::<4>::constant(*v)).collect::<Vec<_>>();
        let z: Vec<Lanes<4>> =
            (0..sizes.knot()).map(|i| Lanes(std::array::from_fn(|l| states[l][i]))).collect();
        let (x, u) = z.split_at(sizes.state());
        let (mut work, mut first) = (Workspace::default(), Linearization::new(sizes));
        let mut h = vec![Lanes::<4>::ZERO; length];
        model.linearize(x, u, &mut work, &mut first);
        model.hessian(&lanes(&w), &lanes(&mu), &first, &mut work, &mut h);
        let mut single_work = Workspace::default();
        let mut single_h = vec![0.0; length];
        for (l, z) in states.iter().enumerate() {
            let (x, u) = z.split_at(sizes.state());
            let mut single = Linearization::new(sizes);
            model.linearize(x, u, &mut single_work, &mut single);
            model.hessian(&w, &mu, &single, &mut single_work, &mut single_h);
            let bits = |v: f64| v.to_bits();
            let got = first.rows().iter().chain(&h).map(|v| bits(v.0[l]));
            assert!(got.eq(single.rows().iter().chain(&single_h).map(|v| bits(*v))), "{n} joints, lane {l}");
        }
    }
}
