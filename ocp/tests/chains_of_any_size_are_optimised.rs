//! Motions of chains of several sizes, with prismatic joints and unactuated joints at the base or at the tip, and with several numbers of
//! intervals: the optimisation finds them, both QP back ends adapt them to another start, and the gains stabilise their ends.

use upswing_model::{ActuatedVector, JointVector, Limits, Linearization, Model, Sizes, State, Workspace};
use upswing_ocp::interior_point::{Multipliers, NlpOptions, NlpStatus};
use upswing_ocp::kkt::{TargetRow, check_target_rows};
use upswing_ocp::lqr::{LqrWeights, Recursion, synthesize};
use upswing_ocp::multistart::{self, Search};
use upswing_ocp::problem::{Problem, TorqueConstraint};
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus, QpWeights};
use upswing_ocp::slab::KnotVector;
use upswing_trajectory::Trajectory;

/// A link of a chain: type and axis of its joint, its place on the body before it, and whether it has a motor.
type Link = (&'static str, &'static str, &'static str, bool);

/// A slide of 1 kg.
const CART: Link = ("prismatic", "1 0 0", "0 0 0", true);
/// A rod of 0.6 m and 0.2 kg that hangs at q = 0 and swings in the plane of the slide.
const ROD: Link = ("continuous", "0 1 0", "0 0 0", false);

fn chain(links: &[Link]) -> Model {
    let mut text = "<robot name=\"chain\"><link name=\"body0\"/>".to_owned();
    for (i, (kind, axis, place, has_motor)) in links.iter().enumerate() {
        let (com, mass, inertia) =
            if *kind == "prismatic" { ("0 0 0", 1.0, 0.01) } else { ("0 0 -0.3", 0.2, 0.006) };
        let effort = if *has_motor { 100 } else { 0 };
        text += &format!(
            "<link name=\"body{next}\"><inertial><origin xyz=\"{com}\"/><mass value=\"{mass}\"/>
             <inertia ixx=\"{inertia}\" ixy=\"0\" ixz=\"0\" iyy=\"{inertia}\" iyz=\"0\" izz=\"{inertia}\"/></inertial></link>
             <joint name=\"joint{next}\" type=\"{kind}\"><parent link=\"body{i}\"/><child link=\"body{next}\"/>
             <origin xyz=\"{place}\"/><axis xyz=\"{axis}\"/>
             <limit lower=\"-9\" upper=\"9\" velocity=\"9\" effort=\"{effort}\"/></joint>",
            next = i + 1
        );
    }
    Model::from_urdf(&(text + "</robot>")).unwrap_or_else(|e| panic!("{e}"))
}

/// A motion from rest at q = 0 to rest at the target.
struct Motion {
    model: Model,
    /// Rows over the positions (sorted), and their values.
    target: Vec<(Vec<f64>, f64)>,
    /// Largest position, speed and torque.
    limits: (f64, f64, f64),
    intervals: usize,
}

impl Motion {
    fn sizes(&self) -> Sizes {
        self.model.sizes()
    }

    fn problem(&self) -> Problem<'_> {
        let sizes = self.sizes();
        let (q_max, qd_max, tau_max) = self.limits;
        let velocities = sizes.joints()..sizes.state();
        let mut target: Vec<TargetRow> = velocities.map(|i| TargetRow::unit(sizes, i, 0.0)).collect();
        for (coefficients, value) in &self.target {
            let q = JointVector::from_slice(sizes, coefficients).expect("a coefficient per joint");
            let coefficients = State::new(&q, &JointVector::zeros(sizes));
            target.push(TargetRow { coefficients, value: *value });
        }
        assert_eq!(check_target_rows(&target), Ok(()));
        Problem {
            model: &self.model,
            limits: Limits {
                q_min: JointVector::repeat(sizes, -q_max),
                q_max: JointVector::repeat(sizes, q_max),
                qd_max: JointVector::repeat(sizes, qd_max),
                tau_max: ActuatedVector::repeat(sizes, tau_max),
            },
            intervals: self.intervals,
            narrower: Vec::new(),
            torque: TorqueConstraint::Exact,
            input_weight: 0.01,
            t_f: (0.3, 8.0),
            start: State::zeros(sizes),
            target,
        }
    }

    /// An optimum, which meets the statement of the problem.
    fn optimum(&self) -> Trajectory {
        let problem = self.problem();
        let options = NlpOptions { tolerance: 1e-9, max_iterations: 500, time_budget: None, cancelled: None };
        let solution = multistart::solve(&problem, Search::First, &[], &options);
        let trajectory = solution.trajectory;
        println!("{:?}: {} iterations, {} s", self.sizes(), solution.iterations, trajectory.t_f);
        assert_eq!(solution.status, NlpStatus::Solved);
        let mut work = Workspace::default();
        assert_eq!(trajectory.intervals(), self.intervals);
        assert!(trajectory.defect(&self.model) < 1e-8);
        assert_eq!(*trajectory.start(), problem.start);
        for row in &problem.target {
            assert!(row.residual(trajectory.end()).abs() < 1e-8, "{row:?}");
        }
        let (q_max, qd_max, tau_max) = self.limits;
        for (x, u) in trajectory.knots() {
            assert!(x.q().amax() <= q_max && x.qd().amax() <= qd_max, "{x:?}");
            let tau = self.model.torque(x, u, &mut work);
            assert!(tau.amax() <= tau_max + 1e-6, "{tau:?}");
        }
        self.assert_stationary(&trajectory, &solution.multipliers);
        trajectory
    }

    /// The Lagrangian of [`Multipliers`] at a trajectory.
    fn lagrangian(&self, trajectory: &Trajectory, multipliers: &Multipliers) -> f64 {
        let problem = self.problem();
        let mut work = Workspace::default();
        let Trajectory { t_f, x, u } = trajectory;
        let Multipliers { defects, target, x: of_x, torque, t_f: of_t_f } = multipliers;
        let (f, h) = (trajectory.f(&self.model), trajectory.h());
        let mut sum = trajectory.cost(problem.input_weight) + of_t_f * t_f;
        for (k, lambda) in defects.iter().enumerate() {
            sum += lambda.dot(&(x[k + 1] - x[k] - (f[k] + f[k + 1]) * (0.5 * h)));
            sum += of_x[k].dot(&x[k + 1]);
        }
        for (row, nu) in problem.target.iter().zip(target) {
            sum += nu * row.residual(trajectory.end());
        }
        for (k, pull) in torque.iter().enumerate() {
            sum += pull.dot(&self.model.torque(&x[k], &u[k], &mut work));
        }
        sum
    }

    /// The derivatives of the Lagrangian, by central differences, are zero, and the signs of the multipliers say which limit is reached.
    fn assert_stationary(&self, trajectory: &Trajectory, multipliers: &Multipliers) {
        const STEP: f64 = 1e-5;
        // Third derivatives times STEP^2, and rounding of L / STEP.
        const ALLOWED: f64 = 1e-7;
        let slope = |change: &dyn Fn(&mut Trajectory, f64)| {
            let at = |step: f64| {
                let mut moved = trajectory.clone();
                change(&mut moved, step);
                self.lagrangian(&moved, multipliers)
            };
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        };
        let sizes = self.sizes();
        let mut slopes = vec![slope(&|moved, step| moved.t_f += step)];
        for k in 0..=self.intervals {
            slopes.extend((0..sizes.actuated()).map(|i| slope(&|moved, step| moved.u[k][i] += step)));
            if k > 0 {
                slopes.extend((0..sizes.state()).map(|i| slope(&|moved, step| moved.x[k][i] += step)));
            }
        }
        let worst = slopes.iter().fold(0.0_f64, |worst, slope| worst.max(slope.abs()));
        println!("{sizes:?}: slope {worst:.1e}");
        assert!(worst < ALLOWED, "{worst:e}");
        let (mut work, tau_max) = (Workspace::default(), self.limits.2);
        for ((x, u), pull) in trajectory.knots().zip(&multipliers.torque) {
            let tau = self.model.torque(x, u, &mut work);
            // A limit that is not reached has none.
            assert!(
                pull.iter()
                    .zip(tau.iter())
                    .all(|(pull, tau)| (tau_max - tau * pull.signum()) * pull.abs() < 1e-6)
            );
        }
    }

    /// Both back ends solve one QP around the trajectory, from a start that is moved, to the same solution.
    fn assert_adaptable(&self, trajectory: &Trajectory) {
        let sizes = self.sizes();
        let mut problem = self.problem();
        problem.start.q_a_mut().iter_mut().for_each(|q| *q += 0.02);
        let weights = QpWeights { t_f: 1.0, z: KnotVector::repeat(sizes, 0.1) };
        let qp = Qp::new(&problem, trajectory, trajectory, &weights);
        let options = QpOptions { complementarity: 1e-16, ..QpOptions::new(1e-9) };
        let [structured, clarabel] = [Backend::Structured, Backend::Clarabel].map(|backend| {
            let mut solver = QpSolver::new(backend, sizes, self.intervals);
            assert_eq!(solver.solve(&qp, &options), QpStatus::Solved, "{backend:?}");
            solver.solution().clone()
        });
        assert!((structured.t - clarabel.t).abs() < 1e-6);
        for k in 0..=self.intervals {
            let difference = (structured.z.knot(k) - clarabel.z.knot(k)).amax();
            assert!(difference < 1e-5, "knot {k}: {difference:e}");
        }
    }

    /// The gain that holds the end of the trajectory stabilises the linearised dynamics there.
    fn assert_stabilisable(&self, trajectory: &Trajectory) {
        let (sizes, mut work) = (self.sizes(), Workspace::default());
        let ones = State::repeat(sizes, 1.0);
        let weights = LqrWeights { q: ones, q_end: ones, r: 0.1 };
        let gains = synthesize(&self.model, trajectory, &weights, 1e-3, Recursion::Extrapolated, &mut work)
            .expect("stabilisable");
        let mut at_end = Linearization::new(sizes);
        self.model.linearize(trajectory.end(), &ActuatedVector::zeros(sizes), &mut work, &mut at_end);
        let gain = gains.end();
        let k = nalgebra::DMatrix::from_row_slice(sizes.actuated(), sizes.state(), gain.as_slice());
        let eigenvalues = (at_end.a() + at_end.b() * k).complex_eigenvalues();
        assert!(eigenvalues.iter().all(|e| e.re < -0.05), "{eigenvalues}");
    }

    fn check(&self) -> Trajectory {
        let trajectory = self.optimum();
        self.assert_adaptable(&trajectory);
        self.assert_stabilisable(&trajectory);
        trajectory
    }
}

/// Row `i` of the identity.
fn unit(n: usize, i: usize) -> Vec<f64> {
    (0..n).map(|j| f64::from(u8::from(i == j))).collect()
}

#[test]
fn a_cart_swings_its_pendulum_up_whatever_the_number_of_intervals() {
    let t_f = [60, 150].map(|intervals| {
        let motion = Motion {
            model: chain(&[CART, ROD]),
            target: vec![(unit(2, 0), 0.0), (unit(2, 1), std::f64::consts::PI)],
            limits: (4.0, 8.0, 15.0),
            intervals,
        };
        motion.check().t_f
    });
    assert!((t_f[0] / t_f[1] - 1.0).abs() < 0.02, "{t_f:?} s");
}

#[test]
fn an_arm_without_a_motor_at_its_base_stands_up() {
    let elbow = ("continuous", "0 1 0", "0 0 -0.6", true);
    let motion = Motion {
        model: chain(&[ROD, elbow]),
        // The elbow, which has the motor, comes first in sorted vectors.
        target: vec![(unit(2, 0), 0.0), (unit(2, 1), std::f64::consts::PI)],
        limits: (6.0, 12.0, 10.0),
        intervals: 80,
    };
    motion.check();
}

#[test]
fn a_bridge_crane_reaches_a_target_whose_rows_are_not_orthogonal() {
    let trolley = ("prismatic", "0 1 0", "0 0 0", true);
    let across = ("continuous", "1 0 0", "0 0 0", false);
    let motion = Motion {
        model: chain(&[CART, trolley, ROD, across]),
        // Bridge at 1 m, trolley at 0.5 m.
        target: vec![
            (vec![1.0, 2.0, 0.0, 0.0], 2.0),
            (vec![1.0, -1.0, 0.3, 0.0], 0.5),
            (unit(4, 2), 0.0),
            (vec![0.0, 0.0, 0.0, 20.0], 0.0),
        ],
        limits: (3.0, 4.0, 20.0),
        intervals: 50,
    };
    motion.check();
}

#[test]
fn a_cart_moves_a_pendulum_of_three_rods() {
    let rod = ("continuous", "0 1 0", "0 0 -0.6", false);
    let motion = Motion {
        model: chain(&[CART, ROD, rod, rod]),
        target: (0..4).map(|i| (unit(4, i), if i == 0 { 1.0 } else { 0.0 })).collect(),
        limits: (3.0, 6.0, 20.0),
        intervals: 100,
    };
    motion.check();
}
