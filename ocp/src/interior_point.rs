//! Solves [`Problem`] with a primal-dual interior-point method and a filter line search (Waechter, Biegler,
//! *On the implementation of an interior-point filter line-search algorithm for large-scale nonlinear
//! programming*, Math. Program. 106, 2006), on top of the structured factorisation of [`crate::kkt`].
//!
//! Bounds of x_k, t_F and of slacks s_k = tau_k carry logarithmic barriers; the slacks are eliminated from the
//! linear system. Constants without a comment are those of the publication.

mod bounded;
mod conditions;
mod filter;
mod newton;

use crate::derivatives::KnotDerivatives;
use crate::problem::Problem;
use crate::slab::{Slab, entries};
use bounded::BoundedVector;
use filter::Filter;
use newton::{Direction, LinearSystem};
use std::time::{Duration, Instant};
use upswing_model::{ActuatedVector, LARGEST_STATE, LimitKind, Sizes, State, States};
use upswing_trajectory::Trajectory;

/// When to stop.
#[derive(Clone, Copy)]
pub struct NlpOptions<'a> {
    /// Largest residual of a solution: defects, scaled stationarity and complementarity.
    pub tolerance: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// Longest time; the last iterate is returned then.
    pub time_budget: Option<Duration>,
    /// Asked before each iteration: whether to stop; the last iterate is returned then.
    pub cancelled: Option<&'a dyn Fn() -> bool>,
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NlpStatus {
    /// All residuals are within the tolerance.
    Solved,
    /// The iteration budget was used up.
    MaxIterations,
    /// The time budget was used up.
    OutOfTime,
    /// Stopped from outside.
    Interrupted,
    /// No step leads on, though all constraints are kept within the tolerance: the optimum is not found more precisely.
    Stalled,
    /// No step reduces the constraint violation any more: near this trajectory the constraints contradict each
    /// other, and this limit cannot be kept.
    Infeasible(Limit),
}

/// A limit at one moment of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Of what.
    pub kind: LimitKind,
    /// Index of the joint in sorted vectors.
    pub joint: usize,
    /// When, s.
    pub time: f64,
}

impl std::fmt::Display for Limit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} limit of joint {} at {:.2} s", self.kind, self.joint + 1, self.time)
    }
}

impl std::fmt::Display for NlpStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Solved => f.write_str("solved"),
            Self::MaxIterations => f.write_str("iteration budget used up"),
            Self::OutOfTime => f.write_str("time budget used up"),
            Self::Interrupted => f.write_str("interrupted"),
            Self::Stalled => {
                f.write_str("no progress any more: all limits are kept, the optimum is not reached")
            }
            Self::Infeasible(limit) => write!(f, "infeasible: the {limit} cannot be kept"),
        }
    }
}

/// A trajectory with how it was found.
#[derive(Clone, Debug)]
pub struct NlpSolution {
    /// The last iterate.
    pub trajectory: Trajectory,
    /// Why the method stopped.
    pub status: NlpStatus,
    /// J (6a).
    pub cost: f64,
    /// Iterations done.
    pub iterations: usize,
    /// Largest violation of (6b), (6c), (8) and of the torque constraint (fraction of its range).
    pub violation: f64,
    /// Largest scaled residual of the stationarity conditions.
    pub stationarity: f64,
    /// The multipliers that belong to the trajectory.
    pub multipliers: Multipliers,
}

/// Multipliers of the Lagrangian
///
/// L = J + sum lambda_k' c_k + nu' (C x_N - d) + sum zeta_k' x_k + sum pi_k' tau_k + zeta_t t_F
///
/// with the cost J (6a), s, and the defects c_k = x_{k+1} - x_k - h/2 (f_k + f_{k+1}) (6b), whose derivatives with respect to x_1..x_N, u_0..u_N and
/// t_F are zero at an optimum. A multiplier says how much cheaper the optimum gets per unit by which its constraint is relaxed. Those of limits are
/// positive at the upper limit, negative at the lower one, and as small as the tolerance in between.
#[derive(Clone, Debug)]
pub struct Multipliers {
    /// lambda_0..lambda_{N-1} of the defects: s per rad or m of positions, s per rad/s or m/s of velocities.
    pub defects: Vec<State>,
    /// nu of the rows C x_N = d of the target (8), in their order: s per unit of a row.
    pub target: Vec<f64>,
    /// zeta_1..zeta_N of the limits of x_1..x_N, units as those of the defects.
    pub x: Vec<State>,
    /// pi_0..pi_N of the limits of the constrained torque, that of (9) or of (11): s per N m or N.
    pub torque: Vec<ActuatedVector>,
    /// zeta_t of the limits of t_F.
    pub t_f: f64,
}

/// Primal variables of an iterate: the entries of all knots, one knot after the other.
#[derive(Clone, Debug)]
struct Primal {
    sizes: Sizes,
    t: f64,
    x: Vec<f64>,
    u: Vec<f64>,
    /// Slacks of the constrained torque, in units of half its range.
    s: Vec<f64>,
}

impl Primal {
    /// N
    fn intervals(&self) -> usize {
        self.x.len() / self.sizes.state() - 1
    }

    /// h = t_F / N
    fn h(&self) -> f64 {
        self.t / self.intervals() as f64
    }

    /// x_k
    fn x(&self, k: usize) -> State {
        entries(self.sizes, part(&self.x, k, self.sizes.state()))
    }

    /// u_k
    fn u(&self, k: usize) -> ActuatedVector {
        entries(self.sizes, part(&self.u, k, self.sizes.actuated()))
    }

    /// x_1..x_N, which have bounds: x_0 is given.
    fn free_x(&self) -> &[f64] {
        &self.x[self.sizes.state()..]
    }

    /// sum u_k' u_k
    fn effort(&self) -> f64 {
        self.u.iter().map(|u| u * u).sum()
    }

    fn trajectory(&self) -> Trajectory {
        let knots = 0..=self.intervals();
        Trajectory {
            t_f: self.t,
            x: knots.clone().map(|k| self.x(k)).collect(),
            u: knots.map(|k| self.u(k)).collect(),
        }
    }
}

/// The entries of knot `k` of `length` each.
#[inline]
fn part(entries: &[f64], k: usize, length: usize) -> &[f64] {
    &entries[k * length..][..length]
}

/// a += s b
fn add_scaled(a: &mut [f64], s: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += s * b);
}

/// Residuals of the constraints.
#[derive(Clone, Debug)]
struct Residuals {
    /// Defects: the residuals of the dynamics (6b).
    defects: Slab<States>,
    target: Vec<f64>,
    /// tau_k - s_k, scaled, of all knots.
    torque: Vec<f64>,
}

impl Residuals {
    /// Their entries, and zeros.
    fn parts(&self) -> [&[f64]; 3] {
        [self.defects.as_slice(), &self.target, &self.torque]
    }

    /// Sum of absolute values.
    fn total(&self) -> f64 {
        self.parts().iter().map(|part| part.iter().map(|v| v.abs()).sum::<f64>()).sum()
    }

    fn largest(&self) -> f64 {
        self.parts().into_iter().flatten().fold(0.0, |largest: f64, v| largest.max(v.abs()))
    }

    /// self * a + other
    fn scaled_plus(&self, a: f64, other: &Self) -> Self {
        let mut sum = other.clone();
        let Self { defects, target, torque } = &mut sum;
        for (sum, part) in [defects.as_mut_slice(), target, torque].into_iter().zip(self.parts()) {
            add_scaled(sum, a, part);
        }
        sum
    }
}

/// A point that the filter accepts: primal variables, their residuals, and the step that led there.
struct TrialPoint {
    primal: Primal,
    residuals: Residuals,
    direction: Direction,
    /// Share of the primal and of the equalities' dual step.
    alpha: f64,
}

struct NlpSolver<'a> {
    problem: &'a Problem<'a>,
    /// Values and derivatives at some knots.
    derivatives: KnotDerivatives,
    /// Centre and half range of the constrained torque.
    torque_centre: ActuatedVector,
    torque_half: ActuatedVector,
    primal: Primal,
    /// Multipliers of the defects, of the target rows, and of tau_k = s_k.
    lambda: Slab<States>,
    lambda_target: Vec<f64>,
    lambda_torque: Vec<f64>,
    /// w_k = lambda_{k-1} + lambda_k, what the defects on both sides of knot k pull with.
    on_knots: Slab<States>,
    /// Bounds of x_1..x_N (x_0 is given), of the slacks and of t_F.
    bound_x: BoundedVector,
    bound_s: BoundedVector,
    bound_t: BoundedVector,
    mu: f64,
    /// Last damping that a factorisation needed.
    last_damping: f64,
}

/// Solves the problem from the `guess`.
pub fn solve(problem: &Problem<'_>, guess: &Trajectory, options: &NlpOptions<'_>) -> NlpSolution {
    NlpSolver::new(problem, guess).run(options)
}

/// Barrier parameter to begin with: takes a third fewer iterations than the publication's 0.1 on the paper's grid, to
/// equally good optima.
const BARRIER: f64 = 1e-3;

impl<'a> NlpSolver<'a> {
    fn new(problem: &'a Problem<'a>, guess: &Trajectory) -> Self {
        let mu = BARRIER;
        let (sizes, n) = (problem.sizes(), guess.intervals());
        let (low, high) = problem.torque.bounds(&problem.limits.tau_max);
        let (torque_centre, torque_half) = ((low + high) * 0.5, (high - low) * 0.5);
        let mut t = [guess.t_f];
        let bound_t = BoundedVector::new(vec![problem.t_f.0], vec![problem.t_f.1], &mut t, mu);
        let mut primal = Primal {
            sizes,
            t: t[0],
            x: guess.x.iter().flat_map(|x| x.iter().copied()).collect(),
            u: guess.u.iter().flat_map(|u| u.iter().copied()).collect(),
            s: Vec::with_capacity((n + 1) * sizes.actuated()),
        };
        let (start, free) = primal.x.split_at_mut(sizes.state());
        start.copy_from_slice(&problem.start);
        let (mut lowest, mut highest) = (Vec::with_capacity(free.len()), Vec::with_capacity(free.len()));
        for k in 1..=n {
            let (low, high) = problem.bounds(k);
            lowest.extend_from_slice(&low);
            highest.extend_from_slice(&high);
        }
        let bound_x = BoundedVector::new(lowest, highest, free, mu);
        let mut derivatives = KnotDerivatives::new(problem);
        let Primal { x, u, s, .. } = &mut primal;
        derivatives.evaluate_all(
            problem,
            n + 1,
            |k| (part(x, k, sizes.state()), part(u, k, sizes.actuated())),
            |_, values, lane| {
                let scaled = |a: usize| (values.tau[a].0[lane] - torque_centre[a]) / torque_half[a];
                s.extend((0..sizes.actuated()).map(scaled));
            },
        );
        let ones = vec![1.0; primal.s.len()];
        let bound_s = BoundedVector::new(vec![-1.0; ones.len()], ones, &mut primal.s, mu);
        Self {
            problem,
            derivatives,
            torque_centre,
            torque_half,
            lambda: Slab::zeros(sizes, n, 1),
            on_knots: Slab::zeros(sizes, n + 1, 1),
            lambda_target: vec![0.0; problem.target.len()],
            lambda_torque: vec![0.0; primal.s.len()],
            primal,
            bound_x,
            bound_s,
            bound_t,
            mu,
            last_damping: 0.0,
        }
    }

    fn residuals(&mut self, p: &Primal) -> Residuals {
        let (sizes, n) = (p.sizes, p.intervals());
        let (joints, actuated, state) = (sizes.joints(), sizes.actuated(), sizes.state());
        let half_h = 0.5 * p.h();
        let mut defects = Slab::<States>::zeros(sizes, n, 1);
        let mut torque = Vec::with_capacity(p.s.len());
        // f of the last two knots.
        let (mut before, mut f) = ([0.0; LARGEST_STATE], [0.0; LARGEST_STATE]);
        let point = |k| (part(&p.x, k, state), part(&p.u, k, actuated));
        let (centre, half) = (&self.torque_centre, &self.torque_half);
        self.derivatives.evaluate_all(self.problem, n + 1, point, |k, values, lane| {
            let ((x, u), s) = (point(k), part(&p.s, k, actuated));
            for i in 0..actuated {
                torque.push((values.tau[i].0[lane] - centre[i]) / half[i] - s[i]);
            }
            // [qd, u, qdd_U]
            f[..joints].copy_from_slice(&x[joints..]);
            f[joints..joints + actuated].copy_from_slice(u);
            for i in joints + actuated..state {
                f[i] = values.qdd_u[i - joints - actuated].0[lane];
            }
            if k > 0 {
                let (last, defect) = (point(k - 1).0, defects.vector_mut(k - 1));
                for i in 0..state {
                    defect[i] = x[i] - last[i] - (before[i] + f[i]) * half_h;
                }
            }
            std::mem::swap(&mut before, &mut f);
        });
        let end = p.x(n);
        let target = self.problem.target.iter().map(|row| row.residual(&end)).collect();
        Residuals { defects, target, torque }
    }

    /// Barrier function of the primal variables.
    fn barrier_function(&self, p: &Primal) -> f64 {
        self.problem.cost(p.t, p.intervals(), p.effort())
            + self.bound_t.barrier(&[p.t], self.mu)
            + self.bound_x.barrier(p.free_x(), self.mu)
            + self.bound_s.barrier(&p.s, self.mu)
    }

    fn moved(&self, d: &Direction, alpha: f64) -> Primal {
        let mut p = self.primal.clone();
        p.t += alpha * d.t;
        add_scaled(&mut p.x, alpha, &d.x);
        add_scaled(&mut p.u, alpha, &d.u);
        add_scaled(&mut p.s, alpha, &d.s);
        p
    }

    /// Derivative of the barrier function along the primal step.
    fn slope(&self, d: &Direction) -> f64 {
        let p = &self.primal;
        let effort: f64 = p.u.iter().zip(&d.u).map(|(u, du)| u * du).sum();
        p.h() * self.problem.input_weight * effort
            + self.objective_on_t() * d.t
            + self.bound_t.slope(&[p.t], &[d.t], self.mu)
            + self.bound_x.slope(p.free_x(), d.free_x(), self.mu)
            + self.bound_s.slope(&p.s, &d.s, self.mu)
    }

    /// The solver's loop: check convergence, update the barrier, compute the search direction, find an acceptable trial point,
    /// accept it.
    fn run(mut self, options: &NlpOptions<'_>) -> NlpSolution {
        let begin = Instant::now();
        let mut filter = Filter::default();
        let mut iterations = 0;
        let mut c = {
            let p = self.primal.clone();
            self.residuals(&p)
        };
        filter.set_scale(c.total());
        let mut linear =
            LinearSystem::new(self.problem.sizes(), &self.problem.target, self.primal.intervals());
        let (status, stationarity) = loop {
            self.linearise(&mut linear);
            let violation = c.largest();
            let stationarity = self.stationarity(&mut linear);
            let infeasibility = stationarity.max(violation);
            if let Some(status) = self.check_convergence(infeasibility, iterations, begin, options) {
                break (status, stationarity);
            }
            self.update_barrier(infeasibility, options.tolerance, &mut filter);
            iterations += 1;
            self.condense(&mut linear);
            match self.iterate(&mut linear, &c, &mut filter) {
                Some(next) => c = next,
                None if violation <= options.tolerance => break (NlpStatus::Stalled, stationarity),
                None => break (NlpStatus::Infeasible(self.blocking_limit()), stationarity),
            }
        };
        let cost = self.problem.cost(self.primal.t, self.primal.intervals(), self.primal.effort());
        NlpSolution {
            trajectory: self.primal.trajectory(),
            status,
            cost,
            iterations,
            violation: c.largest(),
            stationarity,
            multipliers: self.multipliers(),
        }
    }

    /// The multipliers of the iterate, of both bounds of a number together, in the units of the problem.
    fn multipliers(&self) -> Multipliers {
        let (sizes, n) = (self.primal.sizes, self.primal.intervals());
        let pull = |b: &BoundedVector, i: usize| b.z_upper[i] - b.z_lower[i];
        let (state, actuated) = (sizes.state(), sizes.actuated());
        let x = |k: usize| State::from_fn(sizes, |i| pull(&self.bound_x, k * state + i));
        let torque = |k: usize| {
            ActuatedVector::from_fn(sizes, |i| self.lambda_torque[k * actuated + i] / self.torque_half[i])
        };
        Multipliers {
            defects: (0..n).map(|k| entries(sizes, self.lambda.vector(k))).collect(),
            target: self.lambda_target.clone(),
            x: (0..n).map(x).collect(),
            torque: (0..=n).map(torque).collect(),
            t_f: pull(&self.bound_t, 0),
        }
    }

    /// Why no further iteration is needed or allowed; `infeasibility` is the largest residual of stationarity and constraints.
    fn check_convergence(
        &self,
        infeasibility: f64,
        iterations: usize,
        begin: Instant,
        options: &NlpOptions<'_>,
    ) -> Option<NlpStatus> {
        if infeasibility.max(self.complementarity(0.0)) <= options.tolerance {
            Some(NlpStatus::Solved)
        } else if iterations >= options.max_iterations {
            Some(NlpStatus::MaxIterations)
        } else if options.time_budget.is_some_and(|budget| begin.elapsed() >= budget) {
            Some(NlpStatus::OutOfTime)
        } else if options.cancelled.is_some_and(|cancelled| cancelled()) {
            Some(NlpStatus::Interrupted)
        } else {
            None
        }
    }

    /// Reduces mu as long as the barrier problem is solved well enough.
    fn update_barrier(&mut self, infeasibility: f64, tolerance: f64, filter: &mut Filter) {
        const THETA_MU: f64 = 1.5;
        const KAPPA_MU: f64 = 0.2;
        /// The publication's 10 takes 5 % more iterations on the paper's grid.
        const KAPPA_EPSILON: f64 = 30.0;
        let smallest = tolerance / 10.0;
        while !(infeasibility.max(self.complementarity(self.mu)) > KAPPA_EPSILON * self.mu
            || self.mu <= smallest)
        {
            self.mu = (KAPPA_MU * self.mu).min(libm::pow(self.mu, THETA_MU)).max(smallest);
            filter.clear();
        }
    }

    /// Moves to the next iterate and returns its residuals; `None` if no search direction leads to an acceptable point.
    fn iterate(
        &mut self,
        linear: &mut LinearSystem,
        c: &Residuals,
        filter: &mut Filter,
    ) -> Option<Residuals> {
        /// A direction that fails is tried again with more damping: shorter, and closer to the shortest one to feasibility.
        const RETRIES: usize = 12;
        let mut least = 0.0;
        for _ in 0..RETRIES {
            let d = self.search_direction(linear, least, c)?;
            let damping = d.damping;
            if let Some(trial) = self.acceptable_trial_point(linear, d, c, filter) {
                return Some(self.accept(trial));
            }
            least = if damping == 0.0 { self.last_damping.max(1e-4) } else { damping * 10.0 };
        }
        None
    }

    /// The primal-dual step, with at least the damping `least`; `None` if the matrix cannot be factorised.
    fn search_direction(
        &mut self,
        linear: &mut LinearSystem,
        least: f64,
        c: &Residuals,
    ) -> Option<Direction> {
        let damping = self.factor(linear, least)?;
        Some(self.direction(linear, damping, c))
    }

    /// Filter line search: the longest step along `d`, halved until the filter accepts it, or a second-order correction of the full
    /// step.
    fn acceptable_trial_point(
        &mut self,
        linear: &mut LinearSystem,
        d: Direction,
        c: &Residuals,
        filter: &mut Filter,
    ) -> Option<TrialPoint> {
        let (theta, phi) = (c.total(), self.barrier_function(&self.primal));
        let slope = self.slope(&d);
        let mut alpha = d.alpha.0;
        let smallest = alpha * 1e-4;
        let mut first = true;
        while alpha >= smallest {
            let primal = self.moved(&d, alpha);
            let residuals = self.residuals(&primal);
            let (theta_p, phi_p) = (residuals.total(), self.barrier_function(&primal));
            if filter.accepts(theta, phi, theta_p, phi_p, alpha, slope) {
                return Some(TrialPoint { primal, residuals, direction: d, alpha });
            }
            if first && theta_p >= theta {
                let full = (residuals, alpha, slope);
                let corrected = self.correct(linear, d.damping, c, full, (theta, phi), filter);
                if corrected.is_some() {
                    return corrected;
                }
            }
            first = false;
            alpha *= 0.5;
        }
        None
    }

    /// Second-order corrections of a full step that left the constraints: `first` are its residuals.
    fn correct(
        &mut self,
        linear: &mut LinearSystem,
        damping: f64,
        c: &Residuals,
        (first, alpha, slope): (Residuals, f64, f64),
        (theta, phi): (f64, f64),
        filter: &mut Filter,
    ) -> Option<TrialPoint> {
        const CORRECTIONS: usize = 4;
        const KAPPA_SOC: f64 = 0.99;
        let mut theta_old = first.total();
        let mut corrected = c.scaled_plus(alpha, &first);
        for _ in 0..CORRECTIONS {
            let d = self.direction(linear, damping, &corrected);
            let primal = self.moved(&d, d.alpha.0);
            let residuals = self.residuals(&primal);
            let (theta_p, phi_p) = (residuals.total(), self.barrier_function(&primal));
            if filter.accepts(theta, phi, theta_p, phi_p, alpha, slope) {
                return Some(TrialPoint { primal, residuals, alpha: d.alpha.0, direction: d });
            }
            if theta_p > KAPPA_SOC * theta_old || !theta_p.is_finite() {
                return None;
            }
            theta_old = theta_p;
            corrected = corrected.scaled_plus(d.alpha.0, &residuals);
        }
        None
    }

    /// Makes the trial point the iterate, moves the multipliers along, and returns its residuals.
    fn accept(&mut self, trial: TrialPoint) -> Residuals {
        let TrialPoint { primal, residuals, direction: d, alpha } = trial;
        self.primal = primal;
        let advance = |old: &mut [f64], new: &[f64]| {
            old.iter_mut().zip(new).for_each(|(old, new)| *old += (new - *old) * alpha);
        };
        advance(self.lambda.as_mut_slice(), d.lambda.as_slice());
        advance(&mut self.lambda_target, &d.lambda_target);
        advance(&mut self.lambda_torque, &d.lambda_torque);
        self.bound_x.advance(self.primal.free_x(), &d.bound_x, d.alpha.1, self.mu);
        self.bound_s.advance(&self.primal.s, &d.bound_s, d.alpha.1, self.mu);
        self.bound_t.advance(&[self.primal.t], &d.bound_t, d.alpha.1, self.mu);
        residuals
    }
}
