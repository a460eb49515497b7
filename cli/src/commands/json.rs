//! Types of JSON output that several commands share.

use serde::Serialize;
use upswing_model::{Order, State};
use upswing_trajectory::Trajectory;

/// A trajectory as JSON: t_F in s, x (N + 1 rows [q, qd]) and u (N + 1 rows) in SI units, joints in the chain's order.
#[derive(Clone, Debug, Serialize)]
pub struct TrajectoryJson {
    /// t_F, s.
    pub t_f: f64,
    /// States x_k at the knots.
    pub x: Vec<Vec<f64>>,
    /// Inputs u_k.
    pub u: Vec<Vec<f64>>,
}

impl TrajectoryJson {
    /// The trajectory of a chain with this order of joints.
    pub fn new(t: &Trajectory, order: &Order) -> Self {
        Self {
            t_f: t.t_f,
            x: t.x.iter().map(|x| in_chain(order, x)).collect(),
            u: t.u.iter().map(|u| u.to_vec()).collect(),
        }
    }
}

/// [q, qd] of a state in the chain's order.
pub fn in_chain(order: &Order, x: &State) -> Vec<f64> {
    let joints = order.sizes().joints();
    [x.q(), x.qd()].iter().flat_map(|v| order.in_chain(v).into_iter().take(joints)).collect()
}
