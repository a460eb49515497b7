//! Histogram of durations, of fixed size.

use upswing_ipc::Percentiles;

/// Buckets per octave as a power of 2: the upper end of a bucket exceeds any value in it by at most 1/16.
const SUB_BITS: u32 = 4;
const SUB: u64 = 1 << SUB_BITS;
/// Largest duration as a power of 2, ns (69 s); longer durations count in the last bucket.
const LARGEST_BITS: u32 = 36;
const BUCKETS: usize = ((LARGEST_BITS - SUB_BITS + 1) as usize) << SUB_BITS;

/// Histogram of durations with logarithmic buckets.
#[derive(Clone, Debug)]
pub struct Histogram {
    counts: Box<[u64; BUCKETS]>,
    max: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: Box::new([0; BUCKETS]), max: 0 }
    }
}

impl Histogram {
    /// Counts a duration, ns.
    pub fn add(&mut self, ns: u64) {
        self.counts[bucket(ns)] += 1;
        self.max = self.max.max(ns);
    }

    /// Returns the durations that 50, 99, 99.9 and 99.99 % do not exceed, and the longest, ns.
    pub fn percentiles(&self) -> Percentiles {
        let count = self.counts.iter().sum();
        let at = |share: f64| self.percentile(count, share);
        Percentiles {
            count,
            p50: at(0.5),
            p99: at(0.99),
            p99_9: at(0.999),
            p99_99: at(0.9999),
            max: self.max,
        }
    }

    /// Returns the count of each octave [2^k, 2^(k+1)) ns: pairs of its lower end, ns, and the count, from
    /// the first to the last octave with a count. 0 ns counts in the first octave.
    pub fn octaves(&self) -> Vec<(u64, u64)> {
        let mut counts = [0; LARGEST_BITS as usize];
        for (bucket, n) in self.counts.iter().enumerate() {
            counts[upper_end(bucket).max(1).ilog2() as usize] += n;
        }
        let pairs = counts.into_iter().enumerate().map(|(k, n)| (1 << k, n));
        let mut used: Vec<_> = pairs.skip_while(|(_, n)| *n == 0).collect();
        used.truncate(used.iter().rposition(|(_, n)| *n > 0).map_or(0, |last| last + 1));
        used
    }

    fn percentile(&self, count: u64, share: f64) -> u64 {
        if count == 0 {
            return 0;
        }
        let rank = (share * count as f64).ceil() as u64;
        let mut seen = 0;
        let index = self.counts.iter().position(|n| {
            seen += n;
            seen >= rank
        });
        index.map_or(self.max, upper_end).min(self.max)
    }
}

fn bucket(ns: u64) -> usize {
    let ns = ns.min((1 << LARGEST_BITS) - 1);
    // Values below 2^(SUB_BITS + 1) have a bucket each.
    let octave = (64 - ns.leading_zeros()).saturating_sub(SUB_BITS + 1);
    (u64::from(octave) * SUB + (ns >> octave)) as usize
}

/// The largest value of a bucket, ns.
fn upper_end(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < 2 * SUB {
        return bucket;
    }
    let octave = bucket / SUB - 1;
    ((bucket - octave * SUB + 1) << octave) - 1
}
