//! The torque law (24) and the torque limiter.

use upswing_model::{ActuatedVector, Model, NU, State, Workspace};

/// Torque for the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque {
    /// tau_A, N m; finite and within the limits.
    pub tau: ActuatedVector,
    /// Whether the limiter cut at least one joint.
    pub limited: bool,
}

/// tau_A = M~ u + C~ qd + g~ (24) at the state `x` (rad, rad/s) for the input `u` (rad/s^2), less the torque that acts
/// besides (`disturbance`, N m; the paper knows none), limited to +-`tau_max` (N m); `None` if it is not finite.
pub fn torque(
    model: &Model,
    x: &State,
    u: &ActuatedVector,
    disturbance: &ActuatedVector,
    tau_max: &ActuatedVector,
    work: &mut Workspace,
) -> Option<Torque> {
    limit(&(model.torque(x, u, work) - disturbance), tau_max)
}

/// Limits `tau` to +-`tau_max` (both N m); `None` if it is not finite.
pub fn limit(tau: &ActuatedVector, tau_max: &ActuatedVector) -> Option<Torque> {
    if !tau.iter().all(|v| v.is_finite()) {
        return None;
    }
    let within = ActuatedVector::from_fn(|i, _| tau[i].min(tau_max[i]).max(-tau_max[i]));
    Some(Torque { tau: within, limited: (0..NU).any(|i| within[i] != tau[i]) })
}
