//! From hanging rest each shipped system with a table of public optima finds its swing-up or move without a guess of its own, at the
//! duration that IPOPT found for an independent model; a weak motor on a short track needs several swings, and they are found.

use std::time::Instant;
use upswing_model::{ActuatedVector, JointKind, JointVector, Model, State, Workspace};
use upswing_ocp::interior_point::{NlpOptions, NlpSolution, NlpStatus};
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::multistart::{self, Search};
use upswing_ocp::problem::{Problem, TorqueConstraint};

/// A motion of a system from rest to rest, and its limits as in its settings.
struct System {
    /// Folder in `config/systems`.
    name: &'static str,
    /// Shares of the limits that a plan may use: actuated and unactuated velocities, torques.
    usage: (f64, f64, f64),
    /// Start, deg or m; joints without an entry start at 0.
    start: &'static [(&'static str, f64)],
    /// Target, deg or m; all joints.
    target: &'static [(&'static str, f64)],
}

const CART_POLE: System = System {
    name: "cart-pole",
    usage: (0.8, 0.9, 0.6),
    start: &[],
    target: &[("cart", 0.0), ("pole", 180.0)],
};
const CART_DOUBLE: System = System {
    name: "cart-double",
    usage: (0.9, 0.9, 0.8),
    start: &[],
    target: &[("cart", 0.0), ("pole_1", 180.0), ("pole_2", 0.0)],
};
const CART_TRIPLE: System = System {
    name: "cart-triple",
    usage: (0.9, 0.9, 0.8),
    start: &[],
    target: &[("cart", 0.0), ("pole_1", 180.0), ("pole_2", 0.0), ("pole_3", 0.0)],
};
const XY_SPHERICAL: System = System {
    name: "xy-spherical",
    usage: (0.9, 0.9, 0.8),
    start: &[("slide_x", 0.2), ("slide_y", 0.2)],
    target: &[("slide_x", 0.0), ("slide_y", 0.0), ("pendulum_1", 180.0), ("pendulum_2", 0.0)],
};
const FURUTA: System = System {
    name: "furuta",
    usage: (0.9, 0.9, 0.8),
    start: &[],
    target: &[("arm", 0.0), ("pendulum", 180.0)],
};
const ACROBOT: System = System {
    name: "acrobot",
    usage: (0.9, 0.9, 0.85),
    start: &[],
    target: &[("shoulder", 180.0), ("elbow", 0.0)],
};
const PENDUBOT: System = System { name: "pendubot", ..ACROBOT };
const CRANE: System = System {
    name: "gantry-crane",
    usage: (0.9, 0.9, 0.8),
    start: &[("bridge", -1.8), ("trolley", -0.8), ("hoist", 1.4)],
    target: &[("bridge", 1.8), ("trolley", 0.8), ("hoist", 0.8), ("sway_x", 0.0), ("sway_y", 0.0)],
};

impl System {
    fn model(&self) -> Model {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/systems");
        let text = std::fs::read_to_string(format!("{folder}/{}/robot.urdf", self.name)).expect("a URDF");
        Model::from_urdf(&text).unwrap_or_else(|e| panic!("{}: {e}", self.name))
    }

    /// The problem with N = 60, as in the table, and little weight on the input.
    fn problem<'a>(&self, model: &'a Model) -> Problem<'a> {
        /// Of the time, what the inputs cost at their highest.
        const INPUT_SHARE: f64 = 5e-4;
        let sizes = model.sizes();
        let coordinate = |name: &str| model.coordinate(name).expect("a joint");
        let mut limits = *model.rated_limits();
        for i in 0..sizes.joints() {
            // Two turns; the URDF has no range.
            if model.joint_kind(i) == JointKind::Continuous {
                (limits.q_min[i], limits.q_max[i]) = (-std::f64::consts::TAU, std::f64::consts::TAU);
            }
            limits.qd_max[i] *= if i < sizes.actuated() { self.usage.0 } else { self.usage.1 };
        }
        limits.tau_max *= self.usage.2;
        let mut start = State::zeros(sizes);
        for (name, value) in self.start {
            start[coordinate(name)] = model.joint_kind(coordinate(name)).position(*value);
        }
        let mut work = Workspace::default();
        model.hybrid_dynamics(&start, &ActuatedVector::zeros(sizes), &mut work);
        let inertia = model.reduced_inertia(&mut work);
        let highest: f64 = (0..sizes.actuated()).map(|i| (limits.tau_max[i] / inertia[(i, i)]).powi(2)).sum();
        let row = |(name, value): &(&str, f64)| {
            TargetRow::unit(sizes, coordinate(name), model.joint_kind(coordinate(name)).position(*value))
        };
        let at_rest = (sizes.joints()..sizes.state()).map(|i| TargetRow::unit(sizes, i, 0.0));
        Problem {
            model,
            limits,
            intervals: 60,
            narrower: Vec::new(),
            torque: TorqueConstraint::Exact,
            input_weight: 2.0 * INPUT_SHARE / highest,
            t_f: (0.3, 20.0),
            start,
            target: self.target.iter().map(row).chain(at_rest).collect(),
        }
    }
}

fn solve(name: &str, problem: &Problem<'_>, search: Search) -> NlpSolution {
    let options = NlpOptions { tolerance: 1e-8, max_iterations: 500, time_budget: None, cancelled: None };
    let begin = Instant::now();
    let solution = multistart::solve(problem, search, &[], &options);
    let time = begin.elapsed();
    let t_f = solution.trajectory.t_f;
    let swings = half_swings(&solution);
    println!(
        "{name}, {search:?}: t_F = {t_f:.4} s, {swings} half swings, {time:.1?}, {} iterations",
        solution.iterations
    );
    assert_eq!(solution.status, NlpStatus::Solved, "{name}");
    assert!(solution.trajectory.defect(problem.model) < 1e-7, "{name}");
    for row in &problem.target {
        assert!(row.residual(solution.trajectory.end()).abs() < 1e-7, "{name}");
    }
    solution
}

/// How often the first unactuated joint moves in one direction and then in the other, counted by changes of sign of its velocity.
fn half_swings(solution: &NlpSolution) -> usize {
    let speeds: Vec<f64> = solution.trajectory.x.iter().map(|x| x.qd_u()[0]).collect();
    let largest = speeds.iter().fold(0.0, |largest: f64, speed| largest.max(speed.abs()));
    let moving: Vec<f64> = speeds.into_iter().filter(|speed| speed.abs() > 0.02 * largest).collect();
    1 + moving.windows(2).filter(|pair| pair[0] * pair[1] < 0.0).count()
}

/// The first guess that converges gives a motion; the best one is at most 0.1 % and 1 ms, the rounding of the table, longer than `t_f`.
fn assert_found(system: &System, t_f: f64) {
    let model = system.model();
    let problem = system.problem(&model);
    solve(system.name, &problem, Search::First);
    solve(system.name, &problem, Search::Quick);
    let best = solve(system.name, &problem, Search::Best);
    let found = best.trajectory.t_f;
    assert!(found <= 1.001 * t_f + 1e-3, "{}: {found} s, known {t_f} s", system.name);
}

#[test]
fn cart_pole() {
    assert_found(&CART_POLE, 1.63);
}

#[test]
fn double_pendulum_on_a_cart() {
    assert_found(&CART_DOUBLE, 1.687);
}

#[test]
fn triple_pendulum_on_a_cart() {
    assert_found(&CART_TRIPLE, 1.732);
}

#[test]
fn spherical_pendulum_on_two_slides() {
    assert_found(&XY_SPHERICAL, 1.108);
}

#[test]
fn rotary_pendulum() {
    assert_found(&FURUTA, 0.550);
}

#[test]
fn acrobot() {
    assert_found(&ACROBOT, 1.065);
}

#[test]
fn pendubot() {
    assert_found(&PENDUBOT, 0.748);
}

#[test]
fn gantry_crane() {
    assert_found(&CRANE, 4.161);
}

/// A cart-pole with this force and this range of the cart to both sides swings up with so many swings, there and back.
fn assert_swings(force: f64, range: f64, swings: usize) {
    let model = CART_POLE.model();
    let mut problem = Problem { intervals: 100, ..CART_POLE.problem(&model) };
    problem.limits.tau_max[0] = force;
    (problem.limits.q_min[0], problem.limits.q_max[0]) = (-range, range);
    let name = format!("{force} N, {range} m");
    for search in [Search::First, Search::Best] {
        assert_eq!(half_swings(&solve(&name, &problem, search)).div_ceil(2), swings);
    }
}

#[test]
fn a_weak_cart_pole_needs_three_swings() {
    assert_swings(2.5, 0.15, 3);
}

#[test]
fn a_weak_cart_pole_on_a_short_track_needs_five_swings() {
    assert_swings(2.5, 0.07, 5);
}

#[test]
fn results_are_the_same_in_each_run() {
    let model = CART_DOUBLE.model();
    let problem = CART_DOUBLE.problem(&model);
    let [one, other] = [1, 2].map(|_| solve(CART_DOUBLE.name, &problem, Search::Best));
    assert_eq!(one.trajectory, other.trajectory);
}

#[test]
fn guesses_begin_at_the_start_and_end_at_the_target() {
    let model = CRANE.model();
    let problem = CRANE.problem(&model);
    let sizes = problem.sizes();
    let swing = upswing_ocp::guess::Swing {
        half_swings: 2.0,
        duration: 4.0,
        waves: JointVector::repeat(sizes, 0.1),
        half_waves: JointVector::repeat(sizes, 2.0),
    };
    let guess = problem.swing(&swing);
    assert_eq!(*guess.start(), problem.start);
    for row in &problem.target[..sizes.joints()] {
        assert!(row.residual(guess.end()).abs() < 1e-12);
    }
    // Velocities and inputs are the derivatives of the positions and velocities.
    for k in 1..problem.intervals - 1 {
        let (before, after) = (guess.x[k], guess.x[k + 1]);
        let speed = (after.q() - before.q()) * (1.0 / guess.h());
        assert!(((before.qd() + after.qd()) * 0.5 - speed).amax() < 1e-2);
        let input = (after.qd_a() - before.qd_a()) * (1.0 / guess.h());
        assert!(((guess.u[k] + guess.u[k + 1]) * 0.5 - input).amax() < 2e-2);
    }
}
