//! Orders of the joints of a chain: the chain's own, from base to tip, and the sorted one, [A, U].

use crate::{JointVector, MOST_JOINTS, Sizes, State};

/// The index sets A and U of a chain (2): where each joint of the chain stands in sorted vectors.
///
/// Files, payloads and tables have the chain's order; inside, vectors are sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Order {
    sizes: Sizes,
    /// Index in sorted vectors of joint i of the chain.
    coordinate: [u8; MOST_JOINTS],
    /// Joint of the chain of index c in sorted vectors.
    joint: [u8; MOST_JOINTS],
}

impl Order {
    /// The order of a chain in which joint i is actuated if `actuated[i]`; `None` if there is no [`Sizes`] of it.
    pub(crate) fn new(actuated: &[bool]) -> Option<Self> {
        let sizes = Sizes::new(actuated.len(), actuated.iter().filter(|a| **a).count())?;
        // Beyond the joints, each stands where it is: whole memories are sorted without a branch.
        let each = std::array::from_fn(|i| i as u8);
        let (mut coordinate, mut joint): ([u8; MOST_JOINTS], [u8; MOST_JOINTS]) = (each, each);
        let (mut next_a, mut next_u) = (0, sizes.actuated());
        for (i, actuated) in actuated.iter().enumerate() {
            let next = if *actuated { &mut next_a } else { &mut next_u };
            // Lossless: both are below 16.
            (coordinate[i], joint[*next]) = (*next as u8, i as u8);
            *next += 1;
        }
        Some(Self { sizes, coordinate, joint })
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// Index in sorted vectors of joint `joint` of the chain, counted from 0.
    #[inline(always)]
    pub fn coordinate(&self, joint: usize) -> usize {
        usize::from(self.coordinate[joint])
    }

    /// Joint of the chain, counted from 0, of index `coordinate` in sorted vectors.
    #[inline(always)]
    pub fn joint(&self, coordinate: usize) -> usize {
        usize::from(self.joint[coordinate])
    }

    /// Whether joint `joint` of the chain has a motor.
    #[inline(always)]
    pub fn is_actuated(&self, joint: usize) -> bool {
        self.coordinate(joint) < self.sizes.actuated()
    }

    /// The sorted vector of the values of the joints in the chain's order; `None` if their number is not that of the joints.
    pub fn sorted(&self, in_chain: &[f64]) -> Option<JointVector> {
        (in_chain.len() == self.sizes.joints())
            .then(|| JointVector::from_fn(self.sizes, |c| in_chain[self.joint(c)]))
    }

    /// The state of positions and velocities in the chain's order; `None` if their numbers are not those of the joints.
    pub fn sorted_state(&self, q: &[f64], qd: &[f64]) -> Option<State> {
        Some(State::new(&self.sorted(q)?, &self.sorted(qd)?))
    }

    /// The values of `sorted` in the chain's order, followed by zeros.
    #[inline]
    pub fn in_chain(&self, sorted: &JointVector) -> [f64; MOST_JOINTS] {
        debug_assert_eq!(sorted.sizes(), self.sizes);
        self.coordinate.map(|c| sorted.padded()[usize::from(c) % MOST_JOINTS])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sorting_and_its_inverse_keep_both_orders() {
        let order = Order::new(&[false, true, true, false, true]).expect("a chain");
        assert_eq!((order.sizes().joints(), order.sizes().actuated()), (5, 3));
        let chain = [0.0, 1.0, 2.0, 3.0, 4.0];
        let sorted = order.sorted(&chain).expect("five joints");
        assert_eq!(sorted.as_slice(), [1.0, 2.0, 4.0, 0.0, 3.0]);
        assert_eq!(order.in_chain(&sorted)[..5], chain);
        assert_eq!(order.sorted(&chain[..4]), None);
        assert!((0..5).all(|c| order.coordinate(order.joint(c)) == c));
    }
}
