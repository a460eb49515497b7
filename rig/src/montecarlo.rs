//! Random starts at rest, and the same work for each of them on many threads.

pub mod condition;
pub mod variation;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, PendulumStart};
use upswing_model::{N_ACTUATED, N_UNACTUATED, NU, State};

/// Largest angle at which the pendulum hangs in a start, rad: 5 deg within the limit of joint 9, Table II.
const LARGEST_REST_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;
/// Poses that are drawn for one start. Of the paper's ranges about half of all poses will do.
const DRAWS: u32 = 1000;
/// Numbers of the generator's sequence that belong to one start: more than its draws use, and odd, because jumps by a
/// power of two repeat the low bits of a linear congruential generator.
const BLOCK: u128 = 1_000_003;

/// No pose within the ranges lets the pendulum rest within its limits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the ranges of the grid hold no start: in none of {DRAWS} random poses the pendulum hangs within {:.0} deg; \
     choose ranges in which q2 - q4 + q6 comes near 90 deg", LARGEST_REST_ANGLE.to_degrees()
)]
pub struct NoStart;

/// Starts at rest, uniform in the ranges of the grid's axes, Section VI of the paper; the pendulum hangs at rest
/// within 40 deg.
#[derive(Clone, Copy, Debug)]
pub struct Starts<'a> {
    /// Ranges, limits and model.
    pub config: &'a Config,
    /// Starts of different seeds have nothing in common.
    pub seed: u64,
}

impl Starts<'_> {
    /// Start number `index`: depends on this number, the seed and the settings alone.
    ///
    /// # Errors
    /// [`NoStart`].
    pub fn start(&self, index: u64) -> Result<State, NoStart> {
        let mut rng = self.generator(index);
        for _ in 0..DRAWS {
            let mut q_a = [0.0; NU];
            for axis in &self.config.grid.axes {
                q_a[axis.joint] = axis.from + (axis.to - axis.from) * unit(&mut rng);
            }
            if let Ok(x) = self.config.start_state(&q_a, PendulumStart::Rest)
                && x.fixed_rows::<N_UNACTUATED>(N_ACTUATED).amax() <= LARGEST_REST_ANGLE
            {
                return Ok(x);
            }
        }
        Err(NoStart)
    }

    /// A number in [0, 1) that belongs to start number `index` and tells nothing about it.
    pub fn share(&self, index: u64) -> f64 {
        self.shares(index).next().unwrap_or_default()
    }

    /// Numbers as [`Self::share`], up to half a million of them.
    pub fn shares(&self, index: u64) -> impl Iterator<Item = f64> + use<> {
        let mut rng = self.generator(index);
        rng.advance(BLOCK / 2);
        std::iter::repeat_with(move || unit(&mut rng))
    }

    fn generator(&self, index: u64) -> Pcg64 {
        let mut rng = Pcg64::seed_from_u64(self.seed);
        rng.advance(u128::from(index) * BLOCK);
        rng
    }
}

/// Uniform in [0, 1): the upper 53 bits, as many as a number there holds.
fn unit(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Angles of joints 1-7 of a state, deg.
pub fn arm_degrees(x: &State) -> [f64; NU] {
    std::array::from_fn(|i| x[i].to_degrees())
}

/// `work` for each of `indices` on `threads` threads, each with its own `scratch`; results in the order
/// of the indices. Raising `stop` ends it after what is under way; what is missing then is left out. `progress` is
/// called after each.
///
/// # Errors
/// Why the threads could not be started.
pub fn for_each<S, T: Send>(
    indices: &[u64],
    threads: usize,
    stop: &AtomicBool,
    progress: impl Fn() + Sync,
    scratch: impl Fn() -> S + Sync + Send,
    work: impl Fn(&mut S, u64) -> T + Sync + Send,
) -> Result<Vec<T>, rayon::ThreadPoolBuildError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let results: Vec<Option<T>> = pool.install(|| {
        indices
            .par_iter()
            .map_init(&scratch, |scratch, index| {
                let result = (!stop.load(Ordering::Acquire)).then(|| work(scratch, *index));
                progress();
                result
            })
            .collect()
    });
    Ok(results.into_iter().flatten().collect())
}

/// 95 % interval of a probability of which `succeeded` of `samples` trials are known (E. B. Wilson, J. Am. Stat. Assoc. 22,
/// 1927).
pub fn wilson(succeeded: usize, samples: usize) -> (f64, f64) {
    /// 97.5 % of a normal distribution are below this, in standard deviations.
    const Z: f64 = 1.959_963_984_540_054;
    if samples == 0 {
        return (0.0, 1.0);
    }
    let n = samples as f64;
    let share = succeeded as f64 / n;
    let middle = share + Z * Z / (2.0 * n);
    let half = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    let at = |v: f64| (v / (1.0 + Z * Z / n)).clamp(0.0, 1.0);
    (at(middle - half), at(middle + half))
}

/// How a figure is distributed over the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Smallest.
    pub min: f64,
    /// 1 % are not above it.
    pub p01: f64,
    /// Half are not above it.
    pub median: f64,
    /// 99 % are not above it.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// Of `values`; `None` if there are none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        // Nearest rank.
        let at = |share: f64| sorted[((share * sorted.len() as f64).ceil() as usize).clamp(1, last + 1) - 1];
        Some(Self { min: sorted[0], p01: at(0.01), median: at(0.5), p99: at(0.99), max: sorted[last] })
    }

    /// The line above those of [`Self::write_row`].
    pub fn write_heading(f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [min, p01, median, p99, max] = ["min", "1 %", "median", "99 %", "max"];
        writeln!(f, "  {:<22} {min:>11} {p01:>11} {median:>11} {p99:>11} {max:>11}", "")
    }

    /// One line of a table, with all values times `unit`; nothing if there is no spread.
    pub fn write_row(
        f: &mut std::fmt::Formatter<'_>,
        name: &str,
        spread: Option<Self>,
        unit: f64,
    ) -> std::fmt::Result {
        let Some(s) = spread else { return Ok(()) };
        write!(f, "  {name:<22}")?;
        for v in [s.min, s.p01, s.median, s.p99, s.max].map(|v| v * unit) {
            if v != 0.0 && v.abs() < 1e-3 { write!(f, " {v:>11.1e}")? } else { write!(f, " {v:>11.4}")? }
        }
        writeln!(f)
    }
}

#[cfg(test)]
mod tests {
    use super::wilson;

    #[test]
    fn intervals_are_those_of_the_literature() {
        // R. G. Newcombe, Statistics in Medicine 17, 1998, table I, method 3.
        for ((r, n), (low, high)) in [
            ((81, 263), (0.2553, 0.3662)),
            ((15, 148), (0.0624, 0.1605)),
            ((0, 20), (0.0, 0.1611)),
            ((1, 29), (0.0061, 0.1718)),
        ] {
            let (l, h) = wilson(r, n);
            assert!((l - low).abs() < 5.1e-5 && (h - high).abs() < 5.1e-5, "{r} of {n}: {l} to {h}");
            let (l, h) = wilson(n - r, n);
            assert!((l - 1.0 + high).abs() < 5.1e-5 && (h - 1.0 + low).abs() < 5.1e-5);
        }
    }
}
