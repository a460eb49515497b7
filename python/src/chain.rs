//! Conversion between the order of the chain, which Python sees, and the sorted vectors of the libraries.

use upswing_model::{ActuatedVector, JointVector, Order, State};

/// The sorted vector of values in the chain's order, as many as joints.
pub fn joints(order: &Order, values: &[f64]) -> JointVector {
    JointVector::from_fn(order.sizes(), |c| values[order.joint(c)])
}

/// The sorted state of [q, qd] in the chain's order, as many as twice the joints.
pub fn state(order: &Order, x: &[f64]) -> State {
    let (q, qd) = x.split_at(order.sizes().joints());
    State::new(&joints(order, q), &joints(order, qd))
}

/// The values of actuated joints, which have the same order in the chain and in sorted vectors.
pub fn actuated(order: &Order, values: &[f64]) -> ActuatedVector {
    ActuatedVector::from_fn(order.sizes(), |i| values[i])
}

/// Writes a vector of joints in the chain's order.
pub fn write_joints(order: &Order, v: &JointVector, out: &mut [f64]) {
    for (joint, out) in out.iter_mut().enumerate() {
        *out = v[order.coordinate(joint)];
    }
}

/// Writes a state as [q, qd] in the chain's order.
pub fn write_state(order: &Order, x: &State, out: &mut [f64]) {
    for (row, out) in out.iter_mut().enumerate() {
        *out = x[state_row(order, row)];
    }
}

/// Row in a sorted state of row `row` of [q, qd] in the chain's order.
pub fn state_row(order: &Order, row: usize) -> usize {
    let n = order.sizes().joints();
    if row < n { order.coordinate(row) } else { n + order.coordinate(row - n) }
}

/// Row in sorted z = [q, qd, u] of row `row` of z in the chain's order.
pub fn knot_row(order: &Order, row: usize) -> usize {
    if row < order.sizes().state() { state_row(order, row) } else { row }
}

/// Values of joints in the chain's order.
pub fn in_chain(order: &Order, v: &JointVector) -> Vec<f64> {
    let mut out = vec![0.0; order.sizes().joints()];
    write_joints(order, v, &mut out);
    out
}

/// [q, qd] in the chain's order.
pub fn state_in_chain(order: &Order, x: &State) -> Vec<f64> {
    let mut out = vec![0.0; order.sizes().state()];
    write_state(order, x, &mut out);
    out
}
