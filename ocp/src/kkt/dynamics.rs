//! The linearised dynamics of all knots.

use crate::slab::{Knots, Slab};
use std::ops::Range;
use upswing_model::{ActuatedVector, Linearization, Sizes, State, States};

/// A_k, B_k (19) and f_k of all knots.
#[derive(Clone, Debug)]
pub struct Dynamics {
    /// n_U rows d qdd_U / dz of each knot: the rows of A_k and B_k that are not those of double integrators.
    pub rows: Slab<Knots>,
    /// f(x_k, u_k)
    pub f: Slab<States>,
}

impl Dynamics {
    /// Memory for the N + 1 knots of `n` intervals.
    pub fn zeros(sizes: Sizes, n: usize) -> Self {
        Self { rows: Slab::zeros(sizes, n + 1, sizes.unactuated()), f: Slab::zeros(sizes, n + 1, 1) }
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.f.sizes()
    }

    /// The knots `range` alone.
    pub fn part(&self, range: Range<usize>) -> Self {
        Self { rows: self.rows.part(range.clone()), f: self.f.part(range) }
    }

    /// Sets knot `k` to the `derivatives` at (x, u).
    pub fn set(&mut self, k: usize, derivatives: &Linearization, x: &State, u: &ActuatedVector) {
        for c in 0..self.sizes().unactuated() {
            self.rows.row_mut(k, c).copy_from_slice(derivatives.qdd_u(c));
        }
        self.f.set(k, &derivatives.f(x, u));
    }

    /// A dx + B du of knot `k`.
    pub fn apply(&self, k: usize, dz: &[f64]) -> State {
        let sizes = self.sizes();
        let (joints, state) = (sizes.joints(), sizes.state());
        let mut out = State::zeros(sizes);
        out.q_mut().copy_from_slice(&dz[joints..state]);
        out.qd_a_mut().copy_from_slice(&dz[state..sizes.knot()]);
        for (c, out) in out.qd_u_mut().iter_mut().enumerate() {
            *out = self.rows.row(k, c).iter().zip(dz).map(|(a, dz)| a * dz).sum();
        }
        out
    }

    /// [A, B]' w of knot `k` into `out`, the entries of z.
    pub fn apply_transposed(&self, k: usize, w: &State, out: &mut [f64]) {
        let sizes = self.sizes();
        let (joints, state) = (sizes.joints(), sizes.state());
        out.fill(0.0);
        for (c, w) in w.qd_u().iter().enumerate() {
            out.iter_mut().zip(self.rows.row(k, c)).for_each(|(out, a)| *out += a * w);
        }
        out[joints..state].iter_mut().zip(w.q().iter()).for_each(|(out, w)| *out += w);
        out[state..].iter_mut().zip(w.qd_a().iter()).for_each(|(out, w)| *out += w);
    }
}
