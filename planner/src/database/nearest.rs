//! K-D tree over the keys of a database, such as the start poses of its entries (Bentley, *Multidimensional binary search trees
//! used for associative searching*, CACM 18, 1975).
//!
//! Nodes are split by rank, not by value, so that the tree of a regular grid with its repeated coordinates is balanced; of
//! equally near keys the key with the lower index wins, as in a linear search.

/// K-D tree of keys, stored with their indices in the order of an in-order traversal of a balanced tree.
#[derive(Clone, Debug)]
pub struct NearestKey {
    /// Square roots of the weights of the metric.
    scale: Vec<f64>,
    nodes: Vec<Node>,
}

/// A key with its index.
#[derive(Clone, Debug)]
struct Node {
    /// The key in coordinates scaled by the square root of the metric, in which the distance is Euclidean.
    point: Vec<f64>,
    index: usize,
}

/// A key found by [`NearestKey::nearest`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Index of the key in the list that the tree was built from.
    pub index: usize,
    /// Weighted distance sqrt(sum_i w_i (q_i - p_i)^2), rad or m.
    pub distance: f64,
}

impl NearestKey {
    /// Builds the tree of `keys` (rad or m) for the squared distance weighted by `metric`: one weight per coordinate. Coordinates
    /// without a weight do not count.
    pub fn new(keys: impl IntoIterator<Item = Vec<f64>>, metric: &[f64]) -> Self {
        let scale: Vec<f64> = metric.iter().map(|w| w.sqrt()).collect();
        let keys = keys.into_iter().enumerate();
        let mut nodes: Vec<_> =
            keys.map(|(index, key)| Node { point: scaled(&key, &scale), index }).collect();
        arrange(&mut nodes, 0);
        Self { scale, nodes }
    }

    /// The `count` nearest keys to `key` (rad or m), nearest first; fewer if the tree has fewer keys.
    pub fn nearest(&self, key: &[f64], count: usize) -> Vec<Neighbour> {
        let point = scaled(key, &self.scale);
        let mut found = Vec::with_capacity(count + 1);
        if count > 0 {
            search(&self.nodes, 0, &point, count, &mut found);
        }
        found.into_iter().map(|(d, index)| Neighbour { index, distance: d.sqrt() }).collect()
    }
}

/// The point of a key; missing coordinates are 0.
fn scaled(key: &[f64], scale: &[f64]) -> Vec<f64> {
    scale.iter().enumerate().map(|(i, s)| key.get(i).map_or(0.0, |v| v * s)).collect()
}

/// The coordinate by which a node at `depth` divides space; 0 without coordinates.
fn dividing(point: &[f64], depth: usize) -> f64 {
    point.get(depth % point.len().max(1)).copied().unwrap_or(0.0)
}

/// Arranges `nodes` as a tree: the median of the coordinate `depth` modulo their number in the middle, the halves recursively.
fn arrange(nodes: &mut [Node], depth: usize) {
    if nodes.len() < 2 {
        return;
    }
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by(middle, |a, b| {
        let order = dividing(&a.point, depth).total_cmp(&dividing(&b.point, depth));
        order.then(a.index.cmp(&b.index))
    });
    let (before, rest) = nodes.split_at_mut(middle);
    arrange(before, depth + 1);
    arrange(&mut rest[1..], depth + 1);
}

/// Collects the nearest nodes below a subtree as (squared distance, index), sorted, at most `count`.
fn search(nodes: &[Node], depth: usize, point: &[f64], count: usize, found: &mut Vec<(f64, usize)>) {
    if nodes.is_empty() {
        return;
    }
    let middle = nodes.len() / 2;
    let node = &nodes[middle];
    let squared = point.iter().zip(&node.point).map(|(p, n)| (p - n).powi(2)).sum::<f64>();
    let candidate = (squared, node.index);
    let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let place = found.partition_point(|f| order(f, &candidate).is_lt());
    if place < count {
        found.insert(place, candidate);
        found.truncate(count);
    }
    let offset = dividing(point, depth) - dividing(&node.point, depth);
    let (before, after) = (&nodes[..middle], &nodes[middle + 1..]);
    let (near, far) = if offset < 0.0 { (before, after) } else { (after, before) };
    search(near, depth + 1, point, count, found);
    // An equally near key beyond the plane may have the lower index: `<=`.
    if found.len() < count || found.last().is_some_and(|worst| offset * offset <= worst.0) {
        search(far, depth + 1, point, count, found);
    }
}
