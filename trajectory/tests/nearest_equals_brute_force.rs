//! The tree of keys finds the same keys as a linear search, for keys of any length, also on regular grids with ties.

use proptest::prelude::*;
use upswing_trajectory::KeyTree;

fn brute_force(keys: &[Vec<f64>], metric: &[f64], q: &[f64], count: usize) -> Vec<usize> {
    let scale: Vec<f64> = metric.iter().map(|w| w.sqrt()).collect();
    let distance = |key: &[f64]| {
        let offsets = q.iter().zip(key).zip(&scale).map(|((q, p), s)| q * s - p * s);
        offsets.map(|d| d * d).sum::<f64>()
    };
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by(|a, b| distance(&keys[*a]).total_cmp(&distance(&keys[*b])).then(a.cmp(b)));
    order.truncate(count);
    order
}

/// A regular grid over the coordinates `varied` of keys with `length` coordinates.
fn grid(length: usize, varied: &[usize], points: usize) -> Vec<Vec<f64>> {
    let mut keys = vec![vec![0.0; length]];
    for coordinate in varied.iter().filter(|coordinate| **coordinate < length) {
        keys = keys
            .iter()
            .flat_map(|key| {
                (0..points).map(|i| {
                    let mut key = key.clone();
                    key[*coordinate] = i as f64 - 1.5;
                    key
                })
            })
            .collect();
    }
    keys
}

fn indices(tree: &KeyTree, q: &[f64], metric: &[f64], count: usize) -> Vec<usize> {
    tree.nearest(q, metric, count).iter().map(|n| n.index).collect()
}

proptest! {
    // Each case has two queries.
    #![proptest_config(ProptestConfig::with_cases(50_000))]

    #[test]
    fn on_a_regular_grid(
        q in prop::array::uniform16(-3.0..3.0),
        // Half steps lie exactly between grid points: ties.
        halves in prop::array::uniform16(-6i32..6),
        metric in prop::array::uniform16(0.1..3.0),
        length in 1usize..=16,
        points in 1usize..5,
        count in 1usize..6,
    ) {
        let (q, metric) = (&q[..length], &metric[..length]);
        let keys = grid(length, &[0, 1, 3, 5], points);
        let tree = KeyTree::new(length, &keys.concat());
        prop_assert_eq!(indices(&tree, q, metric, count), brute_force(&keys, metric, q, count));
        let tie: Vec<f64> = halves[..length].iter().map(|h| 0.5 * f64::from(*h)).collect();
        prop_assert_eq!(indices(&tree, &tie, metric, count), brute_force(&keys, metric, &tie, count));
    }
}

#[test]
fn of_no_keys_none_is_nearest() {
    assert!(KeyTree::new(7, &[]).nearest(&[0.0; 7], &[1.0; 7], 3).is_empty());
}

#[test]
fn coordinates_without_a_weight_do_not_count() {
    let tree = KeyTree::new(2, &[2.0, 0.0, 1.0, 9.0]);
    assert_eq!(indices(&tree, &[0.0, 0.0], &[1.0], 2), [1, 0]);
    let tree = KeyTree::new(1, &[2.0, 1.0, 3.0]);
    assert_eq!(indices(&tree, &[0.0], &[], 2), [0, 1]);
}
