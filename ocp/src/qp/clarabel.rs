//! Clarabel as a back end: the QP as one sparse matrix.

use super::{Qp, QpOptions, QpSolution, QpStatus, Stall};
use crate::kkt::KnotDynamics;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, SolverStatus,
    SupportedConeT::{NonnegativeConeT, ZeroConeT},
};
use upswing_model::{N_UNACTUATED, NQ, NU, NX, NZ};

/// Rows of A z + s = b, as triplets.
#[derive(Default)]
struct SparseRows {
    row: Vec<usize>,
    column: Vec<usize>,
    value: Vec<f64>,
    bound: Vec<f64>,
}

impl SparseRows {
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
        } else if i < NQ + NU {
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

/// Solves the QP from scratch.
pub(super) fn solve(qp: &Qp, options: &QpOptions<'_>, solution: &mut QpSolution) -> QpStatus {
    let n = qp.defects.len();
    // Variables: z_0..z_n, dt and, where bounds yield, by how much each of them does.
    let t = (n + 1) * NZ;
    let soft = if qp.compliance > 0.0 { 2 * (n * NX + (n + 1) * NU + 1) } else { 0 };
    let variables = t + 1 + soft;
    *solution = QpSolution::zeros(n);
    if let Some(status) = options.stop() {
        return status;
    }
    let mut weights = Vec::with_capacity(variables);
    let mut gradient = Vec::with_capacity(variables);
    for (weight, g) in qp.weight.iter().zip(&qp.gradient) {
        weights.extend(weight.iter());
        gradient.extend(g.iter());
    }
    weights.push(qp.weight_t);
    gradient.push(qp.gradient_t);
    weights.resize(variables, 1.0 / qp.compliance);
    gradient.resize(variables, 0.0);
    let hessian =
        CscMatrix::new(variables, variables, (0..=variables).collect(), (0..variables).collect(), weights);

    let mut rows = SparseRows::default();
    let half_h = 0.5 * qp.h;
    for i in 0..NX {
        rows.put(i, 1.0);
        rows.end(qp.start[i]);
    }
    for k in 0..n {
        let (near, far) = (&qp.dynamics[k], &qp.dynamics[k + 1]);
        for i in 0..NX {
            rows.put((k + 1) * NZ + i, 1.0);
            rows.put(k * NZ + i, -1.0);
            rows.put_dynamics(near, k, i, -half_h);
            rows.put_dynamics(far, k + 1, i, -half_h);
            rows.put(t, -(near.f[i] + far.f[i]) / (2 * n) as f64);
            rows.end(-qp.defects[k][i]);
        }
    }
    for target in &qp.target {
        for i in 0..NX {
            rows.put(n * NZ + i, target.coefficients[i]);
        }
        rows.end(target.value);
    }
    let equalities = rows.bound.len();
    let end_bound = |rows: &mut SparseRows, bound: f64| {
        if soft > 0 {
            rows.put(t + 1 + rows.bound.len() - equalities, -1.0);
        }
        rows.end(bound);
    };
    for (k, (lower, upper)) in qp.x.iter().enumerate() {
        for i in 0..NX {
            for (sign, bound) in [(1.0, upper[i]), (-1.0, -lower[i])] {
                rows.put((k + 1) * NZ + i, sign);
                end_bound(&mut rows, bound);
            }
        }
    }
    for (k, torque) in qp.torque.iter().enumerate() {
        for i in 0..NU {
            for (sign, bound) in [(1.0, torque.upper[i]), (-1.0, -torque.lower[i])] {
                // In units of half the range, so that the row has entries near one.
                let scale = 2.0 * sign / (torque.upper[i] - torque.lower[i]);
                for j in 0..NZ {
                    rows.put(k * NZ + j, scale * torque.jacobian[(i, j)]);
                }
                end_bound(&mut rows, bound * scale.abs());
            }
        }
    }
    for (sign, bound) in [(1.0, qp.t.1), (-1.0, -qp.t.0)] {
        rows.put(t, sign);
        end_bound(&mut rows, bound);
    }
    let cones = [ZeroConeT(equalities), NonnegativeConeT(rows.bound.len() - equalities)];
    let matrix = CscMatrix::new_from_triplets(rows.bound.len(), variables, rows.row, rows.column, rows.value);
    // The gap is the sum of all products of slack and multiplier.
    let gap = options.complementarity * (rows.bound.len() - equalities) as f64;
    let time_limit = options
        .deadline
        .map_or(f64::INFINITY, |d| d.saturating_duration_since(std::time::Instant::now()).as_secs_f64());
    let settings = DefaultSettings {
        verbose: false,
        time_limit,
        max_iter: u32::try_from(options.max_iterations).unwrap_or(u32::MAX),
        tol_gap_abs: gap,
        tol_gap_rel: gap,
        tol_feas: options.tolerance,
        ..DefaultSettings::default()
    };
    let Ok(mut solver) = DefaultSolver::new(&hessian, &gradient, &matrix, &rows.bound, &cones, settings)
    else {
        return QpStatus::Stalled(Stall::Numerical);
    };
    solver.solve();
    let found = &solver.solution;
    for (z, found) in solution.z.iter_mut().zip(found.x[..t].chunks_exact(NZ)) {
        z.copy_from_slice(found);
    }
    solution.t = found.x[t];
    solution.iterations = found.iterations as usize;
    match found.status {
        SolverStatus::Solved => QpStatus::Solved,
        SolverStatus::AlmostSolved => QpStatus::Stalled(Stall::Inaccurate),
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => QpStatus::Infeasible(None),
        SolverStatus::MaxTime => QpStatus::Deadline,
        SolverStatus::MaxIterations => QpStatus::Stalled(Stall::Iterations),
        SolverStatus::InsufficientProgress => QpStatus::Stalled(Stall::ShortStep),
        _ => QpStatus::Stalled(Stall::Numerical),
    }
}
