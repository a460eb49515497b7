//! Vectors and matrices of all knots or intervals in one piece of memory.

use crate::kernels::{dot, shift_add};
use std::marker::PhantomData;
use std::ops::Range;
use upswing_model::{ActuatedVector, Dims, LARGEST_STATE, MOST_JOINTS, Sizes, Space, State, States, Vector};

/// Largest dimension of z = (x, u), rounded up to full vector registers.
pub const LARGEST_KNOT: usize = LARGEST_STATE + MOST_JOINTS;

/// The space of z = (x, u), the variables of a collocation knot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Knots;

impl Space for Knots {
    #[inline(always)]
    fn length(sizes: impl Dims) -> usize {
        sizes.knot()
    }
}

/// z_k = (x_k, u_k) or a derivative with respect to it.
pub type KnotVector = Vector<Knots, LARGEST_KNOT>;

/// The parts of z_k = (x_k, u_k), or of a derivative with respect to it.
pub trait KnotParts {
    /// The part of x_k.
    fn x(&self) -> State;
    /// The part of u_k.
    fn u(&self) -> ActuatedVector;
    /// The part of x_k, to be written.
    fn x_mut(&mut self) -> &mut [f64];
    /// The part of u_k, to be written.
    fn u_mut(&mut self) -> &mut [f64];
}

impl KnotParts for KnotVector {
    fn x(&self) -> State {
        entries(self.sizes(), &self[..self.sizes().state()])
    }

    fn u(&self) -> ActuatedVector {
        entries(self.sizes(), &self[self.sizes().state()..])
    }

    fn x_mut(&mut self) -> &mut [f64] {
        let x = self.sizes().state();
        &mut self[..x]
    }

    fn u_mut(&mut self) -> &mut [f64] {
        let x = self.sizes().state();
        &mut self[x..]
    }
}

/// The vector of `values`, of which there are as many as the space has.
pub(crate) fn entries<S: Space, const CAPACITY: usize>(sizes: Sizes, values: &[f64]) -> Vector<S, CAPACITY> {
    let mut vector = Vector::zeros(sizes);
    vector.copy_from_slice(values);
    vector
}

/// Matrices of the same shape, one after the other: panel k belongs to knot or interval k.
///
/// A row is over the space `S` and padded with zeros to full vector registers ([`Slab::stride`]). Vectors are panels of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct Slab<S> {
    values: Vec<f64>,
    sizes: Sizes,
    rows: usize,
    space: PhantomData<S>,
}

impl<S: Space> Slab<S> {
    /// `panels` matrices 0 of `rows` rows each.
    pub fn zeros(sizes: Sizes, panels: usize, rows: usize) -> Self {
        let stride = S::length(sizes).next_multiple_of(4);
        Self { values: vec![0.0; panels * rows * stride], sizes, rows, space: PhantomData }
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// Length in memory of a row.
    #[inline]
    pub fn stride(&self) -> usize {
        S::length(self.sizes).next_multiple_of(4)
    }

    /// Length in memory of a panel.
    #[inline]
    fn panel_length(&self) -> usize {
        self.rows * self.stride()
    }

    /// Number of panels.
    pub fn panels(&self) -> usize {
        self.values.len() / self.panel_length()
    }

    /// The rows of panel `k`, with their padding.
    #[inline]
    pub fn panel(&self, k: usize) -> &[f64] {
        let length = self.panel_length();
        &self.values[k * length..][..length]
    }

    /// The rows of panel `k`, to be written; their padding remains 0.
    #[inline]
    pub fn panel_mut(&mut self, k: usize) -> &mut [f64] {
        let length = self.panel_length();
        &mut self.values[k * length..][..length]
    }

    /// Row `i` of panel `k`, without padding.
    #[inline]
    pub fn row(&self, k: usize, i: usize) -> &[f64] {
        &self.panel(k)[i * self.stride()..][..S::length(self.sizes)]
    }

    /// Row `i` of panel `k`, without padding, to be written.
    #[inline]
    pub fn row_mut(&mut self, k: usize, i: usize) -> &mut [f64] {
        let (stride, length) = (self.stride(), S::length(self.sizes));
        &mut self.panel_mut(k)[i * stride..][..length]
    }

    /// The vector of panel `k`, its first row, without padding.
    #[inline]
    pub fn vector(&self, k: usize) -> &[f64] {
        self.row(k, 0)
    }

    /// The vector of panel `k`, without padding, to be written.
    #[inline]
    pub fn vector_mut(&mut self, k: usize) -> &mut [f64] {
        self.row_mut(k, 0)
    }

    /// The vectors of all panels, without padding.
    pub fn vectors(&self) -> impl Iterator<Item = &[f64]> {
        (0..self.panels()).map(|k| self.vector(k))
    }

    /// All panels, with padding.
    #[inline]
    pub fn as_slice(&self) -> &[f64] {
        &self.values
    }

    /// All panels, with padding, to be written; the padding remains 0.
    #[inline]
    pub fn as_mut_slice(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The panels `range` alone.
    pub fn part(&self, range: Range<usize>) -> Self {
        let length = self.panel_length();
        Self {
            values: self.values[range.start * length..range.end * length].to_vec(),
            sizes: self.sizes,
            rows: self.rows,
            space: PhantomData,
        }
    }

    /// Overwrites this with `other`, which has the same shape.
    pub fn copy_from(&mut self, other: &Self) {
        self.values.copy_from_slice(&other.values);
    }

    /// Sets all to 0.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }
}

impl Slab<States> {
    /// The vector of panel `k`.
    pub fn state(&self, k: usize) -> State {
        entries(self.sizes, self.vector(k))
    }

    /// Overwrites the vector of panel `k`.
    pub fn set(&mut self, k: usize, x: &State) {
        self.vector_mut(k).copy_from_slice(x);
    }
}

impl Slab<Knots> {
    /// The vector of panel `k`.
    pub fn knot(&self, k: usize) -> KnotVector {
        entries(self.sizes, self.vector(k))
    }

    /// Overwrites the vector of panel `k`.
    pub fn set(&mut self, k: usize, z: &KnotVector) {
        self.vector_mut(k).copy_from_slice(z);
    }

    /// The part of x_k of the vector of panel `k`.
    pub fn x(&self, k: usize) -> State {
        entries(self.sizes, &self.vector(k)[..self.sizes.state()])
    }

    /// The part of u_k of the vector of panel `k`.
    pub fn u(&self, k: usize) -> ActuatedVector {
        entries(self.sizes, &self.vector(k)[self.sizes.state()..])
    }

    /// Adds to `out` the product of panel `k` and the vector `z`.
    pub(crate) fn add_times(&self, k: usize, z: &[f64], out: &mut [f64]) {
        for (out, row) in out.iter_mut().zip(self.panel(k).chunks_exact(self.stride())) {
            *out += dot(z, row);
        }
    }

    /// Adds to `out` the product of the transposed panel `k` and the vector `p`.
    pub(crate) fn add_transposed_times(&self, k: usize, p: &[f64], out: &mut [f64]) {
        for (p, row) in p.iter().zip(self.panel(k).chunks_exact(self.stride())) {
            shift_add(out, *p, row);
        }
    }

    /// The part of x_k of the vector of panel `k`, to be written.
    pub fn x_mut(&mut self, k: usize) -> &mut [f64] {
        let x = self.sizes.state();
        &mut self.vector_mut(k)[..x]
    }

    /// The part of u_k of the vector of panel `k`, to be written.
    pub fn u_mut(&mut self, k: usize) -> &mut [f64] {
        let x = self.sizes.state();
        &mut self.vector_mut(k)[x..]
    }
}
