//! Torque law (24) and torque limiter.

use nalgebra::SMatrix;
use upswing_model::{
    ActuatedMatrix, ActuatedVector, HybridDynamics, JointParts, JointVector, Model, N_UNACTUATED, NQ, NU,
    State, Workspace,
};

/// Torque for the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Torque {
    /// tau_A, N m; finite and within the limits.
    pub tau: ActuatedVector,
    /// Part of the torque that the limiter cut, N m.
    pub cut: ActuatedVector,
    /// Whether the limiter cut at least one joint.
    pub limited: bool,
    /// Acceleration qdd = [u, qdd_U] (3a) of the uncut torque, rad/s^2.
    pub qdd: JointVector,
}

impl Torque {
    /// Moves from `last` towards this torque on the straight line, as far as no joint changes by more than `most` (N m). On this line
    /// the accelerations lie between those of both ends; with a limit per joint they would not, if M~ is nearly singular.
    #[must_use]
    pub fn near(self, last: &ActuatedVector, most: &ActuatedVector) -> Self {
        let way = self.tau - last;
        let share = (0..NU).fold(1.0, |share: f64, i| share.min(most[i] / way[i].abs()));
        if share >= 1.0 {
            return self;
        }
        Self { tau: last + way * share, limited: true, ..self }
    }
}

/// Joint-space inertia of the robot in the state for which a torque was computed, kg m^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpaceInertia {
    /// Reduced inertia M~ (10).
    pub reduced: ActuatedMatrix,
    /// Columns of M for the unactuated joints.
    pub unactuated: SMatrix<f64, NQ, N_UNACTUATED>,
}

/// Computes tau_A = M~ u + C~ qd + g~ (24) at the state `x` (rad, rad/s) for the input `u` (rad/s^2), minus the `disturbance` torque
/// (N m; the paper has none), limited to +-`tau_max` (N m), and the inertia in `x`; `None` if
/// the torque is not finite.
pub fn torque(
    model: &Model,
    x: &State,
    u: &ActuatedVector,
    disturbance: &ActuatedVector,
    tau_max: &ActuatedVector,
    work: &mut Workspace,
) -> Option<(Torque, JointSpaceInertia)> {
    let HybridDynamics { qdd_u, tau } = model.hybrid_dynamics(x, u, work);
    let tau = tau - disturbance;
    if !tau.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut qdd = JointVector::zeros();
    qdd.actuated_mut().copy_from(u);
    qdd.unactuated_mut().copy_from(&qdd_u);
    let within = ActuatedVector::from_fn(|i, _| tau[i].min(tau_max[i]).max(-tau_max[i]));
    let limited = (0..NU).any(|i| within[i] != tau[i]);
    let inertia =
        JointSpaceInertia { reduced: model.reduced_inertia(work), unactuated: work.unactuated_columns() };
    Some((Torque { tau: within, cut: tau - within, limited, qdd }, inertia))
}

#[cfg(test)]
mod tests {
    use super::{Torque, torque};
    use upswing_config::Config;
    use upswing_model::{ActuatedVector, JointVector, NU, State, StateParts, Workspace, state};

    /// Returns a state in motion, and an input.
    fn motion() -> (State, ActuatedVector) {
        let q = JointVector::from_fn(|i, _| 0.3 * (i as f64 - 4.0));
        let qd = JointVector::from_fn(|i, _| 0.7 - 0.2 * i as f64);
        (state(&q, &qd), ActuatedVector::from_fn(|i, _| 2.0 - 0.8 * i as f64))
    }

    /// Computes the torque for a disturbance and limits, N m.
    fn law(x: &State, u: &ActuatedVector, disturbance: f64, limit: f64) -> Option<Torque> {
        let config = Config::embedded().expect("settings");
        let [disturbance, limit] = [disturbance, limit].map(ActuatedVector::repeat);
        let law = torque(&config.model, x, u, &disturbance, &limit, &mut Workspace::default());
        law.map(|(torque, _)| torque)
    }

    #[test]
    fn the_arm_accelerates_as_asked() {
        let (x, u) = motion();
        let model = Config::embedded().expect("settings").model;
        for disturbance in [0.0, 3.0] {
            let Torque { tau, limited, qdd, .. } = law(&x, &u, disturbance, 1e3).expect("finite");
            // The disturbance acts on the arm, too.
            let load = JointVector::from_fn(|i, _| if i < NU { tau[i] + disturbance } else { 0.0 });
            let got = model.forward_dynamics(&x.q(), &x.qd(), &load, &mut Workspace::default());
            let error = (got.expect("a solution") - qdd).amax();
            // Rounding errors, with inertias of 0.001 to 10 kg m^2.
            assert!(error < 1e-9 && !limited, "{error:e} rad/s^2");
            assert!((0..NU).all(|i| qdd[i] == u[i]), "{qdd} is not {u}");
        }
    }

    #[test]
    fn no_joint_gets_more_than_its_limit() {
        let (x, u) = motion();
        let free = law(&x, &u, 0.0, 1e3).expect("finite").tau;
        let cut = law(&x, &u, 0.0, 5.0).expect("finite");
        assert!(cut.limited && free.amax() > 5.0);
        for i in 0..NU {
            assert_eq!(cut.tau[i], free[i].clamp(-5.0, 5.0), "joint {}", i + 1);
            assert_eq!(cut.cut[i], free[i] - cut.tau[i], "joint {}: what was taken off", i + 1);
        }
    }

    #[test]
    fn a_torque_near_the_last_one_is_as_near_as_it_may_be() {
        let (x, u) = motion();
        let free = law(&x, &u, 0.0, 1e3).expect("finite");
        let step = ActuatedVector::from_fn(|i, _| 1.0 + i as f64);
        for (by, limited) in [(0.9, false), (-0.9, false), (3.0, true), (-3.0, true)] {
            let last = free.tau + step * by;
            let near = free.near(&last, &step);
            let expected = if limited { last - step * by.signum() } else { free.tau };
            assert!((near.tau - expected).amax() < 1e-12, "{by}: {}", near.tau);
            assert_eq!((near.limited, near.qdd), (limited, free.qdd), "{by}");
        }
        // One joint that is far away slows the others down: the accelerations stay between those of both torques.
        let last = free.tau - ActuatedVector::from_fn(|i, _| if i == 0 { 4.0 } else { 0.4 });
        let way = free.near(&last, &ActuatedVector::repeat(1.0)).tau - last;
        assert!((way - (free.tau - last) * 0.25).amax() < 1e-12, "{way}");
        // A torque that was cut stays marked.
        assert!(law(&x, &u, 0.0, 5.0).expect("finite").near(&free.tau, &(step * 1e3)).limited);
    }

    #[test]
    fn what_is_not_a_number_gives_no_torque() {
        let (x, mut u) = motion();
        u[3] = f64::NAN;
        assert_eq!(law(&x, &u, 0.0, 1e3), None);
        // One NaN is enough.
        let config = Config::embedded().expect("settings");
        for (joint, value) in (0..NU).flat_map(|i| [f64::NAN, f64::INFINITY].map(|value| (i, value))) {
            let (x, u) = motion();
            let mut disturbance = ActuatedVector::zeros();
            disturbance[joint] = value;
            let limit = ActuatedVector::repeat(1e3);
            let got = torque(&config.model, &x, &u, &disturbance, &limit, &mut Workspace::default());
            assert_eq!(got, None, "{value} on joint {}", joint + 1);
        }
    }
}
