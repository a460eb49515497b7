//! Torque law (24) and torque limiter.

use upswing_model::{
    ActuatedMatrix, ActuatedVector, HybridDynamics, JointVector, Joints, Matrix, Model, Sizes, State,
    Unactuated, Workspace,
};

/// Torque for the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque {
    /// tau_A; finite and within the limits.
    pub tau: ActuatedVector,
    /// Part of the torque that the limiter cut.
    pub cut: ActuatedVector,
    /// Whether the limiter cut at least one joint.
    pub limited: bool,
    /// Acceleration qdd = [u, qdd_U] (3a) of the uncut torque.
    pub qdd: JointVector,
}

impl Torque {
    /// No torque, for closed brakes.
    pub fn none(sizes: Sizes) -> Self {
        let none = ActuatedVector::zeros(sizes);
        Self { tau: none, cut: none, limited: false, qdd: JointVector::zeros(sizes) }
    }

    /// Moves from `last` towards this torque on the straight line, as far as no joint changes by more than `most`. On this line
    /// the accelerations lie between those of both ends; with a limit per joint they would not, if M~ is nearly singular.
    #[must_use]
    pub fn near(self, last: &ActuatedVector, most: &ActuatedVector) -> Self {
        let way = self.tau - last;
        let share =
            most.iter().zip(way.iter()).fold(1.0, |share: f64, (most, way)| share.min(most / way.abs()));
        if share >= 1.0 {
            return self;
        }
        Self { tau: last + way * share, limited: true, ..self }
    }
}

/// Joint-space inertia of the robot in the state for which a torque was computed.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSpaceInertia {
    /// Reduced inertia M~ (10).
    pub reduced: ActuatedMatrix,
    /// Rows [M_UA, M_UU] of M (2) of the unactuated joints.
    pub unactuated: Matrix<Unactuated, Joints>,
}

impl JointSpaceInertia {
    /// The inertia 0.
    pub const fn zeros(sizes: Sizes) -> Self {
        Self { reduced: ActuatedMatrix::zeros(sizes), unactuated: Matrix::zeros(sizes) }
    }
}

/// Computes tau_A = M~ u + C~ qd + g~ (24) at the state `x` for the input `u`, minus the `disturbance` torque (the paper has none),
/// limited to +-`tau_max`, and the `inertia` in `x`; `None` if the torque is not finite, and then `inertia` is as before.
#[inline(always)]
pub fn torque(
    model: &Model,
    x: &State,
    u: &ActuatedVector,
    disturbance: &ActuatedVector,
    tau_max: &ActuatedVector,
    work: &mut Workspace,
    inertia: &mut JointSpaceInertia,
) -> Option<Torque> {
    let HybridDynamics { qdd_u, tau } = model.hybrid_dynamics(x, u, work);
    let tau = tau - disturbance;
    if !tau.iter().all(|v| v.is_finite()) {
        return None;
    }
    let within = tau.inf(tau_max).sup(&-tau_max);
    model.write_reduced_inertia(work, &mut inertia.reduced);
    model.write_unactuated_rows(work, &mut inertia.unactuated);
    Some(Torque {
        tau: within,
        cut: tau - within,
        limited: within != tau,
        qdd: JointVector::joined(u, &qdd_u),
    })
}

#[cfg(test)]
mod tests {
    use super::{JointSpaceInertia, Torque, torque};
    use upswing_config::Config;
    use upswing_model::{ActuatedVector, JointVector, Model, State, UnactuatedVector, Workspace};

    fn model() -> Model {
        Config::embedded().expect("settings").model
    }

    /// Returns a state in motion, and an input.
    fn motion() -> (State, ActuatedVector) {
        let sizes = model().sizes();
        let q = JointVector::from_fn(sizes, |i| 0.3 * (i as f64 - 4.0));
        let qd = JointVector::from_fn(sizes, |i| 0.7 - 0.2 * i as f64);
        (State::new(&q, &qd), ActuatedVector::from_fn(sizes, |i| 2.0 - 0.8 * i as f64))
    }

    /// Computes the torque for a disturbance and limits, N m.
    fn law(x: &State, u: &ActuatedVector, disturbance: f64, limit: f64) -> Option<Torque> {
        let [disturbance, limit] = [disturbance, limit].map(|v| ActuatedVector::repeat(x.sizes(), v));
        law_with(x, u, &disturbance, &limit)
    }

    fn law_with(
        x: &State,
        u: &ActuatedVector,
        disturbance: &ActuatedVector,
        limit: &ActuatedVector,
    ) -> Option<Torque> {
        let mut inertia = JointSpaceInertia::zeros(x.sizes());
        torque(&model(), x, u, disturbance, limit, &mut Workspace::default(), &mut inertia)
    }

    #[test]
    fn the_arm_accelerates_as_asked() {
        let (x, u) = motion();
        let model = model();
        for disturbance in [0.0, 3.0] {
            let Torque { tau, limited, qdd, .. } = law(&x, &u, disturbance, 1e3).expect("finite");
            // The disturbance acts on the arm, too.
            let disturbance = ActuatedVector::repeat(x.sizes(), disturbance);
            let load = JointVector::joined(&(tau + disturbance), &UnactuatedVector::zeros(x.sizes()));
            let got = model.forward_dynamics(&x.q(), &x.qd(), &load, &mut Workspace::default());
            let error = (got.expect("a solution") - qdd).amax();
            // Rounding errors, with inertias of 0.001 to 10 kg m^2.
            assert!(error < 1e-9 && !limited, "{error:e} rad/s^2");
            assert_eq!(qdd.actuated(), u);
        }
    }

    #[test]
    fn no_joint_gets_more_than_its_limit() {
        let (x, u) = motion();
        let free = law(&x, &u, 0.0, 1e3).expect("finite").tau;
        let cut = law(&x, &u, 0.0, 5.0).expect("finite");
        assert!(cut.limited && free.amax() > 5.0);
        for i in 0..u.len() {
            assert_eq!(cut.tau[i], free[i].clamp(-5.0, 5.0), "joint {}", i + 1);
            assert_eq!(cut.cut[i], free[i] - cut.tau[i], "joint {}: what was taken off", i + 1);
        }
    }

    #[test]
    fn a_torque_near_the_last_one_is_as_near_as_it_may_be() {
        let (x, u) = motion();
        let free = law(&x, &u, 0.0, 1e3).expect("finite");
        let step = ActuatedVector::from_fn(x.sizes(), |i| 1.0 + i as f64);
        for (by, limited) in [(0.9, false), (-0.9, false), (3.0, true), (-3.0, true)] {
            let last = free.tau + step * by;
            let near = free.near(&last, &step);
            let expected = if limited { last - step * by.signum() } else { free.tau };
            assert!((near.tau - expected).amax() < 1e-12, "{by}: {:?}", near.tau);
            assert_eq!((near.limited, near.qdd), (limited, free.qdd), "{by}");
        }
        // One joint that is far away slows the others down: the accelerations stay between those of both torques.
        let last = free.tau - ActuatedVector::from_fn(x.sizes(), |i| if i == 0 { 4.0 } else { 0.4 });
        let way = free.near(&last, &ActuatedVector::repeat(x.sizes(), 1.0)).tau - last;
        assert!((way - (free.tau - last) * 0.25).amax() < 1e-12, "{way:?}");
        // A torque that was cut stays marked.
        assert!(law(&x, &u, 0.0, 5.0).expect("finite").near(&free.tau, &(step * 1e3)).limited);
    }

    #[test]
    fn what_is_not_a_number_gives_no_torque() {
        let (x, mut u) = motion();
        u[3] = f64::NAN;
        assert_eq!(law(&x, &u, 0.0, 1e3), None);
        // One NaN is enough.
        let (x, u) = motion();
        for (joint, value) in (0..u.len()).flat_map(|i| [f64::NAN, f64::INFINITY].map(|value| (i, value))) {
            let mut disturbance = ActuatedVector::zeros(x.sizes());
            disturbance[joint] = value;
            let got = law_with(&x, &u, &disturbance, &ActuatedVector::repeat(x.sizes(), 1e3));
            assert_eq!(got, None, "{value} on joint {}", joint + 1);
        }
    }
}
