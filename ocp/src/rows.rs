//! Rows of matrices over states and inputs, padded to full vector registers, and the row operations of Riccati recursions.
//!
//! The sums are written so that a compiler may put neighbouring columns, never terms of one sum, into the lanes of a
//! vector register: results do not depend on the width of the registers.

use crate::fixed::{ActuatedVector, NU, NX, NZ};

/// Entries of a row over states, rounded up to full vector registers; those beyond NX are zero.
pub(crate) const STATE_ROW: usize = NX.next_multiple_of(4);
pub(crate) type StateRow = [f64; STATE_ROW];
/// Entries of a row over z = (x, u), rounded up in the same way.
pub(crate) const KNOT_ROW: usize = NZ.next_multiple_of(4);

/// c += s a
#[inline(always)]
pub(crate) fn add_scaled<const W: usize>(c: &mut [f64; W], s: f64, a: &[f64; W]) {
    for j in 0..W {
        c[j] += s * a[j];
    }
}

/// Cholesky factor of a symmetric NU x NU block, and the inverses of its diagonal.
///
/// This is not nalgebra's decomposition: the right-hand sides are the columns of padded rows, solved side by side in vector registers,
/// and divisions by the diagonal become products. The bits of every database depend on the order of these operations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pivot {
    lower: [[f64; NU]; NU],
    inverse: [f64; NU],
}

impl Pivot {
    pub(crate) const ZERO: Self = Self { lower: [[0.0; NU]; NU], inverse: [0.0; NU] };

    /// Of a symmetric block; `None` unless it is positive definite.
    pub(crate) fn new(p: &[[f64; NU]; NU]) -> Option<Self> {
        let mut out = Self::ZERO;
        for i in 0..NU {
            for j in 0..=i {
                let mut sum = p[i][j];
                for l in 0..j {
                    sum -= out.lower[i][l] * out.lower[j][l];
                }
                if j < i {
                    out.lower[i][j] = sum * out.inverse[j];
                } else {
                    // A NaN is refused, too.
                    if !(sum > 0.0 && sum.is_finite()) {
                        return None;
                    }
                    let root = sum.sqrt();
                    (out.lower[i][i], out.inverse[i]) = (root, 1.0 / root);
                }
            }
        }
        Some(out)
    }

    /// L^-1 b, for several columns at a time.
    #[inline(always)]
    pub(crate) fn forward<const W: usize>(&self, b: &mut [[f64; W]; NU]) {
        for i in 0..NU {
            let (done, rest) = b.split_at_mut(i);
            for (l, known) in done.iter().enumerate() {
                add_scaled(&mut rest[0], -self.lower[i][l], known);
            }
            rest[0].iter_mut().for_each(|v| *v *= self.inverse[i]);
        }
    }

    /// L'^-1 b
    #[inline(always)]
    pub(crate) fn backward<const W: usize>(&self, b: &mut [[f64; W]; NU]) {
        for i in (0..NU).rev() {
            let (rest, done) = b.split_at_mut(i + 1);
            for (l, known) in done.iter().enumerate() {
                add_scaled(&mut rest[i], -self.lower[i + 1 + l][i], known);
            }
            rest[i].iter_mut().for_each(|v| *v *= self.inverse[i]);
        }
    }

    /// -(L L')^-1 b
    #[inline(always)]
    pub(crate) fn solve_negative(&self, b: &[f64]) -> ActuatedVector {
        let mut y: [[f64; 1]; NU] = std::array::from_fn(|i| [-b[i]]);
        self.forward(&mut y);
        self.backward(&mut y);
        ActuatedVector::from_fn(|i, _| y[i][0])
    }
}
