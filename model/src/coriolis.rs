//! The bound c of (11): the range of the Coriolis torques C~ qd (10) over random admissible states, Section III-A.

use crate::{ActuatedVector, JointVector, Limits, Model, Sizes, Workspace};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// States between two looks at the stop flag, some 0.1 s: short enough for Ctrl-C, long enough that threads do not
/// wait for each other.
const CHUNK: u64 = 1 << 16;

/// Range of C~ qd (10) over random states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoriolisRange {
    /// How many states were evaluated: all that were asked for, unless stopped.
    pub samples: u64,
    /// Lowest torque of each motor, N m; +infinity without a sample.
    pub lower: ActuatedVector,
    /// Highest torque of each motor, N m; -infinity without a sample.
    pub upper: ActuatedVector,
}

impl CoriolisRange {
    /// Over no state at all.
    fn empty(sizes: Sizes) -> Self {
        let [lower, upper] = [f64::INFINITY, f64::NEG_INFINITY].map(|v| ActuatedVector::repeat(sizes, v));
        Self { samples: 0, lower, upper }
    }

    fn include(&mut self, torque: &ActuatedVector) {
        self.samples += 1;
        self.lower = self.lower.inf(torque);
        self.upper = self.upper.sup(torque);
    }

    fn union(self, other: Self) -> Self {
        Self {
            samples: self.samples + other.samples,
            lower: self.lower.inf(&other.lower),
            upper: self.upper.sup(&other.upper),
        }
    }
}

/// The states number `first`, `first` + 1, ... of the sequence of a seed, uniformly distributed within the
/// positions and velocities of `limits`: q in rad or m, qd in rad/s or m/s.
pub fn random_states(
    limits: &Limits,
    seed: u64,
    first: u64,
) -> impl Iterator<Item = (JointVector, JointVector)> {
    let limits = *limits;
    let sizes = limits.q_min.sizes();
    let mut rng = Pcg64::seed_from_u64(seed);
    rng.advance(u128::from(first) * sizes.state() as u128);
    let mut uniform = move |from: f64, to: f64| {
        // The upper 53 bits, as many as a number in [0, 1) holds.
        let unit = (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        from + (to - from) * unit
    };
    std::iter::repeat_with(move || {
        let q = JointVector::from_fn(sizes, |i| uniform(limits.q_min[i], limits.q_max[i]));
        let qd = JointVector::from_fn(sizes, |i| uniform(-limits.qd_max[i], limits.qd_max[i]));
        (q, qd)
    })
}

/// Range of C~ qd over the first `samples` [`random_states`] of the seed, on all threads of rayon's current pool;
/// the number of threads does not change it. `progress` is called with the number of states that were added;
/// raising `stop` ends the search after the chunks under way, and the range tells how many states it covers.
pub fn bound(
    model: &Model,
    limits: &Limits,
    samples: u64,
    seed: u64,
    stop: &AtomicBool,
    progress: impl Fn(u64) + Sync,
) -> CoriolisRange {
    (0..samples.div_ceil(CHUNK))
        .into_par_iter()
        .take_any_while(|_| !stop.load(Ordering::Acquire))
        .map_init(Workspace::default, |work, chunk| {
            let mut range = CoriolisRange::empty(model.sizes());
            let first = chunk * CHUNK;
            let count = CHUNK.min(samples - first);
            for (q, qd) in random_states(limits, seed, first).take(count as usize) {
                range.include(&model.coriolis_torque(&q, &qd, work));
            }
            progress(count);
            range
        })
        .reduce(|| CoriolisRange::empty(model.sizes()), CoriolisRange::union)
}
