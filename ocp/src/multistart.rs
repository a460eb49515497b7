//! Solves the nonlinear program from several initial guesses and keeps the cheapest solution: it has several local optima.
//!
//! The number of swings is not known before: a weak motor or a short track needs several. Guesses with more and more half swings are tried
//! until one converges and the next one is not cheaper, then guesses with seeded waves on all joints, until the cheapest solution is
//! found a second time.

use crate::derivatives::KnotDerivatives;
use crate::guess::Swing;
use crate::interior_point::{self, Limit, NlpOptions, NlpSolution, NlpStatus};
use crate::problem::Problem;
use crate::random::Random;
use upswing_model::{JointVector, LimitKind};
use upswing_trajectory::Trajectory;

/// Half swings and durations, in half periods, of the guesses that are tried first. From either of the first two the best known optimum of
/// the paper's arm was found from all of 40 random starts; the first one takes the fewest iterations for cart-poles, the second
/// one for arms, see [`Guesses::swing`].
const SWINGS: [(f64, f64); 10] = [
    (1.5, 2.5),
    (1.0, 3.0),
    (2.0, 3.6),
    (3.0, 4.8),
    (4.0, 6.0),
    (5.0, 7.2),
    (7.0, 9.6),
    (10.0, 13.2),
    (14.0, 18.0),
    (20.0, 25.2),
];
/// Half swings and durations, in half periods, of the seeded guesses: from, to.
const SEEDED_SWINGS: (f64, f64) = (0.25, 1.75);
const SEEDED_DURATIONS: (f64, f64) = (1.5, 4.0);
/// Largest amplitudes of seeded waves on actuated and unactuated joints as shares of their range, or of one turn.
const SEEDED_WAVES: (f64, f64) = (0.2, 0.2);
/// That of the waves on actuated joints with which every second guess of [`SWINGS`] leaves the symmetric ridge between optima.
const RIDGE_WAVE: f64 = 0.1;
/// Costs that differ by this share are those of one optimum.
pub const SAME: f64 = 1e-3;

/// How hard to look for the best of several local optima.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// The first guess that converges.
    First,
    /// Swings until the next one is not cheaper, then a few guesses with seeded waves until the cheapest solution is found twice; it is
    /// kept. For a request that waits for its plan.
    Quick,
    /// As [`Search::Quick`], with more seeded guesses the more unactuated joints there are. For databases.
    Best,
}

/// The guesses of a problem.
struct Guesses<'a, 'm> {
    problem: &'a Problem<'m>,
    half_period: f64,
    /// Time in which each actuated joint gets to the target with its highest speed, s.
    shortest: f64,
    random: Random,
}

impl<'a, 'm> Guesses<'a, 'm> {
    fn new(problem: &'a Problem<'m>) -> Self {
        let way = problem.straight_line(1.0).end().q() - problem.start.q();
        let time = |i: usize| way[i].abs() / problem.limits.qd_max[i];
        let shortest = (0..problem.sizes().actuated()).map(time).fold(0.0, f64::max);
        Self { problem, half_period: problem.half_period(), shortest, random: Random(1) }
    }

    /// A number between the two.
    fn between(&mut self, (from, to): (f64, f64)) -> f64 {
        from + (to - from) * 0.5 * (1.0 + self.random.next())
    }

    fn duration(&self, half_periods: f64) -> f64 {
        let (least, most) = self.problem.t_f;
        (half_periods * self.half_period).max(self.shortest).clamp(least, most)
    }

    /// Seeded amplitudes of waves, up to the given shares of the ranges of actuated and unactuated joints.
    fn waves(&mut self, shares: (f64, f64)) -> JointVector {
        let (limits, sizes) = (&self.problem.limits, self.problem.sizes());
        JointVector::from_fn(sizes, |i| {
            let share = if i < sizes.actuated() { shares.0 } else { shares.1 };
            let range = (limits.q_max[i] - limits.q_min[i]).min(std::f64::consts::TAU);
            share * range * self.random.next()
        })
    }

    /// The guesses of [`SWINGS`] that are not longer than a motion may be; the first two change places where more joints are actuated than
    /// not.
    fn swing(&mut self, index: usize) -> Option<Trajectory> {
        let sizes = self.problem.sizes();
        let swapped = index < 2 && sizes.actuated() > sizes.unactuated();
        let (half_swings, half_periods) = SWINGS[if swapped { 1 - index } else { index }];
        if index > 1 && half_periods * self.half_period > self.problem.t_f.1 {
            return None;
        }
        let mut swing = Swing::plain(self.problem, half_swings, self.duration(half_periods));
        if index % 2 == 1 {
            swing.waves = self.waves((RIDGE_WAVE, 0.0));
            swing.half_waves = JointVector::repeat(sizes, 1.0);
        }
        Some(self.problem.swing(&swing))
    }

    /// The next guess with seeded waves on all joints, of one or two half waves.
    fn seeded(&mut self) -> Trajectory {
        let sizes = self.problem.sizes();
        let half_swings = self.between(SEEDED_SWINGS);
        let half_periods = self.between(SEEDED_DURATIONS);
        let waves = self.waves(SEEDED_WAVES);
        let half_waves = JointVector::from_fn(sizes, |_| if self.random.next() > 0.0 { 1.0 } else { 2.0 });
        let swing = Swing { half_swings, duration: self.duration(half_periods), waves, half_waves };
        self.problem.swing(&swing)
    }

    /// Least and largest number of seeded guesses. Where more joints are actuated than not, or where no unactuated joint turns over,
    /// there are few local optima; their number grows with that of the unactuated joints.
    fn seeded_count(&self, search: Search) -> (usize, usize) {
        /// Of a quick search: it finds the best known swing-up of the triple pendulum, in 0.4 s.
        const FEW: usize = 8;
        let (problem, sizes) = (self.problem, self.problem.sizes());
        let way = problem.straight_line(1.0).end().q() - problem.start.q();
        let turns_over = way.unactuated().amax() > std::f64::consts::FRAC_PI_2;
        match sizes.unactuated() {
            _ if search == Search::First => (0, 0),
            _ if search == Search::Quick => (0, FEW),
            unactuated if !turns_over || sizes.actuated() > unactuated => (0, FEW),
            1 => (6, 12),
            2 => (16, 48),
            _ => (64, 256),
        }
    }
}

/// What the attempts have found.
struct Found {
    best: Option<NlpSolution>,
    /// How often the optimum of `best` was found.
    times: usize,
    /// A solve was interrupted from outside.
    interrupted: bool,
}

impl Found {
    fn solved(&self) -> bool {
        self.best.as_ref().is_some_and(|best| best.status == NlpStatus::Solved)
    }

    /// Solves from a guess. Whether that gave a cheaper solution than all before.
    fn attempt(&mut self, problem: &Problem<'_>, guess: &Trajectory, options: &NlpOptions<'_>) -> bool {
        let solution = interior_point::solve(problem, guess, options);
        let solved = solution.status == NlpStatus::Solved;
        self.interrupted |= solution.status == NlpStatus::Interrupted;
        let (better, cheaper) = match &self.best {
            None => (true, solved),
            Some(best) if best.status == NlpStatus::Solved => {
                let cheaper = solved && solution.cost < best.cost * (1.0 - SAME);
                if solved && !cheaper && solution.cost <= best.cost * (1.0 + SAME) {
                    self.times += 1;
                }
                (solved && solution.cost < best.cost, cheaper)
            }
            Some(best) => (solved || solution.violation < best.violation, solved),
        };
        if cheaper {
            self.times = 1;
        }
        if better {
            self.best = Some(solution);
        }
        cheaper
    }
}

/// Solves `problem` from the guesses of [`Search`], and from the solutions of `neighbours`, which begin elsewhere; where there are few local
/// optima, until the cheapest one is found twice. A budget of time counts for each guess.
pub fn solve(
    problem: &Problem<'_>,
    search: Search,
    neighbours: &[Trajectory],
    options: &NlpOptions<'_>,
) -> NlpSolution {
    let mut guesses = Guesses::new(problem);
    let mut found = Found { best: None, times: 0, interrupted: false };
    for index in 0..SWINGS.len() {
        let Some(guess) = guesses.swing(index) else { break };
        let cheaper = found.attempt(problem, &guess, options);
        let enough = found.solved() && (search == Search::First || found.times > 1 || !cheaper);
        if enough || found.interrupted {
            break;
        }
    }
    let (least, most) = guesses.seeded_count(search);
    for neighbour in neighbours {
        if found.interrupted || least == 0 && found.times > 1 {
            break;
        }
        found.attempt(problem, &problem.shifted(neighbour), options);
    }
    if found.solved() {
        for tried in 0..most {
            if found.interrupted || tried >= least && found.times > 1 {
                break;
            }
            found.attempt(problem, &guesses.seeded(), options);
        }
    }
    // At least one attempt was made.
    found
        .best
        .unwrap_or_else(|| interior_point::solve(problem, &problem.straight_line(problem.t_f.0), options))
}

/// The limit without which a start that has no trajectory would have one: each kind of limit is lifted in turn, those
/// of the unactuated joints first, which the others cannot influence at once; what the trajectory then exceeds most is the answer.
pub fn limit_in_the_way(problem: &Problem<'_>, options: &NlpOptions<'_>) -> Option<Limit> {
    /// As good as none.
    const LIFTED: f64 = 100.0;
    let (actuated, joints) = (problem.sizes().actuated(), problem.sizes().joints());
    let both = [LimitKind::Velocity, LimitKind::Position];
    // One unactuated joint, then all of them, then the actuated ones.
    let single = both.into_iter().flat_map(|kind| (actuated..joints).rev().map(move |i| (kind, i..i + 1)));
    let whole = both.into_iter().map(|kind| (kind, actuated..joints)).filter(|(_, range)| range.len() > 1);
    let of_actuated =
        [LimitKind::Velocity, LimitKind::Torque, LimitKind::Position].map(|kind| (kind, 0..actuated));
    single.chain(whole).chain(of_actuated).find_map(|(kind, joints)| {
        let mut lifted = problem.clone();
        for i in joints.clone() {
            match kind {
                LimitKind::Velocity => lifted.limits.qd_max[i] *= LIFTED,
                LimitKind::Torque => lifted.limits.tau_max[i] *= LIFTED,
                LimitKind::Position => {
                    let (min, max) = problem.limits.range(kind, i);
                    let more = 0.5 * (LIFTED - 1.0) * (max - min);
                    (lifted.limits.q_min[i], lifted.limits.q_max[i]) = (min - more, max + more);
                }
            }
        }
        let guess = Guesses::new(&lifted).swing(0)?;
        let solution = interior_point::solve(&lifted, &guess, options);
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
    let (tau_min, tau_max) = problem.torque.bounds(&limits.tau_max);
    let mut worst = (0.0, None);
    KnotDerivatives::new(problem).evaluate_all(
        problem,
        trajectory.x.len(),
        |k| (&trajectory.x[k], &trajectory.u[k]),
        |k, values, lane| {
            let x = &trajectory.x[k];
            for joint in joints.clone() {
                let (value, (lower, upper)) = match kind {
                    LimitKind::Position => (x.q()[joint], limits.range(kind, joint)),
                    LimitKind::Velocity => (x.qd()[joint], limits.range(kind, joint)),
                    LimitKind::Torque => (values.tau[joint].0[lane], (tau_min[joint], tau_max[joint])),
                };
                let excess = (lower - value).max(value - upper) / (upper - lower);
                if excess > worst.0 {
                    worst = (excess, Some(Limit { kind, joint, time: k as f64 * trajectory.h() }));
                }
            }
        },
    );
    worst.1
}
