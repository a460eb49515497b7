//! The linearised dynamics of all knots.

use crate::kernels::{combine, dot, shift_add};
use crate::slab::{Knots, LARGEST_KNOT, Slab};
use std::ops::Range;
use upswing_model::{Dims, Sizes, State, States};

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

    /// Overwrites this with `other`, which has the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.rows.copy_from(&other.rows);
        self.f.copy_from(&other.f);
    }

    /// A dx + B du of knot `k`.
    pub fn apply(&self, k: usize, dz: &[f64]) -> State {
        let mut out = State::zeros(self.sizes());
        apply(self.sizes(), self.rows.panel(k), dz, &mut out);
        out
    }

    /// [A, B]' w of knot `k` into `out`, the entries of z.
    pub fn apply_transposed(&self, k: usize, w: &[f64], out: &mut [f64]) {
        let sizes = self.sizes();
        let mut row = [0.0; LARGEST_KNOT];
        apply_transposed(sizes, self.rows.panel(k), w, &mut row[..sizes.knot_row()]);
        out.copy_from_slice(&row[..sizes.knot()]);
    }
}

/// out = A dx + B du for the dense rows of a knot.
#[inline(always)]
pub(super) fn apply(d: impl Dims, rows: &[f64], dz: &[f64], out: &mut [f64]) {
    let (n, actuated, state, knot, row) = (d.joints(), d.actuated(), d.state(), d.knot(), d.knot_row());
    out[..n].copy_from_slice(&dz[n..state]);
    out[n..n + actuated].copy_from_slice(&dz[state..knot]);
    for i in 0..d.unactuated() {
        out[n + actuated + i] = dot(&rows[i * row..][..knot], dz);
    }
}

/// out = [A, B]' w for the dense rows of a knot and a padded row `out` over z.
#[inline(always)]
pub(super) fn apply_transposed(d: impl Dims, rows: &[f64], w: &[f64], out: &mut [f64]) {
    let (n, actuated, state) = (d.joints(), d.actuated(), d.state());
    out.fill(0.0);
    combine(out, d.unactuated(), &w[n + actuated..], 1, rows, d.knot_row());
    shift_add(&mut out[n..state], 1.0, w);
    shift_add(&mut out[state..state + actuated], 1.0, &w[n..]);
}
