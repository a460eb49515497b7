//! Times the stage-wise numerics for chains of several sizes; `bench/stages/run` calls it.
//!
//! For each chain of links that hang from the first joint: one factorisation, one iteration of a QP, and one period of the recursion (23).
//! Sizes that the compiler knows are marked. CPU times of one thread, the sizes in turns, medians: only ratios of one run count.

use std::hint::black_box;
use upswing_model::{ActuatedVector, JointVector, Limits, Model, Sizes, State, Workspace};
use upswing_ocp::kkt::{Factor, Kkt, TargetRow};
use upswing_ocp::lqr::{self, LqrWeights, Recursion};
use upswing_ocp::problem::{Problem, TorqueConstraint};
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus, QpWeights};
use upswing_ocp::slab::KnotVector;
use upswing_trajectory::Trajectory;

/// Joints and actuated joints of the chains, and whether the numerics are compiled for them.
const CHAINS: [(usize, usize, bool); 6] =
    [(2, 1, true), (3, 2, false), (5, 3, false), (9, 7, true), (10, 8, false), (16, 14, false)];
/// Intervals of a trajectory, and its duration, s.
const N: usize = 100;
const DURATION: f64 = 2.0;
/// Period of the recursion (23), s.
const PERIOD: f64 = 125e-6;
/// Turns, and factorisations in each.
const TURNS: usize = 15;
const FACTORISATIONS: usize = 20;

fn main() {
    let chains = CHAINS.map(|(n, actuated, known)| (Chain::new(n, actuated), known));
    let mut times = vec![[const { Vec::new() }; 3]; chains.len()];
    for _ in 0..TURNS {
        for ((chain, _), times) in chains.iter().zip(&mut times) {
            for (times, time) in times.iter_mut().zip(chain.times()) {
                times.push(time);
            }
        }
    }
    println!("joints, actuated   factorisation, us   QP iteration, us   period of (23), us");
    for ((chain, known), mut times) in chains.iter().zip(times) {
        let [factorisation, iteration, period] = times.each_mut().map(|times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        });
        let mark = if *known { "*" } else { " " };
        let (n, actuated) = (chain.model.sizes().joints(), chain.model.sizes().actuated());
        println!("{n:>6}, {actuated:>8} {mark} {factorisation:>18.1} {iteration:>18.1} {period:>20.3}");
    }
    println!("* compiled for these sizes");
}

/// A chain with a motion that it tracks and a QP that it solves.
struct Chain {
    model: Model,
    hanging: Trajectory,
    qp: Qp,
    kkt: Kkt,
}

impl Chain {
    /// `n` links on parallel horizontal axes, the last of them unactuated.
    fn new(n: usize, actuated: usize) -> Self {
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
            x: vec![State::zeros(sizes); N + 1],
            u: vec![ActuatedVector::zeros(sizes); N + 1],
        };
        let mut start = State::zeros(sizes);
        start.q_a_mut()[0] = 0.5;
        let problem = Problem {
            model: &model,
            intervals: N,
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
        };
        let weights = QpWeights { t_f: 100.0, z: KnotVector::repeat(sizes, 1.0) };
        let qp = Qp::new(&problem, &hanging, &hanging, &weights);
        let mut kkt = Kkt::zeros(sizes, N, &qp.target);
        (kkt.h, kkt.t_t, kkt.dynamics) = (qp.h, 1.0, qp.dynamics.clone());
        for k in 0..=N {
            for i in 0..sizes.knot() {
                kkt.hessian.row_mut(k, i)[i] = 1.0;
            }
        }
        Self { model, hanging, qp, kkt }
    }

    /// Times of a factorisation, an iteration of a QP from cold and a period of (23), us.
    fn times(&self) -> [f64; 3] {
        let sizes: Sizes = self.model.sizes();
        let mut factor = Factor::new(sizes, N);
        let mut solver = QpSolver::new(Backend::Structured, sizes, N);
        let weights = LqrWeights { q: State::repeat(sizes, 1.0), q_end: State::repeat(sizes, 1.0), r: 1e-2 };
        let mut work = Workspace::default();
        let factorisation = cpu_us(|| {
            for _ in 0..FACTORISATIONS {
                assert!(black_box(&self.kkt).factor_into(0.0, 0.0, &mut factor));
            }
        });
        let qp = cpu_us(|| assert_eq!(solver.solve(&self.qp, &QpOptions::new(1e-9)), QpStatus::Solved));
        let gains = cpu_us(|| {
            let gains =
                lqr::synthesize(&self.model, &self.hanging, &weights, PERIOD, Recursion::Periods, &mut work);
            assert!(gains.is_ok(), "{gains:?}");
        });
        [
            factorisation / FACTORISATIONS as f64,
            qp / solver.solution().iterations as f64,
            gains * PERIOD / DURATION,
        ]
    }
}

/// CPU time of this thread in `work`, us.
fn cpu_us(work: impl FnOnce()) -> f64 {
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
