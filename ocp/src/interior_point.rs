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

use crate::fixed::{ActuatedVector, NU, NX, State, vector};
use crate::fixed_kkt::KnotParts;
use crate::problem::{KnotDerivatives, Problem};
use bounded::BoundedVector;
use filter::Filter;
use nalgebra::SVector;
use newton::{Direction, LinearSystem};
use std::time::{Duration, Instant};
use upswing_model::{Dims, LimitKind, Sizes, Workspace};
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
}

type Scalar = SVector<f64, 1>;

/// Primal variables of an iterate.
#[derive(Clone, Debug)]
struct Primal {
    t: f64,
    x: Vec<State>,
    u: Vec<ActuatedVector>,
    /// Slacks of the constrained torque, in units of half its range.
    s: Vec<ActuatedVector>,
}

impl Primal {
    /// N
    fn intervals(&self) -> usize {
        self.x.len() - 1
    }

    /// h = t_F / N
    fn h(&self) -> f64 {
        self.t / self.intervals() as f64
    }

    /// x_k and u_k as the model takes them.
    fn knot(&self, sizes: Sizes, k: usize) -> (upswing_model::State, upswing_model::ActuatedVector) {
        (
            upswing_model::State::from_fn(sizes, |i| self.x[k][i]),
            upswing_model::ActuatedVector::from_fn(sizes, |i| self.u[k][i]),
        )
    }

    /// sum u_k' u_k
    fn effort(&self) -> f64 {
        self.u.iter().map(|u| u.norm_squared()).sum()
    }
}

/// Residuals of the constraints.
#[derive(Clone, Debug)]
struct Residuals {
    /// Defects: the residuals of the dynamics (6b).
    defects: Vec<State>,
    target: Vec<f64>,
    /// tau_k - s_k, scaled.
    torque: Vec<ActuatedVector>,
}

impl Residuals {
    /// Sum of absolute values.
    fn total(&self) -> f64 {
        let sum = |v: &[f64]| v.iter().map(|a| a.abs()).sum::<f64>();
        self.defects.iter().map(|d| d.lp_norm(1)).sum::<f64>()
            + sum(&self.target)
            + self.torque.iter().map(|d| d.lp_norm(1)).sum::<f64>()
    }

    fn largest(&self) -> f64 {
        let d = self.defects.iter().map(|d| d.amax()).fold(0.0, f64::max);
        let t = self.target.iter().fold(0.0, |m: f64, t| m.max(t.abs()));
        self.torque.iter().map(|d| d.amax()).fold(d.max(t), f64::max)
    }

    /// self * a + other
    fn scaled_plus(&self, a: f64, other: &Self) -> Self {
        Self {
            defects: self.defects.iter().zip(&other.defects).map(|(p, q)| p * a + q).collect(),
            target: self.target.iter().zip(&other.target).map(|(p, q)| p * a + q).collect(),
            torque: self.torque.iter().zip(&other.torque).map(|(p, q)| p * a + q).collect(),
        }
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
    work: Workspace,
    /// Derivatives at one knot: first and second ones.
    derivatives: KnotDerivatives,
    hessian: Vec<f64>,
    /// Centre and half range of the constrained torque.
    torque_centre: ActuatedVector,
    torque_half: ActuatedVector,
    primal: Primal,
    /// Multipliers of the defects, of the target rows, and of tau_k = s_k.
    lambda: Vec<State>,
    lambda_target: Vec<f64>,
    lambda_torque: Vec<ActuatedVector>,
    /// Bounds of x_1..x_N (x_0 is given).
    bound_x: Vec<BoundedVector<NX>>,
    bound_s: Vec<BoundedVector<NU>>,
    bound_t: BoundedVector<1>,
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
        let mut work = Workspace::default();
        let mu = BARRIER;
        let (low, high) = problem.torque.bounds(&problem.limits.tau_max);
        let (low, high) = (vector::<NU>(&low), vector::<NU>(&high));
        let (torque_centre, torque_half) = ((low + high) * 0.5, (high - low) * 0.5);
        let mut t = Scalar::new(guess.t_f);
        let bound_t = BoundedVector::new(Scalar::new(problem.t_f.0), Scalar::new(problem.t_f.1), &mut t, mu);
        let mut primal = Primal {
            t: t[0],
            x: guess.x.iter().map(|x| vector(x)).collect(),
            u: guess.u.iter().map(|u| vector(u)).collect(),
            s: Vec::new(),
        };
        primal.x[0] = vector(&problem.start);
        let n = guess.intervals();
        let bound_x = (1..=n)
            .map(|k| {
                let (lowest, highest) = problem.bounds(k);
                BoundedVector::new(vector(&lowest), vector(&highest), &mut primal.x[k], mu)
            })
            .collect();
        let one = ActuatedVector::repeat(1.0);
        let mut bound_s = Vec::with_capacity(n + 1);
        for k in 0..=n {
            let (x, u) = primal.knot(problem.sizes(), k);
            let (_, tau) = problem.knot(&x, &u, &mut work);
            let mut s = (vector(&tau) - torque_centre).component_div(&torque_half);
            bound_s.push(BoundedVector::new(-one, one, &mut s, mu));
            primal.s.push(s);
        }
        Self {
            problem,
            derivatives: KnotDerivatives::new(problem),
            hessian: vec![0.0; problem.sizes().knot() * problem.sizes().knot_row()],
            work,
            torque_centre,
            torque_half,
            primal,
            lambda: vec![State::zeros(); n],
            lambda_target: vec![0.0; problem.target.len()],
            lambda_torque: vec![ActuatedVector::zeros(); n + 1],
            bound_x,
            bound_s,
            bound_t,
            mu,
            last_damping: 0.0,
        }
    }

    fn residuals(&mut self, p: &Primal) -> Residuals {
        let (half_h, n) = (0.5 * p.h(), p.intervals());
        let mut f: Vec<State> = Vec::with_capacity(n + 1);
        let mut torque = Vec::with_capacity(n + 1);
        for k in 0..=n {
            let (x, u) = p.knot(self.problem.sizes(), k);
            let (f_k, tau) = self.problem.knot(&x, &u, &mut self.work);
            f.push(vector(&f_k));
            torque.push((vector(&tau) - self.torque_centre).component_div(&self.torque_half) - p.s[k]);
        }
        Residuals {
            defects: (0..n).map(|k| p.x[k + 1] - p.x[k] - (f[k] + f[k + 1]) * half_h).collect(),
            target: self
                .problem
                .target
                .iter()
                .map(|r| vector::<NX>(&r.coefficients).dot(&p.x[n]) - r.value)
                .collect(),
            torque,
        }
    }

    /// Barrier function of the primal variables.
    fn barrier_function(&self, p: &Primal) -> f64 {
        let mut phi = self.problem.cost(p.t, p.intervals(), p.effort())
            + self.bound_t.barrier(&Scalar::new(p.t), self.mu);
        for (b, x) in self.bound_x.iter().zip(&p.x[1..]) {
            phi += b.barrier(x, self.mu);
        }
        for (b, s) in self.bound_s.iter().zip(&p.s) {
            phi += b.barrier(s, self.mu);
        }
        phi
    }

    fn moved(&self, d: &Direction, alpha: f64) -> Primal {
        let mut p = self.primal.clone();
        p.t += alpha * d.step.t;
        for k in 0..p.x.len() {
            p.x[k] += d.step.z[k].x() * alpha;
            p.u[k] += d.step.z[k].u() * alpha;
            p.s[k] += d.s[k] * alpha;
        }
        p
    }

    /// Derivative of the barrier function along the primal step.
    fn slope(&self, d: &Direction) -> f64 {
        let (h, r) = (self.primal.h(), self.problem.input_weight);
        let t = Scalar::new(self.primal.t);
        let mut slope = (self.objective_on_t() + self.bound_t.gradient(&t, self.mu)[0]) * d.step.t;
        for k in 0..self.primal.x.len() {
            slope += self.primal.u[k].dot(&d.step.z[k].u()) * (h * r);
            slope += self.bound_s[k].gradient(&self.primal.s[k], self.mu).dot(&d.s[k]);
            if k > 0 {
                let dx = d.step.z[k].x();
                slope += self.bound_x[k - 1].gradient(&self.primal.x[k], self.mu).dot(&dx);
            }
        }
        slope
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
        let Primal { t, x, .. } = &self.primal;
        let cost = self.problem.cost(*t, self.primal.intervals(), self.primal.effort());
        let knots = (0..x.len()).map(|k| self.primal.knot(self.problem.sizes(), k));
        NlpSolution {
            trajectory: Trajectory {
                t_f: *t,
                x: knots.clone().map(|(x, _)| x).collect(),
                u: knots.map(|(_, u)| u).collect(),
            },
            status,
            cost,
            iterations,
            violation: c.largest(),
            stationarity,
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
            self.mu = (KAPPA_MU * self.mu).min(self.mu.powf(THETA_MU)).max(smallest);
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
        self.lambda.iter_mut().zip(&d.step.lambda).for_each(|(l, new)| *l += (new - *l) * alpha);
        let targets = self.lambda_target.iter_mut().zip(&d.step.lambda_target);
        targets.for_each(|(l, new)| *l += (new - *l) * alpha);
        self.lambda_torque.iter_mut().zip(&d.lambda_torque).for_each(|(l, dl)| *l += dl * alpha);
        for k in 0..self.primal.x.len() {
            self.bound_s[k].advance(&self.primal.s[k], &d.bound_s[k], d.alpha.1, self.mu);
            if k > 0 {
                self.bound_x[k - 1].advance(&self.primal.x[k], &d.bound_x[k - 1], d.alpha.1, self.mu);
            }
        }
        self.bound_t.advance(&Scalar::new(self.primal.t), &d.bound_t, d.alpha.1, self.mu);
        residuals
    }
}
