//! Solves M x = b for the mass matrix M of the whole chain. A simulation with a decomposition for matrices of any size
//! spends a fifth of its time in it; the operations and their order are those of nalgebra.

use crate::{JointMatrix, JointVector, NQ};

/// x of `m` x = `b` for a symmetric `m`, of which the lower triangle is read, by the Cholesky decomposition; `None` if it
/// is not positive definite.
pub(crate) fn solve(m: &JointMatrix, b: &JointVector) -> Option<JointVector> {
    let mut l = *m;
    for j in 0..NQ {
        for k in 0..j {
            let factor = l[(j, k)];
            for i in j..NQ {
                l[(i, j)] -= factor * l[(i, k)];
            }
        }
        let diagonal = l[(j, j)];
        // Written so that NaN is refused.
        if !(diagonal > 0.0) {
            return None;
        }
        let root = diagonal.sqrt();
        l[(j, j)] = root;
        for i in j + 1..NQ {
            l[(i, j)] /= root;
        }
    }
    let mut x = *b;
    for j in 0..NQ {
        x[j] /= l[(j, j)];
        for i in j + 1..NQ {
            x[i] -= x[j] * l[(i, j)];
        }
    }
    for j in (0..NQ).rev() {
        x[j] = (x[j] - below(&l, &x, j)) / l[(j, j)];
    }
    Some(x)
}

// `below` adds in the order in which nalgebra does for nine rows; for other numbers that is another one.
const _: () = assert!(NQ == 9);

/// Column `j` of `l` below its diagonal times the same rows of `x`.
fn below(l: &JointMatrix, x: &JointVector, j: usize) -> f64 {
    let product = |i: usize| l[(j + 1 + i, j)] * x[j + 1 + i];
    if j == 0 {
        // Eight products are added in pairs.
        return (0..4).map(|i| product(i) + product(i + 4)).fold(0.0, |sum, pair| sum + pair);
    }
    (0..NQ - 1 - j).map(product).fold(0.0, |sum, p| sum + p)
}

#[cfg(test)]
mod tests {
    use super::solve;
    use crate::{JointMatrix, JointVector};

    #[test]
    fn every_bit_is_that_of_nalgebra() {
        // Any numbers that differ in all their digits.
        let mut seed = 0.3_f64;
        let mut next = || {
            seed = (seed * 997.1 + 0.137).fract();
            seed - 0.5
        };
        for _ in 0..1000 {
            let a = JointMatrix::from_fn(|_, _| next());
            let m = a * a.transpose() + JointMatrix::identity() * 0.01;
            let b = JointVector::from_fn(|_, _| next());
            assert_eq!(solve(&m, &b), Some(m.cholesky().expect("positive definite").solve(&b)));
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_no_solution() {
        let b = JointVector::zeros();
        let mut m = JointMatrix::identity();
        m[(4, 4)] = -1.0;
        assert_eq!(solve(&m, &b), None);
        m[(4, 4)] = f64::NAN;
        assert_eq!(solve(&m, &b), None);
    }
}
