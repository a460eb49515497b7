//! Feedback gains of a trajectory, in one slab of memory.

use upswing_model::{ActuatedVector, Dims, Sizes, State, with_dims};

/// Feedback gains K (22) of a trajectory: K_0..K_N at its knots, and the gain that holds x_N.
///
/// A gain has n_A rows of 2n entries, 1/s^2 for positions and 1/s for velocities.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    sizes: Sizes,
    /// N
    intervals: usize,
    /// The gains by rows, one after the other, the gain that holds x_N last.
    slab: Vec<f64>,
}

impl Gains {
    /// Number of entries of all gains of a trajectory with N = `intervals`.
    pub const fn entries(sizes: Sizes, intervals: usize) -> usize {
        (intervals + 2) * block(sizes)
    }

    /// Gains 0 for a trajectory with N = `intervals`.
    pub fn zeros(sizes: Sizes, intervals: usize) -> Self {
        Self { sizes, intervals, slab: vec![0.0; Self::entries(sizes, intervals)] }
    }

    /// The gains in `slab`: by rows, one after the other, K_0..K_N and then the gain that holds x_N. `None` unless it has the
    /// length [`Self::entries`] of a trajectory with N = `intervals`.
    pub fn from_slab(sizes: Sizes, intervals: usize, slab: Vec<f64>) -> Option<Self> {
        (slab.len() == Self::entries(sizes, intervals)).then_some(Self { sizes, intervals, slab })
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// N, the number of intervals of the trajectory.
    pub fn intervals(&self) -> usize {
        self.intervals
    }

    /// All entries, as in [`Self::from_slab`].
    pub fn as_slice(&self) -> &[f64] {
        &self.slab
    }

    /// All entries, to be written.
    pub fn as_mut_slice(&mut self) -> &mut [f64] {
        &mut self.slab
    }

    /// K_k (23).
    ///
    /// # Panics
    /// If `k` is above N.
    #[inline]
    pub fn knot(&self, k: usize) -> Gain<'_> {
        // N + 1 would be the gain that holds x_N.
        assert!(k <= self.intervals, "knot {k} of {} intervals", self.intervals);
        self.block(k)
    }

    /// Entries of K_k by rows, to be written.
    ///
    /// # Panics
    /// If `k` is above N.
    pub fn knot_mut(&mut self, k: usize) -> &mut [f64] {
        assert!(k <= self.intervals, "knot {k} of {} intervals", self.intervals);
        let block = block(self.sizes);
        &mut self.slab[k * block..][..block]
    }

    /// K_0..K_N.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = Gain<'_>> {
        (0..self.intervals + 1).map(|k| self.block(k))
    }

    /// The gain that holds x_N after t_F, from the algebraic Riccati equation (21).
    #[inline]
    pub fn end(&self) -> Gain<'_> {
        self.block(self.intervals + 1)
    }

    /// Entries of the gain that holds x_N by rows, to be written.
    pub fn end_mut(&mut self) -> &mut [f64] {
        let first = self.slab.len() - block(self.sizes);
        &mut self.slab[first..]
    }

    /// The gain between the knots k and k + 1, k < N, after `share` of the interval (0 to 1).
    ///
    /// # Panics
    /// If `k` is N or above.
    #[inline]
    pub fn between(&self, k: usize, share: f64) -> InterpolatedGain<'_> {
        assert!(k < self.intervals, "interval {k} of {}", self.intervals);
        InterpolatedGain { from: self.block(k), to: self.block(k + 1), share }
    }

    #[inline]
    fn block(&self, k: usize) -> Gain<'_> {
        let block = block(self.sizes);
        Gain { sizes: self.sizes, entries: &self.slab[k * block..][..block] }
    }
}

/// Number of entries of one gain.
#[inline]
const fn block(sizes: Sizes) -> usize {
    sizes.actuated() * sizes.state()
}

/// A feedback gain K (22), n_A x 2n: du = K dx, 1/s^2 for positions and 1/s for velocities. Its entries are in [`Gains`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain<'a> {
    sizes: Sizes,
    /// n_A rows of 2n entries.
    entries: &'a [f64],
}

impl<'a> Gain<'a> {
    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// The entries by rows.
    pub fn as_slice(&self) -> &'a [f64] {
        self.entries
    }

    /// The rows, one per actuated joint.
    #[inline]
    pub fn rows(&self) -> std::slice::ChunksExact<'a, f64> {
        self.entries.chunks_exact(self.sizes.state())
    }

    /// Column `j`: du for a deviation of row `j` of the state by 1.
    ///
    /// # Panics
    /// If `j` is 2n or above.
    pub fn column(&self, j: usize) -> ActuatedVector {
        assert!(j < self.sizes.state(), "column {j} of {}", self.sizes.state());
        ActuatedVector::from_fn(self.sizes, |i| self.entries[i * self.sizes.state() + j])
    }
}

impl<'a> From<Gain<'a>> for InterpolatedGain<'a> {
    fn from(gain: Gain<'a>) -> Self {
        Self { from: gain, to: gain, share: 0.0 }
    }
}

/// The feedback gain K(t), interpolated linearly between two knots entry by entry, where it is used.
#[derive(Clone, Copy, Debug)]
pub struct InterpolatedGain<'a> {
    from: Gain<'a>,
    to: Gain<'a>,
    share: f64,
}

impl InterpolatedGain<'_> {
    /// du = K `dx`. Does not allocate.
    #[inline]
    pub fn times(&self, dx: &State) -> ActuatedVector {
        with_dims!(self.from.sizes, |d| self.times_here(d, dx))
    }

    /// A row has four sums, of the columns j with the same j mod 4: they run side by side, on registers of any width.
    #[inline]
    fn times_here(&self, d: impl Dims, dx: &State) -> ActuatedVector {
        const SUMS: usize = 4;
        let columns = d.state();
        let whole = columns / SUMS * SUMS;
        let dx = &dx[..columns];
        let (from, to) =
            (&self.from.entries[..d.actuated() * columns], &self.to.entries[..d.actuated() * columns]);
        let mut du = ActuatedVector::zeros(self.from.sizes);
        let rows = from.chunks_exact(columns).zip(to.chunks_exact(columns));
        for (du, (from, to)) in du.iter_mut().zip(rows) {
            let product = |j: usize| (from[j] + (to[j] - from[j]) * self.share) * dx[j];
            let mut sums = [0.0; SUMS];
            for first in (0..whole).step_by(SUMS) {
                for (l, sum) in sums.iter_mut().enumerate() {
                    *sum += product(first + l);
                }
            }
            for j in whole..columns {
                sums[j - whole] += product(j);
            }
            *du = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        }
        du
    }
}
