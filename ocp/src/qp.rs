//! The quadratic program of a replan (16), in stages, and its two back ends.
//!
//! min 1/2 dxi' Q dxi + g' dxi over dxi = (dt, dz_0..dz_N), dz_k = (dx_k, du_k), subject to
//!
//! - dx_{k+1} - dx_k - h/2 (A_k dx_k + B_k du_k + A_{k+1} dx_{k+1} + B_{k+1} du_{k+1})
//!   - dt (f_k + f_{k+1}) / (2 N) + r_k = 0 (14), dx_0 given (15), the rows of the target (8),
//! - bounds of dx_1..dx_N and dt, and the linearised torque (9) or (11) of every knot within its bounds.
//!
//! [`QpSolver`] has two back ends. [`structured`] uses the stages and is fast. Clarabel, a general sparse solver of other authors, is
//! slower and scales the program; it is a second opinion where [`structured`] makes no progress, and the reference of the tests.

mod clarabel;
pub mod structured;

use crate::derivatives::{KnotDerivatives, LANES};
use crate::kkt::{Dynamics, TargetRow};
use crate::problem::Problem;
use crate::slab::{KnotParts, KnotVector, Knots, Slab};
use std::time::Instant;
use structured::Structured;
use upswing_model::{ActuatedVector, LimitKind, Sizes, State, States};
use upswing_trajectory::Trajectory;

/// Linearised torques of all knots within their bounds: lower <= J_k dz_k <= upper.
#[derive(Clone, Debug)]
pub struct TorqueRows {
    /// J_k = [d tau / dx, d tau / du], N + 1 panels of n_A rows.
    pub jacobian: Slab<Knots>,
    /// Bounds (lower, upper) less the torque of the linearisation point, N + 1 of them, N m or N.
    pub bounds: Vec<(ActuatedVector, ActuatedVector)>,
}

/// The diagonal of Q (17), the same at every knot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QpWeights {
    /// Of t_F, 1/s^2.
    pub t_f: f64,
    /// Of z_k: 1/rad^2 or 1/m^2 for positions, times s^2 for velocities, times s^4 for inputs.
    pub z: KnotVector,
}

/// The program; positions in rad or m, times in s, torques in N m or N.
#[derive(Clone, Debug)]
pub struct Qp {
    /// Diagonal of Q at the knots, N + 1 of them.
    pub weight: Slab<Knots>,
    /// Q of t_F.
    pub weight_t: f64,
    /// g at the knots, N + 1 of them, and of t_F.
    pub gradient: Slab<Knots>,
    /// See `gradient`.
    pub gradient_t: f64,
    /// h = t_F / N of the linearisation point, s.
    pub h: f64,
    /// Gamma^x_k, Gamma^u_k and f_k, N + 1 of them.
    pub dynamics: Dynamics,
    /// Defects (6b) of the linearisation point, N of them.
    pub defects: Slab<States>,
    /// dx_0 (15).
    pub start: State,
    /// Target rows, `value` less what the linearisation point has.
    pub target: Vec<TargetRow>,
    /// Bounds (lower, upper) of dx_1..dx_N.
    pub x: Vec<(State, State)>,
    /// Bounds of dt, s.
    pub t: (f64, f64),
    /// (9) or (11).
    pub torque: TorqueRows,
    /// 0 for hard bounds. Else each bound (positions, velocities, half ranges of the torque, s) may be exceeded by e at the
    /// cost e^2 / (2 `compliance`).
    pub compliance: f64,
}

impl Qp {
    /// (16) linearised around `at`, for the deviation from `reference`, which has as many knots.
    pub fn new(problem: &Problem<'_>, reference: &Trajectory, at: &Trajectory, weights: &QpWeights) -> Self {
        let (sizes, n) = (problem.sizes(), at.intervals());
        let (tau_min, tau_max) = problem.torque.bounds(&problem.limits.tau_max);
        let mut dynamics = Dynamics::zeros(sizes, n);
        let mut jacobian = Slab::zeros(sizes, n + 1, sizes.actuated());
        let mut bounds = Vec::with_capacity(n + 1);
        let mut weight = Slab::<Knots>::zeros(sizes, n + 1, 1);
        let mut gradient = weight.clone();
        let mut derivatives = KnotDerivatives::new(problem);
        for first in (0..=n).step_by(LANES) {
            for lane in 0..LANES {
                // Lanes that are left over repeat the last knot.
                let k = (first + lane).min(n);
                derivatives.set_point(lane, &at.x[k], &at.u[k]);
            }
            derivatives.linearise(problem);
            for (lane, k) in (first..=n).take(LANES).enumerate() {
                derivatives.write_dynamics(lane, k, &mut dynamics);
                for a in 0..sizes.actuated() {
                    derivatives.write_torque_row(lane, a, jacobian.row_mut(k, a));
                }
                let tau = derivatives.tau(lane);
                bounds.push((tau_min - tau, tau_max - tau));
            }
        }
        for (k, (x, u)) in at.knots().enumerate() {
            let mut dz = KnotVector::zeros(sizes);
            dz.x_mut().copy_from_slice(&(x - reference.x[k]));
            dz.u_mut().copy_from_slice(&(u - reference.u[k]));
            weight.set(k, &weights.z);
            gradient.set(k, &dz.component_mul(&weights.z));
        }
        let half_h = 0.5 * at.h();
        let mut defects = Slab::<States>::zeros(sizes, n, 1);
        for k in 0..n {
            let f = dynamics.f.state(k) + dynamics.f.state(k + 1);
            defects.set(k, &(at.x[k + 1] - at.x[k] - f * half_h));
        }
        Self {
            weight,
            weight_t: weights.t_f,
            gradient,
            gradient_t: weights.t_f * (at.t_f - reference.t_f),
            h: at.h(),
            dynamics,
            defects,
            start: problem.start - at.start(),
            target: problem
                .target
                .iter()
                .map(|row| TargetRow { value: -row.residual(at.end()), ..*row })
                .collect(),
            x: (1..=n)
                .map(|k| {
                    let (lowest, highest) = problem.bounds(k);
                    (lowest - at.x[k], highest - at.x[k])
                })
                .collect(),
            t: (problem.t_f.0 - at.t_f, problem.t_f.1 - at.t_f),
            torque: TorqueRows { jacobian, bounds },
            compliance: 0.0,
        }
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.start.sizes()
    }

    /// N, the number of collocation intervals.
    pub fn intervals(&self) -> usize {
        self.x.len()
    }

    /// The program of the knots `first` to `last` alone, a sub-horizon of Section IV: from the step `start` (in z) of
    /// its first knot to the target, if that is at its end. `t` is the change of its own duration; where an earlier part
    /// has decided on the whole duration by `dt` (s), `t` only follows.
    pub fn part(&self, (first, last): (usize, usize), start: &KnotVector, dt: Option<f64>) -> Self {
        /// Weight on what an earlier part has decided: it hardly gives way.
        const HELD: f64 = 1e9;
        let whole = self.intervals();
        let share = (last - first) as f64 / whole as f64;
        let mut part = Self {
            weight: self.weight.part(first..last + 1),
            weight_t: self.weight_t / (share * share),
            gradient: self.gradient.part(first..last + 1),
            gradient_t: self.gradient_t / share,
            h: self.h,
            dynamics: self.dynamics.part(first..last + 1),
            defects: self.defects.part(first..last),
            start: start.x(),
            target: if last == whole { self.target.clone() } else { Vec::new() },
            x: self.x[first..last].to_vec(),
            t: (self.t.0 * share, self.t.1 * share),
            torque: TorqueRows {
                jacobian: self.torque.jacobian.part(first..last + 1),
                bounds: self.torque.bounds[first..=last].to_vec(),
            },
            compliance: self.compliance,
        };
        if let Some(dt) = dt {
            part.weight_t = HELD;
            part.gradient_t = -HELD * dt * share;
            part.weight.u_mut(0).fill(HELD);
            part.gradient.u_mut(0).copy_from_slice(&(start.u() * -HELD));
        }
        part
    }
}

/// The bound that a solver could not keep together with all other constraints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConflictingBound {
    /// What is bounded.
    pub bound: Bound,
    /// Knot, 0 to N; of no meaning for the duration.
    pub knot: usize,
    /// Whether the upper one of the two bounds.
    pub upper: bool,
}

/// A quantity with bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// That of the joint of this index in sorted vectors.
    Joint(LimitKind, usize),
    /// t_F
    Duration,
}

impl std::fmt::Display for ConflictingBound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let side = if self.upper { "upper" } else { "lower" };
        match self.bound {
            Bound::Joint(kind, joint) => {
                write!(f, "the {side} {kind} limit of joint {} at knot {}", joint + 1, self.knot)
            }
            Bound::Duration => write!(f, "the {side} bound of the duration"),
        }
    }
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QpStatus {
    /// All residuals are within the tolerance.
    Solved,
    /// No point meets all constraints; names the limit that weighs most in the contradiction where the back end
    /// knows it.
    Infeasible(Option<ConflictingBound>),
    /// The deadline passed.
    Deadline,
    /// Stopped from outside.
    Cancelled,
    /// Neither solved nor found infeasible.
    Stalled(Stall),
}

impl std::fmt::Display for QpStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Solved => f.write_str("solved"),
            Self::Infeasible(_) => f.write_str("infeasible"),
            Self::Deadline => f.write_str("the deadline passed"),
            Self::Cancelled => f.write_str("cancelled"),
            Self::Stalled(stall) => stall.fmt(f),
        }
    }
}

/// Why a solver stopped before it knew the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stall {
    /// The linear system of a step could not be factorised.
    Factorisation,
    /// No step of noticeable length keeps slacks and multipliers above zero.
    ShortStep,
    /// Out of iterations.
    Iterations,
    /// Clarabel met its own, much larger, reduced tolerances and came no closer.
    Inaccurate,
    /// Clarabel could not set the program up, or met trouble with its numbers.
    Numerical,
}

impl std::fmt::Display for Stall {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Factorisation => "the linear system could not be factorised",
            Self::ShortStep => "the step length within the bounds became too small",
            Self::Iterations => "not solved within the largest number of iterations",
            Self::Inaccurate => "the solution is less accurate than required",
            Self::Numerical => "the solver failed numerically",
        })
    }
}

/// When a solver stops.
#[derive(Clone, Copy)]
pub struct QpOptions<'a> {
    /// Largest residual of a solution: constraints (positions, velocities, shares of half a torque range) and stationarity,
    /// relative to the largest multiplier where that is above one.
    pub tolerance: f64,
    /// Largest mean product of a distance to a bound and its multiplier. Where a bound is hardly active, an input u
    /// with the weight r is found to sqrt(complementarity / r).
    pub complementarity: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// No iteration is begun after this.
    pub deadline: Option<Instant>,
    /// Asked before each iteration, or by Clarabel before the first one only: whether to stop.
    pub cancelled: Option<&'a dyn Fn() -> bool>,
}

impl QpOptions<'_> {
    /// Why no further iteration may begin, if so.
    fn stop(&self) -> Option<QpStatus> {
        if self.cancelled.is_some_and(|cancelled| cancelled()) {
            return Some(QpStatus::Cancelled);
        }
        self.deadline.is_some_and(|d| Instant::now() >= d).then_some(QpStatus::Deadline)
    }

    /// With the given tolerance for everything, no deadline, and more iterations than any feasible QP seen has needed.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, complementarity: tolerance, max_iterations: 100, deadline: None, cancelled: None }
    }
}

/// The last iterate of a solve.
#[derive(Clone, Debug)]
pub struct QpSolution {
    /// dz_k, N + 1 of them.
    pub z: Slab<Knots>,
    /// dt, s.
    pub t: f64,
    /// Iterations of the solver.
    pub iterations: usize,
}

impl QpSolution {
    fn zeros(sizes: Sizes, n: usize) -> Self {
        Self { z: Slab::zeros(sizes, n + 1, 1), t: 0.0, iterations: 0 }
    }
}

/// Which back end solves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// See [`structured`].
    Structured,
    /// See <https://clarabel.org>.
    Clarabel,
}

/// A back end with its memory, to be used for one QP after the other.
#[derive(Clone, Debug)]
pub enum QpSolver {
    /// See [`structured`].
    Structured(Box<Structured>),
    /// See <https://clarabel.org>.
    Clarabel(Box<QpSolution>),
}

impl QpSolver {
    /// Allocates all that `backend` can keep between QPs of `n` intervals for a chain of these `sizes`; one of another size
    /// allocates again.
    pub fn new(backend: Backend, sizes: Sizes, n: usize) -> Self {
        match backend {
            Backend::Structured => Self::Structured(Box::new(Structured::new(sizes, n))),
            Backend::Clarabel => Self::Clarabel(Box::new(QpSolution::zeros(sizes, n))),
        }
    }

    /// Solves `qp` from scratch.
    pub fn solve(&mut self, qp: &Qp, options: &QpOptions<'_>) -> QpStatus {
        match self {
            Self::Structured(s) => s.solve(qp, false, options),
            Self::Clarabel(solution) => clarabel::solve(qp, options, solution),
        }
    }

    /// Solves `qp`, the linearisation around the solution of the QP before, from that one's multipliers where the
    /// back end can use them.
    pub fn solve_again(&mut self, qp: &Qp, options: &QpOptions<'_>) -> QpStatus {
        match self {
            Self::Structured(s) => s.solve(qp, true, options),
            Self::Clarabel(solution) => clarabel::solve(qp, options, solution),
        }
    }

    /// What the last solve left: the solution or, where there is none, the last iterate. No iterate of [`structured`] before
    /// it violates the constraints less: each step takes the same share of all their residuals away.
    pub fn solution(&self) -> &QpSolution {
        match self {
            Self::Structured(s) => s.solution(),
            Self::Clarabel(solution) => solution,
        }
    }
}
