//! Chains of links of any size, and a problem for them.

use upswing_model::{ActuatedVector, JointVector, Limits, Model, State};
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::problem::{Problem, TorqueConstraint};
use upswing_ocp::qp::{Qp, QpWeights};
use upswing_ocp::slab::KnotVector;
use upswing_trajectory::Trajectory;

/// Duration of a motion, s.
pub const DURATION: f64 = 2.0;

/// A chain of links that hang from the first joint, with a motion that it tracks.
pub struct Chain {
    pub model: Model,
    /// Nothing moves.
    pub hanging: Trajectory,
}

impl Chain {
    /// `n` links on parallel horizontal axes, the last of them unactuated; a trajectory has `intervals`.
    pub fn new(n: usize, actuated: usize, intervals: usize) -> Self {
        let mut text = "<robot name=\"links\"><link name=\"link_0\"/>".to_owned();
        for i in 0..n {
            let (next, place) = (i + 1, if i == 0 { 0.0 } else { -0.3 });
            let effort = if i < actuated { 100 } else { 0 };
            text += &format!(
                "<link name=\"link_{next}\"><inertial><origin xyz=\"0 0 -0.15\"/><mass value=\"1\"/>\
                 <inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.01\" iyz=\"0\" izz=\"0.01\"/></inertial></link>\
                 <joint name=\"joint_{next}\" type=\"revolute\"><parent link=\"link_{i}\"/><child link=\"link_{next}\"/>\
                 <origin xyz=\"0 0 {place}\"/><axis xyz=\"0 1 0\"/>\
                 <limit lower=\"-2\" upper=\"2\" velocity=\"5\" effort=\"{effort}\"/></joint>"
            );
        }
        let model = Model::from_urdf(&(text + "</robot>")).unwrap_or_else(|e| panic!("{e}"));
        let sizes = model.sizes();
        let hanging = Trajectory {
            t_f: DURATION,
            x: vec![State::zeros(sizes); intervals + 1],
            u: vec![ActuatedVector::zeros(sizes); intervals + 1],
        };
        Self { model, hanging }
    }

    /// To bring the chain to rest from a pose in which its first joint is deflected.
    pub fn problem(&self) -> Problem<'_> {
        let sizes = self.model.sizes();
        let mut start = State::zeros(sizes);
        start.q_a_mut()[0] = 0.5;
        Problem {
            model: &self.model,
            intervals: self.hanging.intervals(),
            limits: Limits {
                q_min: JointVector::repeat(sizes, -2.0),
                q_max: JointVector::repeat(sizes, 2.0),
                qd_max: JointVector::repeat(sizes, 1.5),
                tau_max: ActuatedVector::repeat(sizes, 300.0),
            },
            narrower: Vec::new(),
            torque: TorqueConstraint::Exact,
            input_weight: 1e-2,
            t_f: (0.5, 4.0),
            start,
            target: (0..sizes.state()).map(|i| TargetRow::unit(sizes, i, 0.0)).collect(),
        }
    }

    /// The QP of a replan of this problem, linearised where nothing moves.
    pub fn qp(&self) -> Qp {
        let weights = QpWeights { t_f: 100.0, z: KnotVector::repeat(self.model.sizes(), 1.0) };
        Qp::new(&self.problem(), &self.hanging, &self.hanging, &weights)
    }
}

/// CPU time of this thread in `work`, us.
pub fn cpu_us(work: impl FnOnce()) -> f64 {
    let now = || {
        let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: plain system call that writes into `now`.
        let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut now) };
        assert_eq!(status, 0, "CLOCK_THREAD_CPUTIME_ID");
        now.tv_sec as f64 * 1e6 + now.tv_nsec as f64 * 1e-3
    };
    let begin = now();
    work();
    now() - begin
}
