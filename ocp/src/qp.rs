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

use crate::kkt::{KnotDynamics, KnotParts, KnotVector, TargetRow};
use crate::problem::{KnotDerivatives, Problem, TorqueConstraint};
use nalgebra::SMatrix;
use std::time::Instant;
use structured::Structured;
use upswing_model::{ActuatedVector, LimitKind, NU, NX, NZ, State, Workspace};
use upswing_trajectory::{N, Trajectory};

/// Linearised torque of one knot within its bounds: `lower` <= J dz <= `upper`, N m.
#[derive(Clone, Debug)]
pub struct TorqueRows {
    /// J = [d tau / dx, d tau / du].
    pub jacobian: SMatrix<f64, NU, NZ>,
    /// Lower bound less the torque of the linearisation point.
    pub lower: ActuatedVector,
    /// Upper bound less the torque of the linearisation point.
    pub upper: ActuatedVector,
}

/// The diagonal of Q (17), the same at every knot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QpWeights {
    /// Of t_F, 1/s^2.
    pub t_f: f64,
    /// Of z_k: 1/rad^2 for angles, s^2/rad^2 for velocities, s^4/rad^2 for inputs.
    pub z: KnotVector,
}

/// The program; angles in rad, times in s, torques in N m.
#[derive(Clone, Debug)]
pub struct Qp {
    /// Diagonal of Q at the knots, N + 1 of them.
    pub weight: Vec<KnotVector>,
    /// Q of t_F.
    pub weight_t: f64,
    /// g at the knots, N + 1 of them, and of t_F.
    pub gradient: Vec<KnotVector>,
    /// See `gradient`.
    pub gradient_t: f64,
    /// h = t_F / N of the linearisation point, s.
    pub h: f64,
    /// Gamma^x_k, Gamma^u_k and f_k, N + 1 of them.
    pub dynamics: Vec<KnotDynamics>,
    /// Defects (6b) of the linearisation point, N of them.
    pub defects: Vec<State>,
    /// dx_0 (15).
    pub start: State,
    /// Target rows, `value` less what the linearisation point has.
    pub target: Vec<TargetRow>,
    /// Bounds (lower, upper) of dx_1..dx_N.
    pub x: Vec<(State, State)>,
    /// Bounds of dt, s.
    pub t: (f64, f64),
    /// (9) or (11), N + 1 of them.
    pub torque: Vec<TorqueRows>,
    /// 0 for hard bounds. Else each bound (rad, rad/s, half ranges of the torque, s) may be exceeded by e at the
    /// cost e^2 / (2 `compliance`).
    pub compliance: f64,
}

impl Qp {
    /// (16) linearised around `at`, for the deviation from `reference`.
    pub fn new(
        problem: &Problem<'_>,
        reference: &Trajectory,
        at: &Trajectory,
        weights: &QpWeights,
        work: &mut Workspace,
    ) -> Self {
        let weight = &weights.z;
        let (tau_min, tau_max) = problem.torque.bounds(&problem.limits.tau_max);
        let mut dynamics = Vec::with_capacity(N + 1);
        let mut torque = Vec::with_capacity(N + 1);
        let mut gradient = Vec::with_capacity(N + 1);
        for k in 0..=N {
            let (x, u) = (&at.x[k], &at.u[k]);
            let knot = KnotDerivatives {
                dynamics: problem.model.derivatives(x, u, work),
                constraint: match problem.torque {
                    TorqueConstraint::Exact => None,
                    TorqueConstraint::WithoutCoriolis { .. } => {
                        Some(problem.model.derivatives_without_coriolis(x, u, work))
                    }
                },
            };
            dynamics.push(KnotDynamics::new(&knot.dynamics, x, u));
            let d = knot.torque();
            torque.push(TorqueRows {
                jacobian: SMatrix::<f64, NU, NZ>::from_fn(|i, j| {
                    if j < NX { d.tau_x[(i, j)] } else { d.tau_u[(i, j - NX)] }
                }),
                lower: tau_min - d.value.tau,
                upper: tau_max - d.value.tau,
            });
            let (dx, du) = (x - reference.x[k], u - reference.u[k]);
            gradient.push(KnotVector::from_fn(|i, _| weight[i] * if i < NX { dx[i] } else { du[i - NX] }));
        }
        let half_h = 0.5 * at.h();
        Self {
            weight: vec![*weight; N + 1],
            weight_t: weights.t_f,
            gradient,
            gradient_t: weights.t_f * (at.t_f - reference.t_f),
            h: at.h(),
            defects: (0..N)
                .map(|k| at.x[k + 1] - at.x[k] - (dynamics[k].f + dynamics[k + 1].f) * half_h)
                .collect(),
            dynamics,
            start: problem.start - at.x[0],
            target: problem
                .target
                .iter()
                .map(|row| TargetRow {
                    coefficients: row.coefficients,
                    value: row.value - row.coefficients.dot(&at.x[N]),
                })
                .collect(),
            x: (1..=N)
                .map(|k| {
                    let (lowest, highest) = problem.bounds(k);
                    (lowest - at.x[k], highest - at.x[k])
                })
                .collect(),
            t: (problem.t_f.0 - at.t_f, problem.t_f.1 - at.t_f),
            torque,
            compliance: 0.0,
        }
    }

    /// The program of the knots `first` to `last` alone, a sub-horizon of Section IV: from the step `start` (in z) of
    /// its first knot to the target, if that is at its end. `t` is the change of its own duration; where an earlier part
    /// has decided on the whole duration by `dt` (s), `t` only follows.
    pub fn part(&self, (first, last): (usize, usize), start: &KnotVector, dt: Option<f64>) -> Self {
        /// Weight on what an earlier part has decided: it hardly gives way.
        const HELD: f64 = 1e9;
        let whole = self.defects.len();
        let share = (last - first) as f64 / whole as f64;
        let mut part = Self {
            weight: self.weight[first..=last].to_vec(),
            weight_t: self.weight_t / (share * share),
            gradient: self.gradient[first..=last].to_vec(),
            gradient_t: self.gradient_t / share,
            h: self.h,
            dynamics: self.dynamics[first..=last].to_vec(),
            defects: self.defects[first..last].to_vec(),
            start: start.x().into(),
            target: if last == whole { self.target.clone() } else { Vec::new() },
            x: self.x[first..last].to_vec(),
            t: (self.t.0 * share, self.t.1 * share),
            torque: self.torque[first..=last].to_vec(),
            compliance: self.compliance,
        };
        if let Some(dt) = dt {
            part.weight_t = HELD;
            part.gradient_t = -HELD * dt * share;
            for i in NX..NZ {
                part.weight[0][i] = HELD;
                part.gradient[0][i] = -HELD * start[i];
            }
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
    /// That of a joint, counted from 0.
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
    /// Largest residual of a solution: constraints (rad, rad/s, shares of half a torque range) and stationarity,
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
    pub z: Vec<KnotVector>,
    /// dt, s.
    pub t: f64,
    /// Iterations of the solver.
    pub iterations: usize,
}

impl QpSolution {
    fn zeros(n: usize) -> Self {
        Self { z: vec![KnotVector::zeros(); n + 1], t: 0.0, iterations: 0 }
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
    /// Allocates all that `backend` can keep between QPs of `n` intervals; one of another size allocates again.
    pub fn new(backend: Backend, n: usize) -> Self {
        match backend {
            Backend::Structured => Self::Structured(Box::new(Structured::new(n))),
            Backend::Clarabel => Self::Clarabel(Box::new(QpSolution::zeros(n))),
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
