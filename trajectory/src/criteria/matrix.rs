//! Products of small dense matrices without allocation, with the same bits on every CPU.

use std::ops::{Index, IndexMut};

/// Entries of a register of 256 bits.
const LANES: usize = 4;

/// A dense matrix by rows, each padded with zeros to whole registers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Matrix {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
    stride: usize,
}

impl Matrix {
    /// The matrix 0.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        let stride = columns.next_multiple_of(LANES);
        Self { values: vec![0.0; rows * stride], rows, columns, stride }
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    /// All entries, and the zeros that pad the rows.
    pub fn as_slice(&self) -> &[f64] {
        &self.values
    }

    /// Row `i`.
    pub fn row(&self, i: usize) -> &[f64] {
        &self.values[i * self.stride..][..self.columns]
    }

    /// Row `i`, to be written.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.values[i * self.stride..][..self.columns]
    }

    pub fn fill(&mut self, value: f64) {
        (0..self.rows).for_each(|i| self.row_mut(i).fill(value));
    }

    /// Largest magnitude; NaN if one is.
    pub fn amax(&self) -> f64 {
        let larger = |most: f64, v: &f64| if most.is_nan() || v.abs() <= most { most } else { v.abs() };
        self.values.iter().fold(0.0, larger)
    }

    pub fn divide(&mut self, divisor: f64) {
        self.values.iter_mut().for_each(|v| *v /= divisor);
    }

    /// self += other, of the same shape.
    pub fn add(&mut self, other: &Self) {
        assert_eq!((self.rows, self.columns), (other.rows, other.columns), "shapes");
        self.values.iter_mut().zip(&other.values).for_each(|(v, o)| *v += o);
    }

    /// self = a b.
    pub fn set_product(&mut self, a: &Self, b: &Self) {
        assert_eq!((self.rows, self.columns, a.columns), (a.rows, b.columns, b.rows), "shapes");
        product(&mut self.values, self.rows, self.stride, &a.values, a.stride, 1, &b.values, a.columns);
    }

    /// self = a' b.
    pub fn set_transposed_product(&mut self, a: &Self, b: &Self) {
        assert_eq!((self.rows, self.columns, a.rows), (a.columns, b.columns, b.rows), "shapes");
        product(&mut self.values, self.rows, self.stride, &a.values, 1, a.stride, &b.values, a.rows);
    }

    /// self = m' p m for square matrices; `scratch` has their shape.
    pub fn set_congruence(&mut self, p: &Self, m: &Self, scratch: &mut Self) {
        scratch.set_product(p, m);
        self.set_transposed_product(m, scratch);
    }

    /// self = m^n for a square `m` and `n` of 1 or above; `scratch` has its shape.
    pub fn set_power(&mut self, m: &Self, n: u32, scratch: &mut Self) {
        self.values.copy_from_slice(&m.values);
        // The bits below the highest one, from the top.
        for bit in (0..n.ilog2()).rev() {
            scratch.set_product(self, self);
            std::mem::swap(self, scratch);
            if n >> bit & 1 == 1 {
                scratch.set_product(self, m);
                std::mem::swap(self, scratch);
            }
        }
    }
}

impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    #[inline]
    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        assert!(j < self.columns, "column {j} of {}", self.columns);
        &self.values[i * self.stride + j]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    #[inline]
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        assert!(j < self.columns, "column {j} of {}", self.columns);
        &mut self.values[i * self.stride + j]
    }
}

#[cfg(test)]
impl From<&nalgebra::DMatrix<f64>> for Matrix {
    fn from(dense: &nalgebra::DMatrix<f64>) -> Self {
        let mut m = Self::zeros(dense.nrows(), dense.ncols());
        for (i, row) in dense.row_iter().enumerate() {
            m.row_mut(i).iter_mut().zip(row.iter()).for_each(|(v, d)| *v = *d);
        }
        m
    }
}

#[cfg(test)]
impl From<&Matrix> for nalgebra::DMatrix<f64> {
    fn from(m: &Matrix) -> Self {
        Self::from_fn(m.rows, m.columns, |i, j| m[(i, j)])
    }
}

/// out = a b for `rows` rows of `out`; the entry (i, l) of a, l < `inner`, is a[i `a_row` + l `a_column`]. `out` and `b` have rows of `stride`.
fn product(
    out: &mut [f64],
    rows: usize,
    stride: usize,
    a: &[f64],
    a_row: usize,
    a_column: usize,
    b: &[f64],
    inner: usize,
) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the CPU has AVX2.
        return unsafe { product_avx2(out, rows, stride, a, a_row, a_column, b, inner) };
    }
    product_here::<4>(out, rows, stride, a, a_row, a_column, b, inner);
}

/// [`product`] with registers of 256 bits, and the same bits: nothing is contracted to fused operations.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn product_avx2(
    out: &mut [f64],
    rows: usize,
    stride: usize,
    a: &[f64],
    a_row: usize,
    a_column: usize,
    b: &[f64],
    inner: usize,
) {
    product_here::<8>(out, rows, stride, a, a_row, a_column, b, inner);
}

/// Tiles of four rows and at most `WIDE` columns stay in registers.
#[inline(always)]
fn product_here<const WIDE: usize>(
    out: &mut [f64],
    rows: usize,
    stride: usize,
    a: &[f64],
    a_row: usize,
    a_column: usize,
    b: &[f64],
    inner: usize,
) {
    if rows == 0 || inner == 0 {
        return out.fill(0.0);
    }
    assert!(
        stride.is_multiple_of(LANES)
            && out.len() >= rows * stride
            && a.len() > (rows - 1) * a_row + (inner - 1) * a_column
            && b.len() >= inner * stride
    );
    let mut i = 0;
    while i < rows {
        let mut j = 0;
        while j < stride {
            // SAFETY: rows and columns of the tile are below `rows` and `stride`, a multiple of 4, and the assertion above covers all.
            unsafe {
                match (rows - i >= 4, stride - j >= WIDE) {
                    (true, true) => tile::<4, WIDE>(out, stride, i, j, a, a_row, a_column, b, inner),
                    (true, false) => tile::<4, LANES>(out, stride, i, j, a, a_row, a_column, b, inner),
                    (false, true) => tile::<1, WIDE>(out, stride, i, j, a, a_row, a_column, b, inner),
                    (false, false) => tile::<1, LANES>(out, stride, i, j, a, a_row, a_column, b, inner),
                }
            }
            j += if stride - j >= WIDE { WIDE } else { LANES };
        }
        i += if rows - i >= 4 { 4 } else { 1 };
    }
}

/// R rows and W columns of [`product`], from row i and column j on.
///
/// # Safety
/// Rows below i + R and columns below j + W exist in `out`, the rows in `a`, the columns in `b`, for all l < `inner`.
#[inline(always)]
unsafe fn tile<const R: usize, const W: usize>(
    out: &mut [f64],
    stride: usize,
    i: usize,
    j: usize,
    a: &[f64],
    a_row: usize,
    a_column: usize,
    b: &[f64],
    inner: usize,
) {
    let mut sums = [[0.0; W]; R];
    // SAFETY: by the caller.
    unsafe {
        for l in 0..inner {
            let row = &*b.as_ptr().add(l * stride + j).cast::<[f64; W]>();
            for r in 0..R {
                let factor = *a.get_unchecked((i + r) * a_row + l * a_column);
                for c in 0..W {
                    sums[r][c] += factor * row[c];
                }
            }
        }
        for r in 0..R {
            *out.as_mut_ptr().add((i + r) * stride + j).cast::<[f64; W]>() = sums[r];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use proptest::prelude::*;

    fn dense(m: &Matrix) -> DMatrix<f64> {
        m.into()
    }

    fn matrix(rows: usize, columns: usize, numbers: &[f64]) -> Matrix {
        Matrix::from(&DMatrix::from_row_slice(rows, columns, &numbers[..rows * columns]))
    }

    proptest! {
        #[test]
        fn products_are_those_of_a_library(
            (n, m, k) in (1..40_usize, 1..40_usize, 1..40_usize),
            numbers in proptest::collection::vec(-1.0..1.0_f64, 3 * 1600),
        ) {
            let (a, b, t) = (
                matrix(n, k, &numbers),
                matrix(k, m, &numbers[1600..]),
                matrix(k, n, &numbers[3200..]),
            );
            let mut out = Matrix::zeros(n, m);
            out.fill(f64::NAN);
            out.set_product(&a, &b);
            // Rounding of sums of 40 numbers below 1.
            prop_assert!((dense(&out) - dense(&a) * dense(&b)).amax() < 1e-13);
            let wide = out.clone();
            product_here::<4>(&mut out.values, n, out.stride, &a.values, a.stride, 1, &b.values, k);
            prop_assert_eq!(&out, &wide);
            out.set_transposed_product(&t, &b);
            prop_assert!((dense(&out) - dense(&t).tr_mul(&dense(&b))).amax() < 1e-13);
        }
    }

    #[test]
    fn a_power_is_that_many_products() {
        let numbers: Vec<f64> = (0..25).map(|i| ((i * 7919 + 17) % 1009) as f64 / 2500.0 - 0.2).collect();
        let m = matrix(5, 5, &numbers);
        let (mut power, mut scratch) = (Matrix::zeros(5, 5), Matrix::zeros(5, 5));
        let mut product = DMatrix::identity(5, 5);
        for n in 1..40 {
            power.set_power(&m, n, &mut scratch);
            product = &product * &dense(&m);
            assert!((dense(&power) - &product).amax() < 1e-14, "{n}");
        }
    }
}
