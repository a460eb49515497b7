//! Vectors and matrices over the joints of a chain, with sizes known at run time and inline memory: they are `Copy`, and nothing
//! allocates.
//!
//! A vector belongs to a [`Space`]: all joints, the actuated ones, the unactuated ones, or the state. Vectors of different spaces are
//! different types. Entries beyond the length are 0, so that sums and multiples run over the whole memory without a branch.

use crate::{Dims, with_dims};
use std::fmt;
use std::marker::PhantomData;
use std::ops::{
    Add, AddAssign, Deref, DerefMut, Div, DivAssign, Index, IndexMut, Mul, MulAssign, Neg, Sub, SubAssign,
};

/// Largest number of joints of a chain.
pub const MOST_JOINTS: usize = 16;
/// Largest dimension of a state.
pub const LARGEST_STATE: usize = 2 * MOST_JOINTS;

/// Numbers of joints of a chain, of which all other dimensions follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sizes {
    joints: u8,
    actuated: u8,
}

impl Sizes {
    /// Sizes of a chain with `joints` joints, of which `actuated` have a motor; `None` unless the chain has an actuated joint, an
    /// unactuated joint and at most [`MOST_JOINTS`] joints.
    pub const fn new(joints: usize, actuated: usize) -> Option<Self> {
        if actuated == 0 || actuated >= joints || joints > MOST_JOINTS {
            return None;
        }
        // Lossless: both are at most 16.
        Some(Self { joints: joints as u8, actuated: actuated as u8 })
    }

    /// n, the number of joints: dimension of q = [q_A, q_U].
    #[inline]
    pub const fn joints(self) -> usize {
        self.joints as usize
    }

    /// n_A, the number of actuated joints: dimension of q_A, of the input u = qdd_A and of the motor torque tau_A.
    #[inline]
    pub const fn actuated(self) -> usize {
        self.actuated as usize
    }

    /// n_U, the number of unactuated joints: dimension of q_U.
    #[inline]
    pub const fn unactuated(self) -> usize {
        self.joints() - self.actuated()
    }

    /// Dimension of the state x = [q, qd].
    #[inline]
    pub const fn state(self) -> usize {
        2 * self.joints()
    }

    /// Dimension of a collocation knot z = [x, u].
    #[inline]
    pub const fn knot(self) -> usize {
        self.state() + self.actuated()
    }
}

/// What the entries of a vector belong to.
pub trait Space: Copy + fmt::Debug + PartialEq + Send + Sync + 'static {
    /// Length of a vector of this space.
    fn length(sizes: impl Dims) -> usize;
}

macro_rules! spaces {
    ($($(#[$doc:meta])* $name:ident: $length:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name;

        impl Space for $name {
            #[inline(always)]
            fn length(sizes: impl Dims) -> usize {
                sizes.$length()
            }
        }
    )*};
}

spaces! {
    /// All joints, the actuated ones first.
    Joints: joints;
    /// The actuated joints, A.
    Actuated: actuated;
    /// The unactuated joints, U.
    Unactuated: unactuated;
    /// The state [q, qd].
    States: state;
}

/// A vector of the space `S` with memory for `CAPACITY` entries. It dereferences to the slice of its entries.
#[derive(Clone, Copy, PartialEq)]
pub struct Vector<S, const CAPACITY: usize> {
    /// 0 beyond the length.
    values: [f64; CAPACITY],
    sizes: Sizes,
    space: PhantomData<S>,
}

/// One component per joint, [A, U]: q (rad or m), qd, qdd or joint torques and forces (N m or N).
pub type JointVector = Vector<Joints, MOST_JOINTS>;
/// One component per actuated joint: q_A (rad or m), qd_A, u = qdd_A or tau_A (N m or N).
pub type ActuatedVector = Vector<Actuated, MOST_JOINTS>;
/// One component per unactuated joint: q_U (rad or m), qd_U, qdd_U or torques and forces (N m or N).
pub type UnactuatedVector = Vector<Unactuated, MOST_JOINTS>;
/// State x = [q_A, q_U, qd_A, qd_U], or its time derivative.
pub type State = Vector<States, LARGEST_STATE>;

impl<S: Space, const CAPACITY: usize> Vector<S, CAPACITY> {
    /// The vector 0.
    #[inline]
    pub const fn zeros(sizes: Sizes) -> Self {
        Self { values: [0.0; CAPACITY], sizes, space: PhantomData }
    }

    /// The vector whose entry i is `entry(i)`.
    #[inline]
    pub fn from_fn(sizes: Sizes, mut entry: impl FnMut(usize) -> f64) -> Self {
        let mut vector = Self::zeros(sizes);
        for (i, value) in vector.iter_mut().enumerate() {
            *value = entry(i);
        }
        vector
    }

    /// The vector whose entries are all `value`.
    pub fn repeat(sizes: Sizes, value: f64) -> Self {
        Self::from_fn(sizes, |_| value)
    }

    /// The vector of `values`; `None` if their number is not that of the space.
    #[inline]
    pub fn from_slice(sizes: Sizes, values: &[f64]) -> Option<Self> {
        let mut vector = Self::zeros(sizes);
        (values.len() == vector.len()).then(|| {
            vector.copy_from_slice(values);
            vector
        })
    }

    /// Numbers of joints of the chain.
    #[inline]
    pub const fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// The entries.
    #[inline]
    pub fn as_slice(&self) -> &[f64] {
        self
    }

    /// The entries, followed by zeros.
    #[inline]
    pub const fn padded(&self) -> &[f64; CAPACITY] {
        &self.values
    }

    /// The vector whose entry i is `f` of entry i.
    #[inline]
    pub fn map(&self, mut f: impl FnMut(f64) -> f64) -> Self {
        Self::from_fn(self.sizes, |i| f(self.values[i]))
    }

    /// The vector whose entry i is `f` of the entries i of both.
    #[inline]
    pub fn zip_map(&self, other: &Self, mut f: impl FnMut(f64, f64) -> f64) -> Self {
        debug_assert_eq!(self.sizes, other.sizes);
        Self::from_fn(self.sizes, |i| f(self.values[i], other.values[i]))
    }

    /// Products of the entries.
    #[inline]
    pub fn component_mul(&self, other: &Self) -> Self {
        self.zip_whole(other, |a, b| a * b)
    }

    /// Quotients of the entries.
    #[inline]
    pub fn component_div(&self, other: &Self) -> Self {
        self.zip_map(other, |a, b| a / b)
    }

    /// The smaller ones of the entries.
    #[inline]
    pub fn inf(&self, other: &Self) -> Self {
        self.zip_whole(other, f64::min)
    }

    /// The larger ones of the entries.
    #[inline]
    pub fn sup(&self, other: &Self) -> Self {
        self.zip_whole(other, f64::max)
    }

    /// `f` of the entries of both over the whole memory, for an `f` that is 0 of zeros.
    #[inline]
    fn zip_whole(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        debug_assert_eq!(self.sizes, other.sizes);
        let mut out = Self::zeros(self.sizes);
        for i in 0..CAPACITY {
            out.values[i] = f(self.values[i], other.values[i]);
        }
        out
    }

    /// Absolute values of the entries.
    pub fn abs(&self) -> Self {
        self.map(f64::abs)
    }

    /// Scalar product.
    #[inline]
    pub fn dot(&self, other: &Self) -> f64 {
        self.iter().zip(other.iter()).map(|(a, b)| a * b).sum()
    }

    /// Square of the Euclidean norm.
    pub fn norm_squared(&self) -> f64 {
        self.dot(self)
    }

    /// Euclidean norm.
    pub fn norm(&self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// Largest absolute value of an entry; entries that are NaN are ignored.
    pub fn amax(&self) -> f64 {
        self.iter().fold(0.0, |worst: f64, v| worst.max(v.abs()))
    }
}

impl<S, const CAPACITY: usize> fmt::Debug for Vector<S, CAPACITY>
where
    S: Space,
{
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<S: Space, const CAPACITY: usize> Deref for Vector<S, CAPACITY> {
    type Target = [f64];

    #[inline]
    fn deref(&self) -> &[f64] {
        // The length of a space never exceeds the capacity; `min` lets the compiler see it.
        &self.values[..S::length(self.sizes).min(CAPACITY)]
    }
}

impl<S: Space, const CAPACITY: usize> DerefMut for Vector<S, CAPACITY> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.values[..S::length(self.sizes).min(CAPACITY)]
    }
}

macro_rules! entrywise {
    ($($trait:ident $operator:ident, $assign_trait:ident $assign:ident;)*) => {$(
        impl<S: Space, const CAPACITY: usize> $assign_trait<&Self> for Vector<S, CAPACITY> {
            #[inline]
            fn $assign(&mut self, other: &Self) {
                debug_assert_eq!(self.sizes, other.sizes);
                for i in 0..CAPACITY {
                    self.values[i].$assign(other.values[i]);
                }
            }
        }

        impl<S: Space, const CAPACITY: usize> $assign_trait for Vector<S, CAPACITY> {
            #[inline]
            fn $assign(&mut self, other: Self) {
                self.$assign(&other);
            }
        }

        impl<S: Space, const CAPACITY: usize> $trait for Vector<S, CAPACITY> {
            type Output = Self;

            #[inline]
            fn $operator(self, other: Self) -> Self {
                (&self).$operator(&other)
            }
        }

        impl<S: Space, const CAPACITY: usize> $trait<&Self> for Vector<S, CAPACITY> {
            type Output = Self;

            #[inline]
            fn $operator(self, other: &Self) -> Self {
                (&self).$operator(other)
            }
        }

        impl<S: Space, const CAPACITY: usize> $trait<Vector<S, CAPACITY>> for &Vector<S, CAPACITY> {
            type Output = Vector<S, CAPACITY>;

            #[inline]
            fn $operator(self, other: Vector<S, CAPACITY>) -> Vector<S, CAPACITY> {
                self.$operator(&other)
            }
        }

        impl<S: Space, const CAPACITY: usize> $trait for &Vector<S, CAPACITY> {
            type Output = Vector<S, CAPACITY>;

            #[inline]
            fn $operator(self, other: Self) -> Vector<S, CAPACITY> {
                debug_assert_eq!(self.sizes, other.sizes);
                // Not a changed copy: copies of whole vectors are calls.
                let mut out = Vector::zeros(self.sizes);
                for i in 0..CAPACITY {
                    out.values[i] = self.values[i].$operator(other.values[i]);
                }
                out
            }
        }
    )*};
}

entrywise! {
    Add add, AddAssign add_assign;
    Sub sub, SubAssign sub_assign;
}

impl<S: Space, const CAPACITY: usize> Vector<S, CAPACITY> {
    #[inline]
    fn scaled(&self, factor: f64) -> Self {
        let mut out = Self::zeros(self.sizes);
        if factor.is_finite() {
            for i in 0..CAPACITY {
                out.values[i] = self.values[i] * factor;
            }
        } else {
            // The zeros beyond the entries would become NaN.
            for (out, v) in out.iter_mut().zip(self.iter()) {
                *out = v * factor;
            }
        }
        out
    }
}

impl<S: Space, const CAPACITY: usize> MulAssign<f64> for Vector<S, CAPACITY> {
    #[inline]
    fn mul_assign(&mut self, factor: f64) {
        *self = self.scaled(factor);
    }
}

impl<S: Space, const CAPACITY: usize> Mul<f64> for Vector<S, CAPACITY> {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        self.scaled(factor)
    }
}

impl<S: Space, const CAPACITY: usize> Mul<f64> for &Vector<S, CAPACITY> {
    type Output = Vector<S, CAPACITY>;

    #[inline]
    fn mul(self, factor: f64) -> Vector<S, CAPACITY> {
        self.scaled(factor)
    }
}

impl<S: Space, const CAPACITY: usize> DivAssign<f64> for Vector<S, CAPACITY> {
    #[inline]
    fn div_assign(&mut self, divisor: f64) {
        self.iter_mut().for_each(|v| *v /= divisor);
    }
}

impl<S: Space, const CAPACITY: usize> Div<f64> for Vector<S, CAPACITY> {
    type Output = Self;

    #[inline]
    fn div(mut self, divisor: f64) -> Self {
        self /= divisor;
        self
    }
}

impl<S: Space, const CAPACITY: usize> Neg for Vector<S, CAPACITY> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        -&self
    }
}

impl<S: Space, const CAPACITY: usize> Neg for &Vector<S, CAPACITY> {
    type Output = Vector<S, CAPACITY>;

    #[inline]
    fn neg(self) -> Vector<S, CAPACITY> {
        let mut out = Vector::zeros(self.sizes);
        for i in 0..CAPACITY {
            out.values[i] = -self.values[i];
        }
        out
    }
}

impl State {
    /// The state [q, qd].
    #[inline]
    pub fn new(q: &JointVector, qd: &JointVector) -> Self {
        debug_assert_eq!(q.sizes, qd.sizes);
        let mut x = Self::zeros(q.sizes);
        // Whole memories: a copy of a length known at run time would be a call. The zeros of `q` give way to `qd`.
        x.values[..MOST_JOINTS].copy_from_slice(&q.values);
        let joints = q.sizes.joints().min(MOST_JOINTS);
        x.values[joints..joints + MOST_JOINTS].copy_from_slice(&qd.values);
        x
    }

    /// q, positions of all joints.
    #[inline]
    pub fn q(&self) -> JointVector {
        part(self, 0)
    }

    /// qd, velocities of all joints.
    #[inline]
    pub fn qd(&self) -> JointVector {
        part(self, self.sizes.joints())
    }

    /// q_A, positions of the actuated joints.
    #[inline]
    pub fn q_a(&self) -> ActuatedVector {
        part(self, 0)
    }

    /// q_U, positions of the unactuated joints.
    #[inline]
    pub fn q_u(&self) -> UnactuatedVector {
        part(self, self.sizes.actuated())
    }

    /// qd_A, velocities of the actuated joints.
    #[inline]
    pub fn qd_a(&self) -> ActuatedVector {
        part(self, self.sizes.joints())
    }

    /// qd_U, velocities of the unactuated joints.
    #[inline]
    pub fn qd_u(&self) -> UnactuatedVector {
        part(self, self.sizes.joints() + self.sizes.actuated())
    }

    /// q, to be written.
    #[inline]
    pub fn q_mut(&mut self) -> &mut [f64] {
        let joints = self.sizes.joints();
        &mut self[..joints]
    }

    /// qd, to be written.
    #[inline]
    pub fn qd_mut(&mut self) -> &mut [f64] {
        let joints = self.sizes.joints();
        &mut self[joints..]
    }

    /// q_A, to be written.
    #[inline]
    pub fn q_a_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self[..actuated]
    }

    /// q_U, to be written.
    #[inline]
    pub fn q_u_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self.q_mut()[actuated..]
    }

    /// qd_A, to be written.
    #[inline]
    pub fn qd_a_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self.qd_mut()[..actuated]
    }

    /// qd_U, to be written.
    #[inline]
    pub fn qd_u_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self.qd_mut()[actuated..]
    }
}

impl JointVector {
    /// The vector [a, u].
    pub fn joined(a: &ActuatedVector, u: &UnactuatedVector) -> Self {
        debug_assert_eq!(a.sizes, u.sizes);
        let actuated = a.sizes.actuated();
        let mut v = Self::zeros(a.sizes);
        for i in 0..MOST_JOINTS {
            // Both are 0 beyond their lengths.
            v.values[i] = if i < actuated { a.values[i] } else { u.values[i - actuated] };
        }
        v
    }

    /// The components of the actuated joints.
    #[inline]
    pub fn actuated(&self) -> ActuatedVector {
        part(self, 0)
    }

    /// The components of the unactuated joints.
    #[inline]
    pub fn unactuated(&self) -> UnactuatedVector {
        part(self, self.sizes.actuated())
    }

    /// The components of the actuated joints, to be written.
    #[inline]
    pub fn actuated_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self[..actuated]
    }

    /// The components of the unactuated joints, to be written.
    #[inline]
    pub fn unactuated_mut(&mut self) -> &mut [f64] {
        let actuated = self.sizes.actuated();
        &mut self[actuated..]
    }
}

/// The entries of `vector` from `first` on that make a vector of the space `S`.
#[inline]
fn part<S: Space, const CAPACITY: usize, T: Space, const FROM: usize>(
    vector: &Vector<T, FROM>,
    first: usize,
) -> Vector<S, CAPACITY> {
    let mut out: Vector<S, CAPACITY> = Vector::zeros(vector.sizes);
    let length = out.len();
    // Over the whole memory, with a selection instead of a branch: a copy of a length known at run time would be a call.
    for i in 0..CAPACITY {
        let value = vector.values[(first + i) % FROM];
        out.values[i] = if i < length { value } else { 0.0 };
    }
    out
}

/// A matrix with rows of the space `R` and columns of the space `C`, each of at most [`MOST_JOINTS`] entries. Entries beyond its size
/// are 0.
#[derive(Clone, Copy, PartialEq)]
pub struct Matrix<R, C> {
    rows: [[f64; MOST_JOINTS]; MOST_JOINTS],
    sizes: Sizes,
    spaces: PhantomData<(R, C)>,
}

/// Matrix with one row and one column per joint, as M (1).
pub type JointMatrix = Matrix<Joints, Joints>;
/// Matrix with one row and one column per actuated joint, as M~ (10).
pub type ActuatedMatrix = Matrix<Actuated, Actuated>;
/// Matrix with one row and one column per unactuated joint, as M_UU (2).
pub type UnactuatedMatrix = Matrix<Unactuated, Unactuated>;

impl<R: Space, C: Space> Matrix<R, C> {
    /// The matrix 0.
    pub const fn zeros(sizes: Sizes) -> Self {
        Self { rows: [[0.0; MOST_JOINTS]; MOST_JOINTS], sizes, spaces: PhantomData }
    }

    /// The matrix whose entry in row i and column j is `entry(i, j)`.
    pub fn from_fn(sizes: Sizes, mut entry: impl FnMut(usize, usize) -> f64) -> Self {
        let mut matrix = Self::zeros(sizes);
        for i in 0..R::length(sizes) {
            for j in 0..C::length(sizes) {
                matrix.rows[i][j] = entry(i, j);
            }
        }
        matrix
    }

    /// Numbers of joints of the chain.
    #[inline]
    pub const fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// Number of rows.
    pub fn row_count(&self) -> usize {
        R::length(self.sizes)
    }

    /// Row `i`.
    #[inline]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.rows[i][..C::length(self.sizes).min(MOST_JOINTS)]
    }

    /// Row `i`, to be written.
    #[inline]
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.rows[i][..C::length(self.sizes).min(MOST_JOINTS)]
    }

    /// Column `j`.
    #[inline]
    pub fn column(&self, j: usize) -> Vector<R, MOST_JOINTS> {
        Vector::from_fn(self.sizes, |i| self.rows[i][j])
    }

    /// The rows.
    pub fn iter_rows(&self) -> impl Iterator<Item = &[f64]> {
        (0..self.row_count()).map(|i| self.row(i))
    }

    /// Largest absolute value of an entry; entries that are NaN are ignored.
    pub fn amax(&self) -> f64 {
        self.iter_rows().flatten().fold(0.0, |worst: f64, v| worst.max(v.abs()))
    }

    /// The transposed matrix.
    pub fn transposed(&self) -> Matrix<C, R> {
        Matrix::from_fn(self.sizes, |i, j| self.rows[j][i])
    }
}

impl<R: Space, C: Space> Matrix<R, C> {
    /// A row has four sums, of the columns j with the same j mod 4: they run side by side, on registers of any width.
    #[inline]
    fn times_here(&self, d: impl Dims, v: &Vector<C, MOST_JOINTS>) -> Vector<R, MOST_JOINTS> {
        const SUMS: usize = 4;
        let columns = C::length(d).min(MOST_JOINTS);
        let whole = columns / SUMS * SUMS;
        let mut out = Vector::zeros(self.sizes);
        for (out, row) in out.values.iter_mut().zip(&self.rows).take(R::length(d)) {
            let mut sums = [0.0; SUMS];
            for first in (0..whole).step_by(SUMS) {
                for (l, sum) in sums.iter_mut().enumerate() {
                    *sum += row[first + l] * v.values[first + l];
                }
            }
            for j in whole..columns {
                sums[j - whole] += row[j] * v.values[j];
            }
            *out = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        }
        out
    }
}

impl JointMatrix {
    /// The block of the unactuated joints, as M_UU of M.
    pub fn unactuated(&self) -> UnactuatedMatrix {
        let first = self.sizes.actuated();
        Matrix::from_fn(self.sizes, |i, j| self.rows[first + i][first + j])
    }
}

impl<S: Space> Matrix<S, S> {
    /// The diagonal matrix of `diagonal`.
    pub fn from_diagonal(diagonal: &Vector<S, MOST_JOINTS>) -> Self {
        let mut matrix = Self::zeros(diagonal.sizes());
        for (i, value) in diagonal.iter().enumerate() {
            matrix.rows[i][i] = *value;
        }
        matrix
    }

    /// The identity times `value`.
    pub fn from_diagonal_element(sizes: Sizes, value: f64) -> Self {
        Self::from_diagonal(&Vector::repeat(sizes, value))
    }

    /// x of M x = `b` for this matrix M, symmetric, of which the lower triangle is read, by the Cholesky decomposition; `None` if M is not
    /// positive definite.
    pub fn solve_positive(&self, b: &Vector<S, MOST_JOINTS>) -> Option<Vector<S, MOST_JOINTS>> {
        self.solve_shifted(0.0, b)
    }

    /// x of (M + `shift` I) x = `b`, as [`Self::solve_positive`].
    pub fn solve_shifted(&self, shift: f64, b: &Vector<S, MOST_JOINTS>) -> Option<Vector<S, MOST_JOINTS>> {
        let mut x = *b;
        with_dims!(self.sizes, |d| self.solve_here(d, shift, &mut x)).then_some(x)
    }

    /// Solves in place; returns whether the matrix is positive definite.
    #[inline(never)]
    fn solve_here(&self, d: impl Dims, shift: f64, x: &mut Vector<S, MOST_JOINTS>) -> bool {
        let n = S::length(d).min(MOST_JOINTS);
        let x = &mut x.values;
        // L by rows, without what is above the diagonal.
        let mut l = [0.0; MOST_JOINTS * (MOST_JOINTS + 1) / 2];
        let row = |i: usize| i * (i + 1) / 2;
        for i in 0..n {
            let (above, from_here) = l.split_at_mut(row(i));
            let current = &mut from_here[..=i];
            current.copy_from_slice(&self.rows[i][..=i]);
            current[i] += shift;
            for j in 0..i {
                let other = &above[row(j)..][..=j];
                let mut sum = current[j];
                for k in 0..j {
                    sum -= current[k] * other[k];
                }
                current[j] = sum / other[j];
            }
            let mut sum = current[i];
            for k in 0..i {
                sum -= current[k] * current[k];
            }
            // Written so that NaN is refused.
            if !(sum > 0.0) {
                return false;
            }
            current[i] = sum.sqrt();
            let mut sum = x[i];
            for k in 0..i {
                sum -= current[k] * x[k];
            }
            x[i] = sum / current[i];
        }
        for i in (0..n).rev() {
            x[i] /= l[row(i) + i];
            for k in 0..i {
                x[k] -= l[row(i) + k] * x[i];
            }
        }
        true
    }
}

impl<R: Space, C: Space> Index<(usize, usize)> for Matrix<R, C> {
    type Output = f64;

    #[inline]
    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.rows[i][j]
    }
}

impl<R: Space, C: Space> IndexMut<(usize, usize)> for Matrix<R, C> {
    #[inline]
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.rows[i][j]
    }
}

impl<R: Space, C: Space> Mul<&Vector<C, MOST_JOINTS>> for &Matrix<R, C> {
    type Output = Vector<R, MOST_JOINTS>;

    #[inline]
    fn mul(self, v: &Vector<C, MOST_JOINTS>) -> Vector<R, MOST_JOINTS> {
        with_dims!(self.sizes, |d| self.times_here(d, v))
    }
}

impl<R: Space, C: Space> Add for Matrix<R, C> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::from_fn(self.sizes, |i, j| self.rows[i][j] + other.rows[i][j])
    }
}

impl<R: Space, C: Space> Sub for Matrix<R, C> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::from_fn(self.sizes, |i, j| self.rows[i][j] - other.rows[i][j])
    }
}

impl<R: Space, C: Space> Mul<f64> for Matrix<R, C> {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self::from_fn(self.sizes, |i, j| self.rows[i][j] * factor)
    }
}

impl<R: Space, C: Space> fmt::Debug for Matrix<R, C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter_rows()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Sizes = Sizes::new(5, 3).expect("sizes");

    fn counted() -> State {
        State::from_fn(SIZES, |i| i as f64)
    }

    #[test]
    fn parts_of_a_state_are_sorted() {
        let mut x = counted();
        assert_eq!(x.q().as_slice(), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(x.q_a().as_slice(), [0.0, 1.0, 2.0]);
        assert_eq!(x.q_u().as_slice(), [3.0, 4.0]);
        assert_eq!(x.qd_a().as_slice(), [5.0, 6.0, 7.0]);
        assert_eq!(x.qd_u().as_slice(), [8.0, 9.0]);
        assert_eq!(State::new(&x.q(), &x.qd()), x);
        assert_eq!(JointVector::joined(&x.qd_a(), &x.qd_u()), x.qd());
        x.qd_u_mut()[1] = -1.0;
        assert_eq!(x[9], -1.0);
    }

    #[test]
    fn entries_beyond_the_length_stay_zero() {
        let x = counted();
        for y in [x + x, x - x, -x, x * f64::INFINITY, x / 0.0, x.map(|_| 7.0), State::repeat(SIZES, 3.0)] {
            assert_eq!(y.len(), 10);
            assert!(y.padded()[10..].iter().all(|v| *v == 0.0), "{y:?}");
        }
        assert_eq!(State::from_slice(SIZES, &[0.0; 9]), None);
    }

    #[test]
    fn there_are_no_sizes_without_both_kinds_of_joints() {
        for (joints, actuated) in [(0, 0), (3, 0), (3, 3), (3, 4), (17, 5)] {
            assert_eq!(Sizes::new(joints, actuated), None);
        }
    }

    #[test]
    fn a_positive_definite_system_is_solved_and_no_other() {
        let m =
            JointMatrix::from_fn(SIZES, |i, j| if i == j { 4.0 } else { 1.0 / (1.0 + i.abs_diff(j) as f64) });
        let x = JointVector::from_fn(SIZES, |i| 1.0 - 0.4 * i as f64);
        let got = m.solve_positive(&(&m * &x)).expect("positive definite");
        assert!((got - x).amax() < 1e-14);
        for bad in [-1.0, f64::NAN] {
            let mut m = m;
            m[(3, 3)] = bad;
            assert_eq!(m.solve_positive(&x), None);
        }
    }
}
