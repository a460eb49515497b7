//! Statistics of many runs: order statistics of a quantity, confidence interval of a probability.

use serde::Serialize;

/// 95 % confidence interval (lower, upper) of the probability of success, from `succeeded` of `samples` trials (E. B. Wilson, J. Am.
/// Stat. Assoc. 22, 1927).
pub fn wilson(succeeded: usize, samples: usize) -> (f64, f64) {
    /// 97.5 % quantile of the standard normal distribution.
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

/// Order statistics of a quantity over the samples, in its unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Smallest value.
    pub min: f64,
    /// 1 % quantile.
    pub p01: f64,
    /// 50 % quantile.
    pub median: f64,
    /// 99 % quantile.
    pub p99: f64,
    /// Largest value.
    pub max: f64,
}

impl Spread {
    /// The order statistics of `values`; `None` without values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        // Quantile by the nearest rank.
        let at = |share: f64| sorted[((share * sorted.len() as f64).ceil() as usize).clamp(1, last + 1) - 1];
        Some(Self { min: sorted[0], p01: at(0.01), median: at(0.5), p99: at(0.99), max: sorted[last] })
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
