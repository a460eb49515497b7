//! Joints in payloads: their numbers, and the arrays with a value per joint.

use thiserror::Error;
use upswing_model::{ActuatedVector, JointVector, MOST_JOINTS, Order, Sizes, State};

/// One value per joint in the chain's order, or one per actuated joint in that order; 0 beyond their number.
pub(super) type PerJoint = [f64; MOST_JOINTS];

/// A payload from a process with another chain than that of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "{payload} of {joints} joints, {actuated} of them actuated: expected {} and {}; run the same system in all processes",
    .expected.joints(), .expected.actuated()
)]
pub struct OtherChain {
    /// Name of the payload, for example "measurement".
    pub payload: &'static str,
    /// Number of joints in the payload.
    pub joints: u64,
    /// Number of actuated joints in the payload.
    pub actuated: u64,
    /// Numbers of joints of the model.
    pub expected: Sizes,
}

/// Checks the numbers of joints in a payload.
pub(super) fn check(
    payload: &'static str,
    (joints, actuated): (u64, u64),
    expected: Sizes,
) -> Result<(), OtherChain> {
    if (joints, actuated) == numbers(expected) {
        return Ok(());
    }
    Err(OtherChain { payload, joints, actuated, expected })
}

/// n and n_A as payloads have them.
pub(super) fn numbers(sizes: Sizes) -> (u64, u64) {
    (sizes.joints() as u64, sizes.actuated() as u64)
}

/// The sorted vector of the values of the joints.
pub(super) fn sorted(order: &Order, values: &PerJoint) -> JointVector {
    JointVector::from_fn(order.sizes(), |c| values[order.joint(c)])
}

/// The state of the values of the joints.
pub(super) fn state(order: &Order, q: &PerJoint, qd: &PerJoint) -> State {
    State::new(&sorted(order, q), &sorted(order, qd))
}

/// The vector of the values of the actuated joints. Their order is the same in the chain and in sorted vectors.
pub(super) fn actuated(sizes: Sizes, values: &PerJoint) -> ActuatedVector {
    ActuatedVector::from_fn(sizes, |i| values[i])
}

/// The values that belong to joints: at most `number`, which is not to be trusted.
pub(super) fn used(values: &PerJoint, number: u64) -> &[f64] {
    let number = usize::try_from(number).map_or(MOST_JOINTS, |n| n.min(MOST_JOINTS));
    &values[..number]
}
