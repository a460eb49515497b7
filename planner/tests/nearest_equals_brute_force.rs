//! The K-D tree finds the same poses as a linear search, also on regular grids with ties.

use proptest::prelude::*;
use upswing_model::NU;
use upswing_planner::database::NearestPose;

fn brute_force(poses: &[[f64; NU]], metric: &[f64; NU], q: &[f64; NU], count: usize) -> Vec<usize> {
    let scale = metric.map(f64::sqrt);
    let distance = |p: &[f64; NU]| (0..NU).map(|j| (q[j] * scale[j] - p[j] * scale[j]).powi(2)).sum::<f64>();
    let mut order: Vec<usize> = (0..poses.len()).collect();
    order.sort_by(|a, b| distance(&poses[*a]).total_cmp(&distance(&poses[*b])).then(a.cmp(b)));
    order.truncate(count);
    order
}

fn grid(points: usize) -> Vec<[f64; NU]> {
    let mut poses = vec![[0.0; NU]];
    for joint in [0, 1, 3, 5] {
        poses = poses
            .iter()
            .flat_map(|p| {
                (0..points).map(move |i| {
                    let mut p = *p;
                    p[joint] = i as f64 - 1.5;
                    p
                })
            })
            .collect();
    }
    poses
}

fn indices(tree: &NearestPose, q: &[f64; NU], count: usize) -> Vec<usize> {
    tree.nearest(q, count).iter().map(|n| n.index).collect()
}

proptest! {
    // Each case has two queries.
    #![proptest_config(ProptestConfig::with_cases(50_000))]

    #[test]
    fn on_a_regular_grid(
        q in prop::array::uniform7(-3.0..3.0),
        // Half steps lie exactly between grid points: ties.
        halves in prop::array::uniform7(-6i32..6),
        metric in prop::array::uniform7(0.1..3.0),
        points in 1usize..5,
        count in 1usize..6,
    ) {
        let poses = grid(points);
        let tree = NearestPose::new(poses.iter().copied(), &metric);
        prop_assert_eq!(indices(&tree, &q, count), brute_force(&poses, &metric, &q, count));
        let tie = halves.map(|h| 0.5 * f64::from(h));
        prop_assert_eq!(indices(&tree, &tie, count), brute_force(&poses, &metric, &tie, count));
    }
}

#[test]
fn of_no_poses_none_is_nearest() {
    assert!(NearestPose::new([], &[1.0; NU]).nearest(&[0.0; NU], 3).is_empty());
}
