//! The quadratic program of a replan (16), in stages, and its solution by Clarabel.

use crate::kkt::{KnotDynamics, KnotVector, TargetRow};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, SolverStatus,
    SupportedConeT::{NonnegativeConeT, ZeroConeT},
};
use nalgebra::SMatrix;
use upswing_model::{ActuatedVector, N_ACTUATED, N_UNACTUATED, NQ, NU, NX, NZ, State};
use upswing_trajectory::N;

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

/// min 1/2 dxi' Q dxi + g' dxi over dxi = (dt, dz_0..dz_N), dz_k = (dx_k, du_k), subject to (14), (15), bounds of
/// dx_k (k >= 1) and dt, and the torque rows. Angles in rad, times in s.
#[derive(Clone, Debug)]
pub struct Qp {
    /// Diagonal of Q at a knot.
    pub weight: KnotVector,
    /// Q of t_F.
    pub weight_t: f64,
    /// g at the knots and of t_F.
    pub gradient: Vec<KnotVector>,
    /// See `gradient`.
    pub gradient_t: f64,
    /// h = t_F / N of the linearisation point, s.
    pub h: f64,
    /// Gamma^x_k, Gamma^u_k and f_k.
    pub dynamics: Vec<KnotDynamics>,
    /// Defects (6b) of the linearisation point.
    pub defects: Vec<State>,
    /// dx_0 (15).
    pub start: State,
    /// Target rows, `value` less what the linearisation point has.
    pub target: Vec<TargetRow>,
    /// Bounds of dx_1..dx_N.
    pub x: Vec<(State, State)>,
    /// Bounds of dt.
    pub t: (f64, f64),
    /// (9) or (11).
    pub torque: Vec<TorqueRows>,
}

/// Why a QP has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QpError {
    /// No point meets all constraints.
    #[error("the constraints of the QP cannot be met together")]
    Infeasible,
    /// The solver gave up.
    #[error("the QP solver stopped early: {0:?}")]
    Stopped(SolverStatus),
}

/// Solution of a [`Qp`].
#[derive(Clone, Debug)]
pub struct QpSolution {
    /// dz_k
    pub z: Vec<KnotVector>,
    /// dt
    pub t: f64,
    /// Iterations of the solver.
    pub iterations: u32,
}

/// Index of dt among the variables.
const T: usize = (N + 1) * NZ;

/// Rows of A z + s = b, as triplets.
#[derive(Default)]
struct Rows {
    row: Vec<usize>,
    column: Vec<usize>,
    value: Vec<f64>,
    bound: Vec<f64>,
}

impl Rows {
    fn put(&mut self, column: usize, value: f64) {
        if value != 0.0 {
            self.row.push(self.bound.len());
            self.column.push(column);
            self.value.push(value);
        }
    }

    fn end(&mut self, bound: f64) {
        self.bound.push(bound);
    }

    /// Coefficients of row i of `scale` (A dx + B du) at knot k.
    fn put_dynamics(&mut self, knot: &KnotDynamics, k: usize, i: usize, scale: f64) {
        let at = k * NZ;
        if i < NQ {
            self.put(at + NQ + i, scale);
        } else if i < NQ + N_ACTUATED {
            self.put(at + NX + i - NQ, scale);
        } else {
            let m = i - (NX - N_UNACTUATED);
            for j in 0..NX {
                self.put(at + j, scale * knot.qdd_u_x[(m, j)]);
            }
            for j in 0..NU {
                self.put(at + NX + j, scale * knot.qdd_u_u[(m, j)]);
            }
        }
    }
}

/// Solves the QP with Clarabel to the relative accuracy `tolerance`.
///
/// # Errors
/// [`QpError`] if the constraints contradict each other or the solver gives up.
pub fn solve(qp: &Qp, tolerance: f64) -> Result<QpSolution, QpError> {
    let variables = T + 1;
    let mut weights = Vec::with_capacity(variables);
    let mut gradient = Vec::with_capacity(variables);
    for g in &qp.gradient {
        weights.extend(qp.weight.iter());
        gradient.extend(g.iter());
    }
    weights.push(qp.weight_t);
    gradient.push(qp.gradient_t);
    let hessian =
        CscMatrix::new(variables, variables, (0..=variables).collect(), (0..variables).collect(), weights);

    let mut rows = Rows::default();
    let half_h = 0.5 * qp.h;
    for i in 0..NX {
        rows.put(i, 1.0);
        rows.end(qp.start[i]);
    }
    for k in 0..N {
        let (near, far) = (&qp.dynamics[k], &qp.dynamics[k + 1]);
        for i in 0..NX {
            rows.put((k + 1) * NZ + i, 1.0);
            rows.put(k * NZ + i, -1.0);
            rows.put_dynamics(near, k, i, -half_h);
            rows.put_dynamics(far, k + 1, i, -half_h);
            rows.put(T, -(near.f[i] + far.f[i]) / (2 * N) as f64);
            rows.end(-qp.defects[k][i]);
        }
    }
    for target in &qp.target {
        for i in 0..NX {
            rows.put(N * NZ + i, target.coefficients[i]);
        }
        rows.end(target.value);
    }
    let equalities = rows.bound.len();
    for (k, (lower, upper)) in qp.x.iter().enumerate() {
        for i in 0..NX {
            rows.put((k + 1) * NZ + i, 1.0);
            rows.end(upper[i]);
            rows.put((k + 1) * NZ + i, -1.0);
            rows.end(-lower[i]);
        }
    }
    for (k, torque) in qp.torque.iter().enumerate() {
        for i in 0..NU {
            for (sign, bound) in [(1.0, torque.upper[i]), (-1.0, -torque.lower[i])] {
                // Scaled so that the row has entries near one.
                let scale = sign / (torque.upper[i] - torque.lower[i]);
                for j in 0..NZ {
                    rows.put(k * NZ + j, scale * torque.jacobian[(i, j)]);
                }
                rows.end(bound * scale.abs());
            }
        }
    }
    for (sign, bound) in [(1.0, qp.t.1), (-1.0, -qp.t.0)] {
        rows.put(T, sign);
        rows.end(bound);
    }
    let cones = [ZeroConeT(equalities), NonnegativeConeT(rows.bound.len() - equalities)];
    let matrix = CscMatrix::new_from_triplets(rows.bound.len(), variables, rows.row, rows.column, rows.value);
    let settings = DefaultSettings {
        verbose: false,
        tol_gap_abs: tolerance,
        tol_gap_rel: tolerance,
        tol_feas: tolerance,
        ..DefaultSettings::default()
    };
    let mut solver = DefaultSolver::new(&hessian, &gradient, &matrix, &rows.bound, &cones, settings)
        .map_err(|_| QpError::Stopped(SolverStatus::Unsolved))?;
    solver.solve();
    let solution = &solver.solution;
    match solution.status {
        SolverStatus::Solved | SolverStatus::AlmostSolved => Ok(QpSolution {
            z: solution.x[..T].chunks_exact(NZ).map(KnotVector::from_column_slice).collect(),
            t: solution.x[T],
            iterations: solution.iterations,
        }),
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Err(QpError::Infeasible),
        other => Err(QpError::Stopped(other)),
    }
}
