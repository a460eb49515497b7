//! The torque law (24) and the torque limiter.

use upswing_model::{
    Accelerations, ActuatedVector, JointVector, Model, N_ACTUATED, N_UNACTUATED, NU, State, Workspace,
};

/// Torque for the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque {
    /// tau_A, N m; finite and within the limits.
    pub tau: ActuatedVector,
    /// Whether the limiter cut at least one joint.
    pub limited: bool,
    /// qdd = [u, qdd_U] (3a) that belongs to it if nothing was cut, rad/s^2.
    pub qdd: JointVector,
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
    let Accelerations { qdd_u, tau } = model.accelerations(x, u, work);
    let tau = tau - disturbance;
    if !tau.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut qdd = JointVector::zeros();
    qdd.fixed_rows_mut::<N_ACTUATED>(0).copy_from(u);
    qdd.fixed_rows_mut::<N_UNACTUATED>(N_ACTUATED).copy_from(&qdd_u);
    let within = ActuatedVector::from_fn(|i, _| tau[i].min(tau_max[i]).max(-tau_max[i]));
    Some(Torque { tau: within, limited: (0..NU).any(|i| within[i] != tau[i]), qdd })
}
