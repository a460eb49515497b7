//! Solves the nonlinear program from several initial guesses and keeps the cheapest solution: it has several local optima.

use crate::interior_point::{self, Limit, NlpOptions, NlpSolution, NlpStatus};
use crate::problem::Problem;
use upswing_model::{LimitKind, Workspace};
use upswing_trajectory::Trajectory;

/// Half waves (joint counted from 0, rad) on the lines from which an optimisation begins, near the mean of the optima of
/// the paper's grid. A straight line itself lies on the symmetric ridge between optima: from it, 4 of the 152 starts of
/// that grid end more than 2 % above the best known cost, and it takes three times as many iterations.
const BENDS: [&[(usize, f64)]; 2] =
    [&[(4, -0.75), (6, -0.65)], &[(0, 0.4), (2, 0.4), (4, -0.75), (6, -0.65)]];
/// Duration of the bent lines, s.
const BENT_DURATION: f64 = 2.3;
/// Durations of the straight lines that are tried where no bent one converges, s.
const STRAIGHT_DURATIONS: [f64; 2] = [2.0, 1.5];

/// How hard to look for the best of several local optima.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// The first guess that converges.
    First,
    /// All bent lines; the cheapest solution is kept.
    Best,
}

/// Solves `problem` from the guesses of [`Search`], and from the solution of a `neighbour` where there is one. A budget of
/// time counts for each guess.
pub fn solve(
    problem: &Problem<'_>,
    search: Search,
    neighbour: Option<&Trajectory>,
    options: &NlpOptions<'_>,
) -> NlpSolution {
    let mut best: Option<NlpSolution> = None;
    let mut attempt = |guess: &Trajectory, options: &NlpOptions<'_>| {
        let solution = interior_point::solve(problem, guess, options);
        let solved = solution.status == NlpStatus::Solved;
        let better = best.as_ref().is_none_or(|b| match (solved, b.status == NlpStatus::Solved) {
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
        if !solved || search == Search::Best {
            solved |= attempt(&problem.bent_line(BENT_DURATION, bends), options);
        }
    }
    if let Some(neighbour) = neighbour {
        solved |= attempt(&problem.shifted(neighbour), options);
    }
    for t_f in STRAIGHT_DURATIONS {
        if !solved {
            solved |= attempt(&problem.straight_line(t_f), options);
        }
    }
    // At least one attempt was made.
    best.unwrap_or_else(|| {
        interior_point::solve(problem, &problem.straight_line(STRAIGHT_DURATIONS[0]), options)
    })
}

/// The limit without which a start that has no trajectory would have one: each kind of limit is lifted in turn, those
/// of the pendulum first, which the arm cannot influence at once; what the trajectory then exceeds most is the answer.
pub fn limit_in_the_way(problem: &Problem<'_>, options: &NlpOptions<'_>) -> Option<Limit> {
    /// As good as none.
    const LIFTED: f64 = 100.0;
    let (actuated, joints) = (problem.sizes().actuated(), problem.sizes().joints());
    let (arm, pendulum) = (0..actuated, actuated..joints);
    let both = [LimitKind::Velocity, LimitKind::Position];
    // One joint of the pendulum, then all of it, then the arm.
    let single = both.into_iter().flat_map(|kind| (actuated..joints).rev().map(move |i| (kind, i..i + 1)));
    let whole = both.into_iter().map(|kind| (kind, pendulum.clone()));
    let of_the_arm = [LimitKind::Velocity, LimitKind::Torque, LimitKind::Position].map(|k| (k, arm.clone()));
    single.chain(whole).chain(of_the_arm).find_map(|(kind, joints)| {
        let mut lifted = problem.clone();
        for i in joints.clone() {
            match kind {
                LimitKind::Velocity => lifted.limits.qd_max[i] *= LIFTED,
                LimitKind::Torque => lifted.limits.tau_max[i] *= LIFTED,
                LimitKind::Position => {
                    lifted.limits.q_min[i] *= LIFTED;
                    lifted.limits.q_max[i] *= LIFTED;
                }
            }
        }
        let solution = interior_point::solve(&lifted, &lifted.bent_line(BENT_DURATION, BENDS[0]), options);
        (solution.status == NlpStatus::Solved)
            .then(|| most_exceeded(problem, &solution.trajectory, kind, joints))
            .flatten()
    })
}

/// Where a trajectory exceeds the limits of one kind most, as a share of the range.
fn most_exceeded(
    problem: &Problem<'_>,
    trajectory: &Trajectory,
    kind: LimitKind,
    joints: std::ops::Range<usize>,
) -> Option<Limit> {
    let limits = &problem.limits;
    let mut work = Workspace::default();
    let mut worst = (0.0, None);
    for (k, (x, u)) in trajectory.knots().enumerate() {
        let (_, tau) = problem.knot(x, u, &mut work);
        let (tau_min, tau_max) = problem.torque.bounds(&limits.tau_max);
        for joint in joints.clone() {
            let (value, (lower, upper)) = match kind {
                LimitKind::Position => (x.q()[joint], limits.range(kind, joint)),
                LimitKind::Velocity => (x.qd()[joint], limits.range(kind, joint)),
                LimitKind::Torque => (tau[joint], (tau_min[joint], tau_max[joint])),
            };
            let excess = (lower - value).max(value - upper) / (upper - lower);
            if excess > worst.0 {
                worst = (excess, Some(Limit { kind, joint, time: k as f64 * trajectory.h() }));
            }
        }
    }
    worst.1
}
