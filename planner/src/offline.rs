//! Offline optimisation (6), (8), (9)/(11) with the settings of a configuration.

use crate::interior_point::{Options, Solution, Status, solve};
use crate::problem::{Problem, TorqueConstraint, upright_target};
use upswing_config::Config;
use upswing_model::{ActuatedVector, NU, NX, State};
use upswing_trajectory::{N, Trajectory};
use xxhash_rust::xxh3::Xxh3;

/// Half waves (joint counted from 0, rad) on the straight line of 1.8 s from which an optimisation begins. A straight
/// line itself lies on the symmetric ridge between optima: from it, 4 of the 152 starts of the paper's grid end more than
/// 2 % above the best known cost, and it takes half as many iterations again.
const BENDS: [&[(usize, f64)]; 2] = [&[(4, -0.4), (6, -0.4)], &[(0, 0.4), (2, 0.4), (4, -0.4), (6, -0.4)]];
/// Duration of the bent lines, s.
const BENT_DURATION: f64 = 1.8;
/// Durations of the straight lines that are tried where no bent one converges, s.
const STRAIGHT_DURATIONS: [f64; 2] = [2.0, 1.5];
/// Barrier parameter for a start from a neighbour's solution.
const WARM_BARRIER: f64 = 1e-3;

/// The problem (6), (8) of a start under the settings' limits and weights.
pub fn problem(config: &Config, start: State) -> Problem<'_> {
    let offline = &config.planner.offline;
    let bound = &config.robot.coriolis_bound;
    Problem {
        model: &config.model,
        limits: config.robot.planning,
        torque: match offline.torque {
            upswing_config::TorqueConstraint::Exact => TorqueConstraint::Exact,
            upswing_config::TorqueConstraint::Paper => TorqueConstraint::WithoutCoriolis {
                lower: ActuatedVector::from(bound.lower),
                upper: ActuatedVector::from(bound.upper),
            },
        },
        input_weight: offline.input_weight,
        t_f: (offline.t_f_min, offline.t_f_max),
        start,
        target: upright_target(config.robot.target.pitch, config.robot.target.q8),
    }
}

/// Identifies everything but the robot that a database depends on: limits, torque constraint, weights, target.
pub fn problem_fingerprint(config: &Config) -> u64 {
    let p = problem(config, State::zeros());
    let mut hash = Xxh3::new();
    let mut put = |v: f64| hash.update(&v.to_le_bytes());
    let l = &p.limits;
    l.q_min.iter().chain(&l.q_max).chain(&l.qd_max).chain(&l.tau_max).for_each(|v| put(*v));
    let (lower, upper) = p.torque.bounds(&l.tau_max);
    lower.iter().chain(&upper).for_each(|v| put(*v));
    put(f64::from(u8::from(p.torque == TorqueConstraint::Exact)));
    [p.input_weight, p.t_f.0, p.t_f.1].into_iter().for_each(&mut put);
    for row in &p.target {
        row.coefficients.iter().for_each(|v| put(*v));
        put(row.value);
    }
    [NX, NU, N].into_iter().for_each(|n| put(n as f64));
    hash.digest()
}

/// How hard to look for the best of several local optima.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// The first guess that converges.
    Once,
    /// All bent lines; the cheapest solution is kept.
    Best,
}

/// Optimises the swing-up from a start state; also from the solution of a `neighbour`, where there is one.
/// A budget of time counts for each guess.
pub fn optimize(
    config: &Config,
    start: State,
    effort: Effort,
    neighbour: Option<&Trajectory>,
    options: &Options<'_>,
) -> Solution {
    let problem = problem(config, start);
    let mut best: Option<Solution> = None;
    let mut attempt = |guess: &Trajectory, options: &Options<'_>| {
        let solution = solve(&problem, guess, options);
        let solved = solution.status == Status::Solved;
        let better = best.as_ref().is_none_or(|b| match (solved, b.status == Status::Solved) {
            (true, true) => solution.cost < b.cost,
            (false, false) => solution.violation < b.violation,
            (this, _) => this,
        });
        if better {
            best = Some(solution);
        }
        solved
    };
    let mut solved = false;
    for bends in BENDS {
        if !solved || effort == Effort::Best {
            solved |= attempt(&problem.bent_line(BENT_DURATION, bends), options);
        }
    }
    if let Some(neighbour) = neighbour {
        solved |= attempt(&problem.shifted(neighbour), &Options { barrier: WARM_BARRIER, ..*options });
    }
    for t_f in STRAIGHT_DURATIONS {
        if !solved {
            solved |= attempt(&problem.straight_line(t_f), options);
        }
    }
    // At least one attempt was made.
    best.unwrap_or_else(|| solve(&problem, &problem.straight_line(STRAIGHT_DURATIONS[0]), options))
}

/// The options of the settings.
pub fn options(config: &Config) -> Options<'static> {
    let offline = &config.planner.offline;
    Options { tolerance: offline.tolerance, max_iterations: offline.max_iterations, ..Options::default() }
}
