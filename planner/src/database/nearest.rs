//! K-D tree over the start poses of a database (Bentley, *Multidimensional binary search trees used for
//! associative searching*, CACM 18, 1975).
//!
//! Nodes are split by rank, not by value, so that the tree of a regular grid with its repeated coordinates is balanced; of
//! equally near poses the pose with the lower index wins, as in a linear search.

use upswing_model::NU;

/// A pose in coordinates scaled by the square root of the metric, in which the distance is Euclidean.
type MetricPoint = [f64; NU];

/// K-D tree of poses, stored with their indices in the order of an in-order traversal of a balanced tree.
#[derive(Clone, Debug)]
pub struct NearestPose {
    /// Square roots of the weights of the metric.
    scale: MetricPoint,
    nodes: Vec<(MetricPoint, usize)>,
}

/// A pose found by [`NearestPose::nearest`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Index of the pose in the list that the tree was built from.
    pub index: usize,
    /// Weighted distance sqrt(sum_i w_i (q_i - p_i)^2), rad.
    pub distance: f64,
}

impl NearestPose {
    /// Builds the tree of `poses` (rad) for the squared distance weighted by `metric`.
    pub fn new(poses: impl IntoIterator<Item = [f64; NU]>, metric: &[f64; NU]) -> Self {
        let scale = metric.map(f64::sqrt);
        let mut nodes: Vec<_> = poses
            .into_iter()
            .enumerate()
            .map(|(i, p)| (std::array::from_fn(|j| p[j] * scale[j]), i))
            .collect();
        arrange(&mut nodes, 0);
        Self { scale, nodes }
    }

    /// The `count` nearest poses to `q` (rad), nearest first; fewer if the tree has fewer poses.
    pub fn nearest(&self, q: &[f64; NU], count: usize) -> Vec<Neighbour> {
        let point = std::array::from_fn(|j| q[j] * self.scale[j]);
        let mut found = Vec::with_capacity(count + 1);
        if count > 0 {
            search(&self.nodes, 0, &point, count, &mut found);
        }
        found.into_iter().map(|(d, index)| Neighbour { index, distance: d.sqrt() }).collect()
    }
}

/// Arranges `nodes` as a tree: the median of coordinate `depth` modulo NU in the middle, the halves recursively.
fn arrange(nodes: &mut [(MetricPoint, usize)], depth: usize) {
    if nodes.len() < 2 {
        return;
    }
    let axis = depth % NU;
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (before, rest) = nodes.split_at_mut(middle);
    arrange(before, depth + 1);
    arrange(&mut rest[1..], depth + 1);
}

/// Collects the nearest nodes below a subtree as (squared distance, index), sorted, at most `count`.
fn search(
    nodes: &[(MetricPoint, usize)],
    depth: usize,
    point: &MetricPoint,
    count: usize,
    found: &mut Vec<(f64, usize)>,
) {
    if nodes.is_empty() {
        return;
    }
    let axis = depth % NU;
    let middle = nodes.len() / 2;
    let (node, index) = &nodes[middle];
    let key = ((0..NU).map(|j| (point[j] - node[j]).powi(2)).sum::<f64>(), *index);
    let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let place = found.partition_point(|f| order(f, &key).is_lt());
    if place < count {
        found.insert(place, key);
        found.truncate(count);
    }
    let offset = point[axis] - node[axis];
    let (before, after) = (&nodes[..middle], &nodes[middle + 1..]);
    let (near, far) = if offset < 0.0 { (before, after) } else { (after, before) };
    search(near, depth + 1, point, count, found);
    // An equally near pose beyond the plane may have the lower index: `<=`.
    if found.len() < count || found.last().is_some_and(|worst| offset * offset <= worst.0) {
        search(far, depth + 1, point, count, found);
    }
}
