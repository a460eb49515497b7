//! Products, updates and the Cholesky decomposition of padded panels: the linear algebra underneath the factorisation and the gains.
//!
//! Rows are padded to a multiple of four entries. Columns, never terms of one sum, are neighbours in a vector register, so that results
//! do not depend on the width of the registers. Sums over entries are four sums side by side on every CPU.

use crate::dims::{Registers, kernels};
use upswing_model::MOST_JOINTS;

/// c += s a, of the length of `c`.
#[inline(always)]
pub(crate) fn shift_add(c: &mut [f64], s: f64, a: &[f64]) {
    let a = &a[..c.len()];
    let ((c4, c1), (a4, a1)) = (c.as_chunks_mut::<4>(), a.as_chunks::<4>());
    // Indices, not `zip`, whose constructor is not always inlined.
    for i in 0..c4.len() {
        for j in 0..4 {
            c4[i][j] += s * a4[i][j];
        }
    }
    for j in 0..c1.len() {
        c1[j] += s * a1[j];
    }
}

/// a . b
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let b = &b[..a.len()];
    let ((a4, a1), (b4, b1)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for i in 0..a4.len() {
        for j in 0..4 {
            sums[j] += a4[i][j] * b4[i][j];
        }
    }
    let mut rest = 0.0;
    for j in 0..a1.len() {
        rest += a1[j] * b1[j];
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Largest absolute value; NaN is ignored.
#[inline(always)]
pub(crate) fn amax(v: &[f64]) -> f64 {
    let (v4, v1) = v.as_chunks::<4>();
    let mut most = [0.0_f64; 4];
    for i in 0..v4.len() {
        for j in 0..4 {
            let a = v4[i][j].abs();
            most[j] = if a > most[j] { a } else { most[j] };
        }
    }
    let mut all = most[0].max(most[1]).max(most[2]).max(most[3]);
    for j in 0..v1.len() {
        all = all.max(v1[j].abs());
    }
    all
}

/// c += sum_l s_l a_l for `rank` rows a_l of `stride` and s_l = s[l `s_stride`]; the length of `c` is a multiple of 4.
///
/// Tiles of columns stay in registers: a third of the time of one [`shift_add`] per row.
#[inline(always)]
pub(crate) fn combine(c: &mut [f64], rank: usize, s: &[f64], s_stride: usize, a: &[f64], stride: usize) {
    let n = c.len();
    if rank == 0 {
        return;
    }
    assert!(n.is_multiple_of(4) && s.len() > (rank - 1) * s_stride && a.len() >= (rank - 1) * stride + n);
    let mut j = 0;
    while j + 8 <= n {
        // SAFETY: j + 8 <= n, and the assertion above covers all rows.
        unsafe { combine_tile::<8>(c, j, rank, s, s_stride, a, stride) };
        j += 8;
    }
    if j < n {
        // SAFETY: n is a multiple of 4, hence j + 4 <= n; the assertion above covers all rows.
        unsafe { combine_tile::<4>(c, j, rank, s, s_stride, a, stride) };
    }
}

/// Columns j to j + W of [`combine`].
///
/// # Safety
/// j + W <= c.len(), (rank - 1) s_stride < s.len() and (rank - 1) stride + j + W <= a.len().
#[inline(always)]
unsafe fn combine_tile<const W: usize>(
    c: &mut [f64],
    j: usize,
    rank: usize,
    s: &[f64],
    s_stride: usize,
    a: &[f64],
    stride: usize,
) {
    // SAFETY: by the caller; l < rank.
    unsafe {
        let out = &mut *c.as_mut_ptr().add(j).cast::<[f64; W]>();
        let mut sum = *out;
        for l in 0..rank {
            let factor = *s.get_unchecked(l * s_stride);
            let row = &*a.as_ptr().add(l * stride + j).cast::<[f64; W]>();
            for k in 0..W {
                sum[k] += factor * row[k];
            }
        }
        *out = sum;
    }
}

/// R rows and W columns of [`update_lower`], from row i and column j on.
///
/// # Safety
/// i + R and j + W within the rows and columns of `out`, `left` and `right`, which have at least `rank` rows.
#[inline(always)]
unsafe fn update_tile<const R: usize, const W: usize>(
    out: &mut [f64],
    stride: usize,
    i: usize,
    j: usize,
    rank: usize,
    left: &[f64],
    left_stride: usize,
    right: &[f64],
    right_stride: usize,
) {
    // SAFETY: by the caller; l < rank.
    unsafe {
        let mut sums = [[0.0; W]; R];
        for r in 0..R {
            sums[r] = *out.as_ptr().add((i + r) * stride + j).cast::<[f64; W]>();
        }
        for l in 0..rank {
            let s = &*left.as_ptr().add(l * left_stride + i).cast::<[f64; R]>();
            let row = &*right.as_ptr().add(l * right_stride + j).cast::<[f64; W]>();
            for r in 0..R {
                for c in 0..W {
                    sums[r][c] += s[r] * row[c];
                }
            }
        }
        for r in 0..R {
            *out.as_mut_ptr().add((i + r) * stride + j).cast::<[f64; W]>() = sums[r];
        }
    }
}

/// R rows of [`update_lower`] from row i on, up to the column `columns`, a multiple of 4.
///
/// # Safety
/// i + R and `columns` within the rows and columns of `out`, `left` and `right`, which have at least `rank` rows.
#[inline(always)]
unsafe fn update_rows<D: Registers, const R: usize>(
    out: &mut [f64],
    stride: usize,
    i: usize,
    columns: usize,
    rank: usize,
    left: &[f64],
    left_stride: usize,
    right: &[f64],
    right_stride: usize,
) {
    let mut j = 0;
    // Without AVX2 a wider tile does not fit into the registers.
    while D::AVX2 && j + 8 <= columns {
        // SAFETY: by the caller, and j + 8 <= columns.
        unsafe { update_tile::<R, 8>(out, stride, i, j, rank, left, left_stride, right, right_stride) };
        j += 8;
    }
    while j < columns {
        // SAFETY: by the caller; `columns` is a multiple of 4.
        unsafe { update_tile::<R, 4>(out, stride, i, j, rank, left, left_stride, right, right_stride) };
        j += 4;
    }
}

/// Lower triangle of the symmetric `out` plus sum_l left_l right_l', for `n` rows of `stride` in `out` and `rank` rows in `left` and
/// `right`. Entries above the diagonal become meaningless where they share a tile with the triangle; [`mirror`] sets them.
///
/// Tiles of four rows and eight columns stay in registers. With half of the entries left out, this is less than half the time of
/// [`combine`] on all rows. Inlined where the compiler knows the rank; [`rank_update`] is the same as a function of its own.
#[inline(always)]
pub(crate) fn update_lower<D: Registers>(
    d: D,
    out: &mut [f64],
    stride: usize,
    n: usize,
    rank: usize,
    left: &[f64],
    left_stride: usize,
    right: &[f64],
    right_stride: usize,
) {
    let _ = d;
    assert!(
        stride.is_multiple_of(4)
            && n <= stride
            && stride <= right_stride
            && n <= left_stride
            && out.len() >= n * stride
            && left.len() >= rank * left_stride
            && right.len() >= rank * right_stride
    );
    let mut i = 0;
    while i + 4 <= n {
        // SAFETY: i + 3 < n <= stride, and the assertion above covers all rows.
        unsafe {
            update_rows::<D, 4>(out, stride, i, i + 4, rank, left, left_stride, right, right_stride);
        }
        i += 4;
    }
    let columns = n.next_multiple_of(4);
    if i + 2 <= n {
        // SAFETY: i + 1 < n and columns <= stride; the assertion above covers all rows.
        unsafe {
            update_rows::<D, 2>(out, stride, i, columns, rank, left, left_stride, right, right_stride);
        }
        i += 2;
    }
    if i < n {
        combine(&mut out[i * stride..][..columns], rank, &left[i..], left_stride, right, right_stride);
    }
}

/// Copies rows i to i + 4 and columns j to j + 4 of [`mirror`], j < i, to rows j to j + 4.
///
/// # Safety
/// Rows and columns up to i + 3 and j + 3 are within `out`.
#[inline(always)]
unsafe fn mirror_block<D: Registers>(out: &mut [f64], stride: usize, i: usize, j: usize) {
    // SAFETY: by the caller; the reads are done before the writes, and a `D` with AVX2 exists only where the CPU has it.
    unsafe {
        let from = out.as_ptr().add(i * stride + j);
        let to = out.as_mut_ptr().add(j * stride + i);
        #[cfg(target_arch = "x86_64")]
        if D::AVX2 {
            use std::arch::x86_64::*;
            let row = |l: usize| _mm256_loadu_pd(from.add(l * stride));
            let (r0, r1, r2, r3) = (row(0), row(1), row(2), row(3));
            let (even, odd) = (_mm256_unpacklo_pd(r0, r1), _mm256_unpackhi_pd(r0, r1));
            let (even_2, odd_2) = (_mm256_unpacklo_pd(r2, r3), _mm256_unpackhi_pd(r2, r3));
            _mm256_storeu_pd(to, _mm256_permute2f128_pd::<0x20>(even, even_2));
            _mm256_storeu_pd(to.add(stride), _mm256_permute2f128_pd::<0x20>(odd, odd_2));
            _mm256_storeu_pd(to.add(2 * stride), _mm256_permute2f128_pd::<0x31>(even, even_2));
            _mm256_storeu_pd(to.add(3 * stride), _mm256_permute2f128_pd::<0x31>(odd, odd_2));
            return;
        }
        let row = |l: usize| *from.add(l * stride).cast::<[f64; 4]>();
        let block = [row(0), row(1), row(2), row(3)];
        for l in 0..4 {
            *to.add(l * stride).cast::<[f64; 4]>() = [block[0][l], block[1][l], block[2][l], block[3][l]];
        }
    }
}

kernels! {
    /// [`update_lower`]
    pub(crate) fn rank_update(
        d: D,
        out: &mut [f64],
        stride: usize,
        n: usize,
        rank: usize,
        left: &[f64],
        left_stride: usize,
        right: &[f64],
        right_stride: usize,
    ) {
        update_lower(d, out, stride, n, rank, left, left_stride, right, right_stride);
    }

    /// Copies the lower triangle of `n` rows to above the diagonal.
    pub(crate) fn mirror(d: D, out: &mut [f64], stride: usize, n: usize) {
        assert!(stride.is_multiple_of(4) && n <= stride && out.len() >= n * stride);
        // Whole blocks of four rows and columns, which take a quarter of the time of their entries one by one.
        let whole = n - n % 4;
        for i in (0..whole).step_by(4) {
            for j in (0..i).step_by(4) {
                // SAFETY: i + 3 and j + 3 are less than n, hence rows and columns of `out` by the assertion above.
                unsafe { mirror_block::<D>(out, stride, i, j) };
            }
        }
        for i in 0..n {
            // The blocks left of the diagonal are done.
            let first = if i < whole { i - i % 4 } else { 0 };
            for j in first..i {
                out[j * stride + i] = out[i * stride + j];
            }
        }
    }

    /// Eliminates `n` variables of a quadratic form from its `rows` of them: these become L^-1 times what they were, for the factors
    /// L D L' (Cholesky's decomposition without square roots) of the symmetric block whose columns begin at `at`. `lower` becomes rows
    /// of `n` of L below its diagonal of ones, `inverse` the inverses of the diagonal D. Of the block the lower triangle is read.
    /// `false` unless it is positive definite.
    pub(crate) fn eliminate(
        d: D,
        rows: &mut [f64],
        stride: usize,
        at: usize,
        n: usize,
        lower: &mut [f64],
        inverse: &mut [f64],
    ) -> bool {
        let (rows, lower, inverse) = (&mut rows[..n * stride], &mut lower[..n * n], &mut inverse[..n]);
        for i in 1..n {
            for j in 0..i {
                rows[j * stride + at + i] = rows[i * stride + at + j];
            }
        }
        for i in 0..n {
            let (done, rest) = rows.split_at_mut(i * stride);
            let row = &mut rest[..stride];
            let mut s = [0.0; MOST_JOINTS];
            for l in 0..i {
                let known = done[l * stride + at + i] * inverse[l];
                lower[i * n + l] = known;
                s[l] = -known;
            }
            combine(row, i, &s, 1, done, stride);
            let pivot = row[at + i];
            // A NaN is refused, too.
            if !(pivot > 0.0 && pivot.is_finite()) {
                return false;
            }
            inverse[i] = 1.0 / pivot;
        }
        true
    }
}

/// out = -D^-1 b for the factors of [`eliminate`] and `n` rows of `stride`.
#[inline(always)]
pub(crate) fn divide_negative(inverse: &[f64], n: usize, b: &[f64], out: &mut [f64], stride: usize) {
    for i in 0..n {
        let (b, out) = (&b[i * stride..][..stride], &mut out[i * stride..][..stride]);
        for j in 0..stride {
            out[j] = -inverse[i] * b[j];
        }
    }
}

/// b = L'^-1 b for the factors of [`eliminate`] and `n` rows of `stride`.
#[inline(always)]
pub(crate) fn backward(lower: &[f64], n: usize, b: &mut [f64], stride: usize) {
    for i in (0..n).rev() {
        let (rest, done) = b.split_at_mut((i + 1) * stride);
        let mut s = [0.0; MOST_JOINTS];
        for l in i + 1..n {
            s[l - i - 1] = -lower[l * n + i];
        }
        combine(&mut rest[i * stride..], n - 1 - i, &s, 1, done, stride);
    }
}

/// x = -P^-1 b for the factors of [`eliminate`] and one column of `n` entries.
#[inline(always)]
pub(crate) fn solve_negative(lower: &[f64], inverse: &[f64], n: usize, b: &[f64], x: &mut [f64]) {
    let (lower, inverse, b, x) = (&lower[..n * n], &inverse[..n], &b[..n], &mut x[..n]);
    for i in 0..n {
        x[i] = -b[i];
        for l in 0..i {
            x[i] -= lower[i * n + l] * x[l];
        }
    }
    for i in (0..n).rev() {
        x[i] *= inverse[i];
        for l in i + 1..n {
            x[i] -= lower[l * n + i] * x[l];
        }
    }
}

/// rows = E^-1 rows for a matrix E of `n` rows, by Gaussian elimination with row pivots, which overwrites E. What a singular E leaves
/// is not finite.
#[inline(always)]
pub(crate) fn solve_rows(e: &mut [f64], n: usize, rows: &mut [f64], stride: usize) {
    for p in 0..n {
        let mut best = p;
        for i in p + 1..n {
            if e[i * n + p].abs() > e[best * n + p].abs() {
                best = i;
            }
        }
        if best != p {
            for j in 0..n {
                e.swap(p * n + j, best * n + j);
            }
            for j in 0..stride {
                rows.swap(p * stride + j, best * stride + j);
            }
        }
        for i in p + 1..n {
            let factor = e[i * n + p] / e[p * n + p];
            let (done, rest) = e.split_at_mut(i * n);
            shift_add(&mut rest[p..n], -factor, &done[p * n + p..][..n - p]);
            let (done, rest) = rows.split_at_mut(i * stride);
            shift_add(&mut rest[..stride], -factor, &done[p * stride..][..stride]);
        }
    }
    for p in (0..n).rev() {
        let (rest, done) = rows.split_at_mut((p + 1) * stride);
        let row = &mut rest[p * stride..];
        for l in p + 1..n {
            shift_add(row, -e[p * n + l], &done[(l - p - 1) * stride..][..stride]);
        }
        for j in 0..stride {
            row[j] /= e[p * n + p];
        }
    }
}

#[cfg(test)]
mod tests;
