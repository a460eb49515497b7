//! Offline optimisation with the settings of a configuration, and the database built from it.

use crate::interior_point::{Options, Solution, Status, solve};
use crate::problem::{Problem, TorqueConstraint, upright_target};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, GridSettings, StartError};
use upswing_model::{ActuatedVector, NU, NX, State};
use upswing_trajectory::{Database, Entry, N};
use xxhash_rust::xxh3::Xxh3;

/// Durations t_F (s) of the straight lines that the optimisation starts from, one after the other until one
/// converges: the paper's motions last 2 to 3 s.
const GUESSES: [f64; 3] = [2.0, 3.0, 1.5];

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

/// Optimises the swing-up from a start state, from straight lines.
pub fn optimize(config: &Config, start: State) -> Solution {
    let problem = problem(config, start);
    let offline = &config.planner.offline;
    let options = Options {
        tolerance: offline.tolerance,
        max_iterations: offline.max_iterations,
        ..Options::default()
    };
    let mut best: Option<Solution> = None;
    for t_f in GUESSES {
        let solution = solve(&problem, &problem.straight_line(t_f), &options);
        if solution.status == Status::Solved {
            return solution;
        }
        if best.as_ref().is_none_or(|b| solution.violation < b.violation) {
            best = Some(solution);
        }
    }
    // GUESSES is not empty.
    best.unwrap_or_else(|| solve(&problem, &problem.straight_line(1.0), &options))
}

/// Poses of the arm of a grid, rad: the product of its axes, the last axis fastest.
pub fn grid_poses(grid: &GridSettings) -> Vec<[f64; NU]> {
    let mut poses = vec![[0.0; NU]];
    for axis in &grid.axes {
        poses = poses
            .iter()
            .flat_map(|pose| {
                (0..axis.points).map(move |p| {
                    let mut pose = *pose;
                    pose[axis.joint] = axis.angle(p);
                    pose
                })
            })
            .collect();
    }
    poses
}

/// What became of one pose of the grid.
#[derive(Clone, Debug)]
pub enum GridPoint {
    /// Solved.
    Solved(Box<Entry>),
    /// Not a start; left out as the grid's rule says.
    Rejected(StartError),
    /// The optimisation failed.
    Failed {
        /// The pose, rad.
        pose: [f64; NU],
        /// The last iterate.
        solution: Box<Solution>,
    },
    /// The build was stopped before this pose.
    Skipped,
}

/// Builds the database of the settings' grid on all cores. `progress` is called after each pose; raising `stop`
/// ends the build after the poses under way.
pub fn build(config: &Config, stop: &AtomicBool, progress: impl Fn() + Sync) -> Vec<GridPoint> {
    let grid = &config.planner.grid;
    grid_poses(grid)
        .par_iter()
        .map(|pose| {
            if stop.load(Ordering::Acquire) {
                return GridPoint::Skipped;
            }
            let point = match config.start_state(pose, grid.start) {
                Err(e) => GridPoint::Rejected(e),
                Ok(start) => {
                    let solution = optimize(config, start);
                    if solution.status == Status::Solved {
                        let Solution { cost, trajectory, .. } = solution;
                        GridPoint::Solved(Box::new(Entry { cost, trajectory }))
                    } else {
                        GridPoint::Failed { pose: *pose, solution: Box::new(solution) }
                    }
                }
            };
            progress();
            point
        })
        .collect()
}

/// The database of the solved points.
pub fn database(config: &Config, points: Vec<GridPoint>) -> Database {
    let entries = points
        .into_iter()
        .filter_map(|p| match p {
            GridPoint::Solved(entry) => Some(*entry),
            _ => None,
        })
        .collect();
    Database { model: config.model.fingerprint(), problem: problem_fingerprint(config), entries }
}
