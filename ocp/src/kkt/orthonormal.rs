//! The rows of the target condition, orthonormal.

use super::{DependentTargetRow, TargetRow};
use crate::kernels::{dot, shift_add};
use upswing_model::Dims;

/// T = L Q with orthonormal rows Q, by the modified Gram-Schmidt method.
///
/// T' (T T')^-1 T = Q' Q, so that a penalty on Q x is as stiff along each direction of the target, whatever the scale of the rows of T
/// and the angles between them.
#[derive(Clone, Debug)]
pub(super) struct OrthonormalTarget {
    /// Q, rows over states; as many of them as T has are in use.
    rows: Vec<f64>,
    /// L, row i has i + 1 entries.
    lower: Vec<f64>,
    count: usize,
}

impl OrthonormalTarget {
    /// Memory for as many rows as a state has entries: more of them depend on each other.
    pub(super) fn new(d: impl Dims) -> Self {
        let most = d.state();
        Self { rows: vec![0.0; most * d.state_row()], lower: vec![0.0; most * (most + 1) / 2], count: 0 }
    }

    /// Decomposes `target`.
    ///
    /// # Errors
    /// [`DependentTargetRow`] with the first row that depends on the rows before it.
    pub(super) fn set(&mut self, d: impl Dims, target: &[TargetRow]) -> Result<(), DependentTargetRow> {
        /// Least share of a row that the rows before it do not span.
        const INDEPENDENT: f64 = 1e-8;
        let row = d.state_row();
        self.count = target.len();
        for (i, target) in target.iter().enumerate() {
            // There is no memory for more rows, nor can they be independent.
            if i == d.state() {
                return Err(DependentTargetRow { row: i });
            }
            let (done, rest) = self.rows.split_at_mut(i * row);
            let q = &mut rest[..row];
            q.copy_from_slice(&target.coefficients.padded()[..row]);
            let before = dot(q, q).sqrt();
            let lower = &mut self.lower[i * (i + 1) / 2..][..=i];
            for (j, known) in done.chunks_exact(row).enumerate() {
                lower[j] = dot(known, q);
                shift_add(q, -lower[j], known);
            }
            let length = dot(q, q).sqrt();
            // A NaN is refused, too.
            if !(length > INDEPENDENT * before) {
                return Err(DependentTargetRow { row: i });
            }
            lower[i] = length;
            for v in q {
                *v /= length;
            }
        }
        Ok(())
    }

    /// Q
    pub(super) fn rows(&self, d: impl Dims) -> &[f64] {
        &self.rows[..self.count * d.state_row()]
    }

    /// out = L^-1 r
    pub(super) fn forward(&self, r: &[f64], out: &mut [f64]) {
        for i in 0..self.count {
            let lower = &self.lower[i * (i + 1) / 2..][..=i];
            out[i] = (r[i] - dot(&lower[..i], out)) / lower[i];
        }
    }

    /// m = L'^-1 m
    pub(super) fn backward(&self, m: &mut [f64]) {
        for i in (0..self.count).rev() {
            let lower = &self.lower[i * (i + 1) / 2..][..=i];
            m[i] /= lower[i];
            let (rest, last) = m.split_at_mut(i);
            shift_add(rest, -last[0], lower);
        }
    }
}
