//! The two changes of variables of a sweep, each dense in the rows of qdd_U only, so that products with them cost a few
//! row operations.

use super::{KnotDynamics, KnotVector};
use crate::fixed::{ActuatedVector, N_UNACTUATED, NQ, NU, NX, NZ, State};
use crate::rows::{KNOT_ROW, STATE_ROW, StateRow, add_scaled};
use nalgebra::SMatrix;

/// First row of the velocities, of the unactuated velocities, and of the inputs among z = (x, u).
const V: usize = NQ;
const V_U: usize = NQ + NU;
pub(super) const U: usize = NX;

/// A row of a matrix over z = (x, u) or (s, u).
pub(super) type KnotRow = [f64; KNOT_ROW];

/// z = T (s, u): dz_{k+1} from the state s_k that enters the knot and its input, with the two dense rows of T.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entering {
    half_h: f64,
    /// dqd_U = M (s, u)
    m: [KnotRow; N_UNACTUATED],
}

impl Entering {
    pub(super) fn new(half_h: f64, knot: &KnotDynamics) -> Self {
        let mut rhs = [[0.0; KNOT_ROW]; N_UNACTUATED];
        for (i, rhs) in rhs.iter_mut().enumerate() {
            for j in 0..NQ {
                rhs[j] = half_h * knot.qdd_u_x[(i, j)];
            }
            for j in 0..NU {
                let on_v = half_h * (knot.qdd_u_x[(i, V + j)] + rhs[j]);
                rhs[V + j] = on_v;
                rhs[U + j] = half_h * (knot.qdd_u_u[(i, j)] + on_v);
            }
            rhs[V_U + i] = 1.0;
        }
        // E_UU of E = I - h/2 A, with the unactuated angles eliminated.
        let block = SMatrix::<f64, N_UNACTUATED, N_UNACTUATED>::from_fn(|i, j| {
            let position = knot.qdd_u_x[(i, NU + j)];
            let velocity = knot.qdd_u_x[(i, V_U + j)];
            f64::from(u8::from(i == j)) - half_h * velocity - half_h * half_h * position
        })
        .try_inverse()
        .unwrap_or_else(|| SMatrix::from_element(f64::NAN));
        let mut m = [[0.0; KNOT_ROW]; N_UNACTUATED];
        for i in 0..N_UNACTUATED {
            for l in 0..N_UNACTUATED {
                add_scaled(&mut m[i], block[(i, l)], &rhs[l]);
            }
        }
        Self { half_h, m }
    }

    /// T (s, u)
    #[inline(always)]
    pub(super) fn apply(&self, s: &State, u: &ActuatedVector) -> KnotVector {
        let mut z = KnotVector::zeros();
        for j in 0..NU {
            z[V + j] = s[V + j] + self.half_h * u[j];
            z[U + j] = u[j];
        }
        for (i, m) in self.m.iter().enumerate() {
            let mut v = 0.0;
            for j in 0..NX {
                v += m[j] * s[j];
            }
            for j in 0..NU {
                v += m[U + j] * u[j];
            }
            z[V_U + i] = v;
        }
        for i in 0..NQ {
            z[i] = s[i] + self.half_h * z[V + i];
        }
        z
    }

    /// T' p
    #[inline(always)]
    pub(super) fn apply_transposed(&self, p: &KnotVector) -> KnotRow {
        let mut out = [0.0; KNOT_ROW];
        out[..NZ].copy_from_slice(p.as_slice());
        self.columns(&mut out);
        out
    }

    /// One row, or one column, of a quadratic: out = T' out.
    #[inline(always)]
    fn columns(&self, out: &mut KnotRow) {
        for i in 0..NQ {
            out[V + i] += self.half_h * out[i];
        }
        for i in 0..NU {
            out[U + i] += self.half_h * out[V + i];
        }
        let on_v: [f64; N_UNACTUATED] = std::array::from_fn(|i| out[V_U + i]);
        out[V_U..V_U + N_UNACTUATED].fill(0.0);
        for (m, p) in self.m.iter().zip(on_v) {
            add_scaled(out, p, m);
        }
    }

    /// T' P T for a symmetric P.
    #[inline(always)]
    pub(super) fn congruence(&self, p: &mut [KnotRow; NZ]) {
        for i in 0..NQ {
            let q = p[i];
            add_scaled(&mut p[V + i], self.half_h, &q);
        }
        for i in 0..NU {
            let v = p[V + i];
            add_scaled(&mut p[U + i], self.half_h, &v);
        }
        let on_v: [KnotRow; N_UNACTUATED] = std::array::from_fn(|i| p[V_U + i]);
        for i in 0..N_UNACTUATED {
            p[V_U + i] = [0.0; KNOT_ROW];
        }
        for (j, row) in p.iter_mut().enumerate() {
            for (m, v) in self.m.iter().zip(&on_v) {
                add_scaled(row, m[j], v);
            }
            self.columns(row);
        }
    }
}

/// s = N dz_k: the state that leaves a knot, with the two dense rows of N.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaving {
    half_h: f64,
    n: [KnotRow; N_UNACTUATED],
}

impl Leaving {
    pub(super) fn new(half_h: f64, knot: &KnotDynamics) -> Self {
        let mut n = [[0.0; KNOT_ROW]; N_UNACTUATED];
        for (i, n) in n.iter_mut().enumerate() {
            for j in 0..NX {
                n[j] = half_h * knot.qdd_u_x[(i, j)];
            }
            for j in 0..NU {
                n[U + j] = half_h * knot.qdd_u_u[(i, j)];
            }
            n[V_U + i] += 1.0;
        }
        Self { half_h, n }
    }

    /// N z
    #[inline(always)]
    pub(super) fn apply(&self, z: &KnotVector) -> State {
        let mut s = State::zeros();
        for i in 0..NQ {
            s[i] = z[i] + self.half_h * z[V + i];
        }
        for i in 0..NU {
            s[V + i] = z[V + i] + self.half_h * z[U + i];
        }
        for (i, n) in self.n.iter().enumerate() {
            let mut v = 0.0;
            for j in 0..NZ {
                v += n[j] * z[j];
            }
            s[V_U + i] = v;
        }
        s
    }

    /// N' p
    #[inline(always)]
    pub(super) fn apply_transposed(&self, p: &StateRow) -> KnotRow {
        let mut out = [0.0; KNOT_ROW];
        out[..V_U].copy_from_slice(&p[..V_U]);
        for i in 0..NQ {
            out[V + i] += self.half_h * p[i];
        }
        for i in 0..NU {
            out[U + i] = self.half_h * p[V + i];
        }
        for (i, n) in self.n.iter().enumerate() {
            add_scaled(&mut out, p[V_U + i], n);
        }
        out
    }

    /// N' S N for a symmetric S.
    #[inline(always)]
    pub(super) fn congruence(&self, s: &[StateRow; NX], p: &mut [KnotRow; NZ]) {
        for (j, out) in p.iter_mut().enumerate() {
            let mut row = [0.0; STATE_ROW];
            if j < V_U {
                row = s[j];
            }
            if (V..U).contains(&j) {
                add_scaled(&mut row, self.half_h, &s[j - V]);
            } else if j >= U {
                add_scaled(&mut row, self.half_h, &s[j - U + V]);
            }
            for (i, n) in self.n.iter().enumerate() {
                add_scaled(&mut row, n[j], &s[V_U + i]);
            }
            *out = self.apply_transposed(&row);
        }
    }
}
