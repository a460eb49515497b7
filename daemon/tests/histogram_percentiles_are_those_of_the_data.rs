//! The percentiles of a histogram are those of the data, rounded up by at most one bucket.

use proptest::prelude::*;
use upswing_ipc::Percentiles;
use upswingd::histogram::Histogram;

#[test]
fn an_empty_histogram_has_none() {
    assert_eq!(Histogram::default().percentiles(), Percentiles::default());
}

proptest! {
    #[test]
    fn within_a_bucket(mut data in prop::collection::vec(prop_oneof![0_u64..100, 0_u64..100_000, 0_u64..60_000_000_000], 1..3000)) {
        let mut histogram = Histogram::default();
        data.iter().for_each(|ns| histogram.add(*ns));
        data.sort_unstable();
        let p = histogram.percentiles();
        prop_assert_eq!((p.count, Some(&p.max)), (data.len() as u64, data.last()));
        for (share, got) in [(0.5, p.p50), (0.99, p.p99), (0.999, p.p99_9), (0.9999, p.p99_99)] {
            let exact = data[(share * data.len() as f64).ceil() as usize - 1];
            prop_assert!(got >= exact && got as f64 <= exact as f64 * (1.0 + 1.0 / 16.0), "{share}: {got} for {exact}");
        }
    }
}

proptest! {
    #[test]
    fn octaves_hold_all_data(data in prop::collection::vec(0_u64..60_000_000_000, 0..1000)) {
        let mut histogram = Histogram::default();
        data.iter().for_each(|ns| histogram.add(*ns));
        let octaves = histogram.octaves();
        for (begin, count) in &octaves {
            let first = if *begin == octaves[0].0 { 0 } else { *begin };
            prop_assert_eq!(data.iter().filter(|ns| (first..2 * begin).contains(*ns)).count() as u64, *count);
        }
        prop_assert_eq!(octaves.iter().map(|(_, n)| n).sum::<u64>(), data.len() as u64);
        prop_assert!(octaves.windows(2).all(|w| w[1].0 == 2 * w[0].0));
    }
}

#[test]
fn what_is_too_long_counts_as_long() {
    let mut histogram = Histogram::default();
    [u64::MAX, 5, 7].into_iter().for_each(|ns| histogram.add(ns));
    let p = histogram.percentiles();
    assert_eq!((p.p50, p.max), (7, u64::MAX));
    assert!(p.p99 > 60_000_000_000);
}
