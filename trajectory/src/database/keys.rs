//! Search of the keys of a database, such as the start poses of its entries, for those nearest to a given one.
//!
//! The keys are the leaves of a balanced binary tree, [`LEAF`] keys each, with the smallest box around the keys of each node. A node is
//! divided by rank, because keys on a regular grid have repeated coordinates, along the longest edge of its box. A file holds the keys in the
//! order of the tree. The boxes are computed when it is loaded: they bound the keys in any order, so that a search finds the nearest
//! keys whatever a file holds. Of equally near keys the one with the lower number wins, as in a linear search.

use std::ops::Range;

/// Number of keys in a leaf: few enough that a search skips most keys, enough that the boxes take a quarter of the memory of the keys.
const LEAF: usize = 16;

/// Keys in the order of the tree, with the boxes of its nodes.
#[derive(Clone, Debug, Default)]
pub struct KeyTree {
    /// Number of coordinates of a key.
    width: usize,
    /// Numbers of the keys in the order of the tree.
    numbers: Vec<u32>,
    /// The keys in the order of the tree, one after the other.
    points: Vec<f64>,
    /// Lower, then upper corner of the box of each node; a node comes before its first half, that before the second half.
    boxes: Vec<f64>,
}

/// A key found by [`KeyTree::nearest`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Number of the key in the list that the tree was built from.
    pub index: usize,
    /// Weighted distance sqrt(sum_i w_i (q_i - p_i)^2), rad or m.
    pub distance: f64,
}

/// A node of the tree.
#[derive(Clone)]
struct Node {
    number: usize,
    /// Its leaves, one or more.
    leaves: Range<usize>,
}

impl Node {
    /// The halves of a node with more than one leaf.
    fn halves(&self) -> Option<[Self; 2]> {
        let Range { start, end } = self.leaves;
        let middle = start + (end - start) / 2;
        (end - start > 1).then(|| {
            // A node of m leaves and those below it are 2 m - 1.
            let second = self.number + 2 * (middle - start);
            [
                Self { number: self.number + 1, leaves: start..middle },
                Self { number: second, leaves: middle..end },
            ]
        })
    }
}

/// What is searched for.
struct Query {
    /// Square roots of the weights of the metric.
    scale: Vec<f64>,
    /// The wanted key in coordinates multiplied by `scale`, in which the distance is Euclidean.
    point: Vec<f64>,
    /// Number of neighbours.
    count: usize,
    /// The nearest keys so far: squared distance and number, sorted.
    found: Vec<(f64, u32)>,
}

impl KeyTree {
    /// The tree of `keys`, `width` coordinates each, one after the other.
    pub fn new(width: usize, keys: &[f64]) -> Self {
        let count = keys.len().checked_div(width).unwrap_or(0);
        let mut numbers: Vec<u32> = (0..count).filter_map(|number| number.try_into().ok()).collect();
        arrange(&mut numbers, width, keys);
        let points = numbers.iter().flat_map(|number| row(width, keys, *number as usize)).copied().collect();
        Self::arranged(width, numbers, points)
    }

    /// The tree of keys in its order, each with its number.
    pub(super) fn arranged(width: usize, numbers: Vec<u32>, points: Vec<f64>) -> Self {
        let nodes = (2 * numbers.len().div_ceil(LEAF)).saturating_sub(1);
        let mut tree = Self { width, numbers, points, boxes: vec![0.0; 2 * width * nodes] };
        if let Some(root) = tree.root() {
            tree.enclose(&root);
        }
        tree
    }

    /// Numbers of the keys in the order of the tree.
    pub(super) fn numbers(&self) -> &[u32] {
        &self.numbers
    }

    /// The keys in the order of the tree, one after the other.
    pub(super) fn points(&self) -> &[f64] {
        &self.points
    }

    /// The keys, each with its number, in the order of the tree.
    pub fn keys(&self) -> impl Iterator<Item = (usize, &[f64])> {
        (0..self.numbers.len()).map(|i| (self.numbers[i] as usize, row(self.width, &self.points, i)))
    }

    fn root(&self) -> Option<Node> {
        let leaves = 0..self.numbers.len().div_ceil(LEAF);
        (!leaves.is_empty()).then_some(Node { number: 0, leaves })
    }

    /// Positions of the keys of the leaf `leaf`.
    fn of_leaf(&self, leaf: usize) -> Range<usize> {
        leaf * LEAF..((leaf + 1) * LEAF).min(self.numbers.len())
    }

    /// Computes the box of a node, and of those below it.
    fn enclose(&mut self, node: &Node) {
        let (width, size) = (self.width, 2 * self.width);
        if let Some(halves) = node.halves() {
            halves.iter().for_each(|half| self.enclose(half));
            for i in 0..width {
                let [a, b] = halves.clone().map(|half| half.number * size + i);
                let at = node.number * size + i;
                self.boxes[at] = self.boxes[a].min(self.boxes[b]);
                self.boxes[at + width] = self.boxes[a + width].max(self.boxes[b + width]);
            }
            return;
        }
        let keys = self.of_leaf(node.leaves.start);
        let (low, high) = self.boxes[node.number * size..][..size].split_at_mut(width);
        low.fill(f64::INFINITY);
        high.fill(f64::NEG_INFINITY);
        for key in keys {
            for ((low, high), v) in low.iter_mut().zip(high.iter_mut()).zip(row(width, &self.points, key)) {
                *low = low.min(*v);
                *high = high.max(*v);
            }
        }
    }

    /// The `count` keys nearest to `key` (rad or m), nearest first, by the squared distance weighted by `metric`: one weight per coordinate;
    /// coordinates without a weight do not count. Fewer if there are fewer keys.
    pub fn nearest(&self, key: &[f64], metric: &[f64], count: usize) -> Vec<Neighbour> {
        let scale: Vec<f64> = metric.iter().take(self.width).map(|w| w.sqrt()).collect();
        let point = scale.iter().enumerate().map(|(i, s)| key.get(i).map_or(0.0, |v| v * s)).collect();
        let mut query = Query { scale, point, count, found: Vec::with_capacity(count + 1) };
        if let Some(root) = self.root().filter(|_| count > 0) {
            self.search(&root, &mut query);
        }
        let neighbour =
            |(squared, number): (f64, u32)| Neighbour { index: number as usize, distance: squared.sqrt() };
        query.found.into_iter().map(neighbour).collect()
    }

    /// Adds the keys of a node that are among the nearest.
    fn search(&self, node: &Node, query: &mut Query) {
        let Some(halves) = node.halves() else {
            for key in self.of_leaf(node.leaves.start) {
                query.offer(self.numbers[key], row(self.width, &self.points, key));
            }
            return;
        };
        let [first, second] = halves.map(|half| (query.bound(self.bounds(&half)), half));
        let order = if second.0 < first.0 { [second, first] } else { [first, second] };
        for (bound, half) in order {
            // A key as far away as the farthest one may have the lower number: `<=`.
            if query.worst().is_none_or(|worst| bound <= worst) {
                self.search(&half, query);
            }
        }
    }

    fn bounds(&self, node: &Node) -> &[f64] {
        row(2 * self.width, &self.boxes, node.number)
    }
}

impl Query {
    /// Squared distance of the farthest of the neighbours; `None` as long as some are missing.
    fn worst(&self) -> Option<f64> {
        self.found.get(self.count - 1).map(|(squared, _)| *squared)
    }

    /// The squared distance to a box: at most that to each key in it, also as rounded, because every operation is monotonic and the
    /// order of the sum the same.
    fn bound(&self, bounds: &[f64]) -> f64 {
        let (low, high) = bounds.split_at(bounds.len() / 2);
        let coordinates = self.point.iter().zip(&self.scale).zip(low.iter().zip(high));
        let squared = |((p, s), (low, high)): ((&f64, &f64), (&f64, &f64))| {
            let outside = (low * s - p).max(p - high * s).max(0.0);
            outside * outside
        };
        coordinates.map(squared).sum()
    }

    fn offer(&mut self, number: u32, key: &[f64]) {
        let offsets = self.point.iter().zip(&self.scale).zip(key).map(|((p, s), v)| p - v * s);
        let candidate = (offsets.map(|d| d * d).sum::<f64>(), number);
        if self.worst().is_some_and(|worst| candidate.0 > worst) {
            return;
        }
        let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let place = self.found.partition_point(|f| order(f, &candidate).is_lt());
        self.found.insert(place, candidate);
        self.found.truncate(self.count);
    }
}

/// Row number `i` of `values`.
fn row(width: usize, values: &[f64], i: usize) -> &[f64] {
    &values[i * width..][..width]
}

/// Puts `numbers` of keys in the order of the tree. Sets and their order are unique, so that the bytes of a file are.
fn arrange(numbers: &mut [u32], width: usize, keys: &[f64]) {
    let leaves = numbers.len().div_ceil(LEAF);
    if leaves < 2 {
        return numbers.sort_unstable();
    }
    let mut longest = (0, f64::NEG_INFINITY);
    for axis in 0..width {
        let limits = (f64::INFINITY, f64::NEG_INFINITY);
        let positions = numbers.iter().map(|number| keys[*number as usize * width + axis]);
        let (low, high) = positions.fold(limits, |(low, high), v| (low.min(v), high.max(v)));
        if high - low > longest.1 {
            longest = (axis, high - low);
        }
    }
    let position = |number: &u32| keys[*number as usize * width + longest.0];
    let middle = leaves / 2 * LEAF;
    numbers.select_nth_unstable_by(middle, |a, b| position(a).total_cmp(&position(b)).then(a.cmp(b)));
    let (first, second) = numbers.split_at_mut(middle);
    arrange(first, width, keys);
    arrange(second, width, keys);
}
