//! Both QP back ends solve (16), linearised around many database entries, to the same solution, and report the same QPs as
//! infeasible.

use upswing_config::{Config, PendulumStart};
use upswing_model::{ActuatedVector, LimitKind, State};
use upswing_ocp::qp::{Backend, Bound, Qp, QpOptions, QpSolver, QpStatus};
use upswing_ocp::slab::{KnotParts as _, KnotVector};
use upswing_planner::offline::{problem, qp_weights, target};
use upswing_planner::replan::Planner;
use upswing_trajectory::Trajectory;

/// The QP back ends, `Structured` first.
const BACKENDS: [Backend; 2] = [Backend::Structured, Backend::Clarabel];

/// Options with tight tolerances, so that inputs agree even where a bound is weakly active.
const PRECISE: QpOptions<'_> = QpOptions {
    tolerance: 1e-9,
    complementarity: 1e-16,
    max_iterations: 100,
    deadline: None,
    cancelled: None,
};

/// A QP solver for the entries of a planner.
fn solver(planner: &Planner, backend: Backend) -> QpSolver {
    let entry = &planner.entry(0, 0).expect("an entry").trajectory;
    QpSolver::new(backend, entry.sizes(), entry.intervals())
}

fn planner() -> Planner {
    Planner::new(Config::embedded().expect("embedded settings")).expect("the shipped database fits")
}

/// Random number generator SplitMix64 (Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A random number, uniform in -1..1.
    fn sign(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// The QP for a start at rest that is `offset` (rad) away from the start of an entry.
fn qp_at(planner: &Planner, entry: usize, offset: &[f64; 7]) -> Option<Qp> {
    let reference = &planner.entry(0, entry).expect("an entry").trajectory;
    let q: Vec<f64> = reference.start().q_a().iter().zip(offset).map(|(q, offset)| q + offset).collect();
    let start = planner.config().start_state(&q, PendulumStart::Rest).ok()?;
    Some(qp_from(planner, reference, reference, start))
}

fn qp_from(planner: &Planner, reference: &Trajectory, at: &Trajectory, start: State) -> Qp {
    let target = target(planner.config(), 0, &[]).expect("a target");
    let problem = problem(planner.config(), target, start);
    let weights = qp_weights(&planner.config().planner.replan);
    Qp::new(&problem, reference, at, &weights)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Largest violation of any constraint (rad, rad/s, share of half a torque range), computed from the statement.
fn violation(qp: &Qp, solver: &QpSolver) -> f64 {
    let s = solver.solution();
    let n = qp.x.len();
    let x = |k: usize| s.z.x(k);
    let f = |k: usize| {
        let of_z = qp.dynamics.apply(k, &s.z.knot(k)) * (0.5 * qp.h);
        of_z + qp.dynamics.f.state(k) * (s.t / (2 * n) as f64)
    };
    let mut worst = (x(0) - qp.start).amax().max(s.t - qp.t.1).max(qp.t.0 - s.t);
    for k in 0..n {
        worst = worst.max((x(k + 1) - x(k) - f(k) - f(k + 1) + qp.defects.state(k)).amax());
        let (lower, upper) = &qp.x[k];
        worst = worst.max(largest(&(lower - x(k + 1)))).max(largest(&(x(k + 1) - upper)));
    }
    for (k, (lower, upper)) in qp.torque.bounds.iter().enumerate() {
        let z = s.z.knot(k);
        let row = |i: usize| qp.torque.jacobian.row(k, i).iter().zip(z.iter()).map(|(d, z)| d * z).sum();
        let tau = ActuatedVector::from_fn(lower.sizes(), row);
        let half = (upper - lower) * 0.5;
        worst = worst.max(largest(&(lower - tau).component_div(&half)));
        worst = worst.max(largest(&(tau - upper).component_div(&half)));
    }
    qp.target.iter().map(|row| (row.coefficients.dot(&x(n)) - row.value).abs()).fold(worst, f64::max)
}

/// Largest difference of states (rad, rad/s) and durations (s), and of inputs as they count in the objective: times
/// the root of their weight.
fn difference(qp: &Qp, a: &QpSolver, b: &QpSolver) -> f64 {
    let mut scale = KnotVector::zeros(qp.start.sizes());
    scale.x_mut().fill(1.0);
    scale.u_mut().copy_from_slice(&qp.weight.u(0).map(f64::sqrt));
    let (a, b) = (a.solution(), b.solution());
    let z = (0..=qp.x.len()).map(|k| (a.z.knot(k) - b.z.knot(k)).component_mul(&scale).amax());
    z.fold((a.t - b.t).abs(), f64::max)
}

#[test]
fn on_random_starts_up_to_the_corners_of_a_cell() {
    /// Number of QPs; Clarabel takes nearly all of the time.
    const QPS: usize = 200;
    /// Largest difference. Clarabel's solution of one of these QPs is 1.1e-6 away from ours and does not change with its tolerance; ours changes
    /// by 3e-8 with a tolerance of 1e-11. The others are within 3e-7.
    const DIFFERENCE: f64 = 1.5e-6;
    /// Half spacings of the paper's grid, rad.
    const CELL: [f64; 7] = [0.305, 0.175, 0.0, 0.175, 0.0, 0.349, 0.0];
    let planner = planner();
    let mut random = Random(1);
    let [mut structured, mut clarabel] = BACKENDS.map(|backend| solver(&planner, backend));
    let (mut done, mut active, mut infeasible) = (0, 0, 0);
    while done < QPS {
        let entry = random.next() as usize % planner.entries(0);
        let offset = match done % 4 {
            // A corner of the cell.
            0 => CELL.map(|half| half * random.sign().signum()),
            // Far outside the cell: some of these QPs are infeasible.
            1 => CELL.map(|half| 2.5 * half * random.sign()),
            // Offsets of all seven joints.
            2 => std::array::from_fn(|_| 0.1 * random.sign()),
            _ => CELL.map(|half| half * random.sign()),
        };
        let Some(mut qp) = qp_at(&planner, entry, &offset) else { continue };
        if done % 5 == 4 {
            // The arm moves at full speed.
            let qd_max = planner.config().robot.planning.qd_max.actuated();
            for (qd, max) in qp.start.qd_a_mut().iter_mut().zip(qd_max.iter()) {
                *qd += max * random.sign().signum();
            }
        }
        if done % 10 == 9 {
            // One joint at its position limit moves towards the limit, at a speed that may be too high.
            let joint = [1, 3, 5][random.next() as usize % 3];
            let limits = &planner.config().robot.planning;
            qp.start[joint] =
                limits.q_max[joint] - planner.entry(0, entry).expect("an entry").trajectory.x[0][joint];
            qp.start.qd_mut()[joint] = limits.qd_max[joint] * random.sign().abs();
        }
        let verdicts = [structured.solve(&qp, &PRECISE), clarabel.solve(&qp, &PRECISE)];
        done += 1;
        let name = format!("QP {done}, entry {entry}, offset {offset:?}");
        if matches!(verdicts[0], QpStatus::Infeasible(_)) {
            assert!(matches!(verdicts[1], QpStatus::Infeasible(_)), "{name}: {verdicts:?}");
            infeasible += 1;
            continue;
        }
        assert_eq!(verdicts, [QpStatus::Solved; 2], "{name}");
        for solver in [&structured, &clarabel] {
            let violation = violation(&qp, solver);
            assert!(violation <= 1e-8, "{name}: violation {violation:e}");
        }
        let difference = difference(&qp, &structured, &clarabel);
        assert!(difference <= DIFFERENCE, "{name}: the solutions differ by {difference:e}");
        active += usize::from(touches_a_limit(&qp, &structured));
    }
    println!("{active} of {done} touch a limit, {infeasible} are infeasible");
    assert!(active >= QPS / 2, "only {active} of {done} touch a limit");
    assert!(infeasible >= 5, "only {infeasible} are infeasible");
}

fn touches_a_limit(qp: &Qp, solver: &QpSolver) -> bool {
    let z = &solver.solution().z;
    qp.x.iter().enumerate().any(|(k, (lower, upper))| {
        let x = z.x(k + 1);
        largest(&(lower - x)).max(largest(&(x - upper))) > -1e-6
    })
}

/// The QP around an entry for a start at the upper position limit of `joint`, with speed `fast` (rad/s) towards the limit.
fn towards_its_stop(planner: &Planner, entry: usize, joint: usize, fast: f64) -> Qp {
    let reference = &planner.entry(0, entry).expect("an entry").trajectory;
    let mut start = reference.x[0];
    start[joint] = planner.config().robot.planning.q_max[joint];
    start.qd_mut()[joint] = fast;
    qp_from(planner, reference, reference, start)
}

#[test]
fn infeasible_ones_are_infeasible_for_both() {
    let planner = planner();
    for backend in BACKENDS {
        let mut solver = solver(&planner, backend);
        for entry in [3, 40, 99, 150] {
            for joint in [1, 3, 5] {
                // Twice the limit, which no torque reverses within an interval; a start widens the limits of its problem.
                let fast = 2.0 * planner.config().robot.planning.qd_max[joint];
                let qp = towards_its_stop(&planner, entry, joint, fast);
                let status = solver.solve(&qp, &QpOptions::new(1e-9));
                let QpStatus::Infeasible(conflict) = status else {
                    panic!("{backend:?}, entry {entry}, joint {joint}: {status:?}")
                };
                assert_eq!(conflict.is_some(), backend == Backend::Structured, "{backend:?}");
            }
        }
        // A duration that no motion within the limits has, and a target outside its bounds.
        let mut qp = qp_at(&planner, 40, &[0.0; 7]).expect("an entry starts at rest");
        qp.t = (50.0, 60.0);
        assert!(
            matches!(solver.solve(&qp, &QpOptions::new(1e-9)), QpStatus::Infeasible(_)),
            "{backend:?}: duration"
        );
        let mut qp = qp_at(&planner, 40, &[0.0; 7]).expect("an entry starts at rest");
        qp.target[4].value += 10.0;
        assert!(
            matches!(solver.solve(&qp, &QpOptions::new(1e-9)), QpStatus::Infeasible(_)),
            "{backend:?}: target"
        );
    }
}

#[test]
fn softened_limits_yield_where_hard_ones_contradict() {
    let mut config = Config::embedded().expect("embedded settings");
    // With a larger weight Clarabel comes no closer than 1e-5 to 4e-4 to the solution of a soft program.
    config.planner.replan.weight_t_f = 0.3;
    let planner = Planner::new(config).expect("the shipped database fits");
    let limits = &planner.config().robot.planning;
    for joint in [1, 3, 5] {
        let mut qp = towards_its_stop(&planner, 40, joint, limits.qd_max[joint]);
        for compliance in [1e-2, 1e-4] {
            qp.compliance = compliance;
            let [mut structured, mut clarabel] = BACKENDS.map(|backend| solver(&planner, backend));
            let verdicts = [structured.solve(&qp, &PRECISE), clarabel.solve(&qp, &PRECISE)];
            assert_eq!(verdicts, [QpStatus::Solved; 2], "joint {joint}, compliance {compliance:e}");
            let difference = difference(&qp, &structured, &clarabel);
            assert!(difference <= 1e-6, "joint {joint}, compliance {compliance:e}: {difference:e}");
            let excess = violation(&qp, &structured);
            assert!(excess > 1e-4, "joint {joint}, compliance {compliance:e}: exceeded by {excess:e} only");
        }
    }
    // If the constraints are consistent, soft bounds of small compliance give the solution of hard bounds.
    let mut qp = qp_at(&planner, 77, &[0.05; 7]).expect("a start at rest");
    let [mut hard, mut soft] = [(); 2].map(|()| solver(&planner, Backend::Structured));
    assert_eq!(hard.solve(&qp, &PRECISE), QpStatus::Solved);
    qp.compliance = 1e-9;
    assert_eq!(soft.solve(&qp, &PRECISE), QpStatus::Solved);
    let difference = difference(&qp, &hard, &soft);
    assert!(difference <= 1e-6, "{difference:e}");
}

#[test]
fn a_limit_that_jumps_away_is_named() {
    let planner = planner();
    for (joint, knot) in [(0, 1), (3, 40), (5, 90)] {
        // Contradicting bounds: at least 0.5 rad at the knot, at most 0 one interval later.
        let mut qp = qp_at(&planner, 40, &[0.0; 7]).expect("an entry starts at rest");
        qp.x[knot - 1].0[joint] = 0.5;
        qp.x[knot - 1].1[joint] = 1.0;
        qp.x[knot].1[joint] = 0.0;
        let status = solver(&planner, Backend::Structured).solve(&qp, &QpOptions::new(1e-9));
        let QpStatus::Infeasible(Some(conflict)) = status else { panic!("joint {joint}: {status:?}") };
        assert_eq!(conflict.bound, Bound::Joint(LimitKind::Position, joint), "{conflict}");
        assert!(conflict.knot == knot || conflict.knot == knot + 1, "{conflict}");
    }
}

#[test]
fn a_warm_start_ends_where_a_cold_one_does() {
    let planner = planner();
    for (entry, offset) in [(10, 0.05), (40, -0.1), (77, 0.15)] {
        let reference = &planner.entry(0, entry).expect("an entry").trajectory;
        let q_a = reference.start().q_a();
        let q: Vec<f64> = q_a.iter().enumerate().map(|(i, q)| q + offset * [1.0, 0.5, 0.0][i % 3]).collect();
        let start = planner.config().start_state(&q, PendulumStart::Rest).expect("a start at rest");
        let mut at = reference.clone();
        let mut warm = solver(&planner, Backend::Structured);
        for iteration in 0..4 {
            let qp = qp_from(&planner, reference, &at, start);
            let status =
                if iteration == 0 { warm.solve(&qp, &PRECISE) } else { warm.solve_again(&qp, &PRECISE) };
            let mut cold = solver(&planner, Backend::Structured);
            assert_eq!(
                [status, cold.solve(&qp, &PRECISE)],
                [QpStatus::Solved; 2],
                "entry {entry}, QP {iteration}"
            );
            let difference = difference(&qp, &warm, &cold);
            assert!(difference <= 1e-6, "entry {entry}, QP {iteration}: {difference:e}");
            at.t_f += warm.solution().t;
            for (k, (x, u)) in at.x.iter_mut().zip(&mut at.u).enumerate() {
                *x += warm.solution().z.x(k);
                *u += warm.solution().z.u(k);
            }
        }
    }
}

#[test]
fn equal_qps_give_equal_bits_whatever_was_solved_before() {
    let planner = planner();
    // Entries whose start remains within the limits when it is moved.
    let mut qps = (0..planner.entries(0)).filter_map(|entry| qp_at(&planner, entry, &[0.02; 7]));
    let (first, other) = (qps.nth(20).expect("one"), qps.nth(20).expect("another"));
    let options = QpOptions::new(1e-9);
    let mut fresh = solver(&planner, Backend::Structured);
    assert_eq!(fresh.solve(&first, &options), QpStatus::Solved);
    let mut used = solver(&planner, Backend::Structured);
    assert_eq!(used.solve(&other, &options), QpStatus::Solved);
    assert_eq!(used.solve(&first, &options), QpStatus::Solved);
    let bits = |s: &QpSolver| -> Vec<u64> {
        let z = &s.solution().z;
        (0..z.panels()).flat_map(|k| z.vector(k)).map(|v| v.to_bits()).collect()
    };
    assert_eq!(bits(&fresh), bits(&used));
    assert_eq!(bits(&fresh).len(), (first.x.len() + 1) * first.start.sizes().knot());
}

#[test]
fn a_deadline_in_the_past_leaves_the_first_iterate() {
    let planner = planner();
    let entries = 0..planner.entries(0);
    let qp = entries.filter_map(|entry| qp_at(&planner, entry, &[0.02; 7])).next().expect("a start at rest");
    for backend in BACKENDS {
        let mut solver = solver(&planner, backend);
        let options = QpOptions { deadline: Some(std::time::Instant::now()), ..QpOptions::new(1e-9) };
        let solved = QpOptions { deadline: None, ..options };
        assert_eq!(solver.solve(&qp, &solved), QpStatus::Solved, "{backend:?}");
        assert_eq!(solver.solve(&qp, &options), QpStatus::Deadline, "{backend:?}");
        assert_eq!(solver.solution().iterations, 0);
        assert!(
            (1..=qp.x.len()).all(|k| solver.solution().z.knot(k).amax() == 0.0),
            "{backend:?}: no step yet"
        );
    }
}

#[test]
fn what_is_less_accurate_than_asked_for_is_not_solved() {
    let planner = planner();
    let entries = 0..planner.entries(0);
    let qp = entries.filter_map(|entry| qp_at(&planner, entry, &[0.02; 7])).next().expect("a start at rest");
    // No solver meets this tolerance: Clarabel reports `SolverStatus::AlmostSolved`.
    let mut solver = solver(&planner, Backend::Clarabel);
    let status = solver.solve(&qp, &QpOptions::new(1e-20));
    assert!(matches!(status, QpStatus::Stalled(_)), "{status:?}");
}

#[test]
fn the_last_iterate_of_a_stopped_solve_is_the_best() {
    let planner = planner();
    let fast = |joint: usize| planner.config().robot.planning.qd_max[joint];
    let hopeless = [(3, 1), (3, 5), (40, 3), (99, 1), (99, 5)]
        .map(|(entry, joint)| towards_its_stop(&planner, entry, joint, fast(joint)));
    let solvable = qp_at(&planner, 40, &[0.05; 7]).expect("a start at rest");
    for qp in hopeless.iter().chain([&solvable]) {
        let mut solver = solver(&planner, Backend::Structured);
        let mut before = f64::INFINITY;
        for max_iterations in 0..12 {
            let status = solver.solve(qp, &QpOptions { max_iterations, ..QpOptions::new(1e-9) });
            let violation = violation(qp, &solver);
            assert!(violation <= before + 1e-9, "{status:?} after {max_iterations}: {violation} > {before}");
            before = violation;
        }
    }
}
