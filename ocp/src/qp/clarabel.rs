//! Clarabel as a back end: the QP as one sparse matrix.

use super::{Qp, QpOptions, QpSolution, QpStatus, Stall};
use crate::kkt::Dynamics;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, SolverStatus,
    SupportedConeT::{NonnegativeConeT, ZeroConeT},
};

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
    fn put_dynamics(&mut self, dynamics: &Dynamics, k: usize, i: usize, scale: f64) {
        let sizes = dynamics.sizes();
        let (joints, actuated, at) = (sizes.joints(), sizes.actuated(), k * sizes.knot());
        if i < joints + actuated {
            // qd of q, and u of qd_A.
            self.put(at + joints + i, scale);
        } else {
            self.put_row(at, dynamics.rows.row(k, i - joints - actuated), scale);
        }
    }

    /// Coefficients `scale` times `row` from the column `at` on.
    fn put_row(&mut self, at: usize, row: &[f64], scale: f64) {
        row.iter().enumerate().for_each(|(j, v)| self.put(at + j, scale * v));
    }
}

/// Solves the QP from scratch.
pub(super) fn solve(qp: &Qp, options: &QpOptions<'_>, solution: &mut QpSolution) -> QpStatus {
    let (sizes, n) = (qp.sizes(), qp.intervals());
    let (state, knot) = (sizes.state(), sizes.knot());
    // Variables: z_0..z_n, dt and, where bounds yield, by how much each of them does.
    let t = (n + 1) * knot;
    let soft = if qp.compliance > 0.0 { 2 * (n * state + (n + 1) * sizes.actuated() + 1) } else { 0 };
    let variables = t + 1 + soft;
    *solution = QpSolution::zeros(sizes, n);
    if let Some(status) = options.stop() {
        return status;
    }
    let mut weights = Vec::with_capacity(variables);
    let mut gradient = Vec::with_capacity(variables);
    for (weight, g) in qp.weight.vectors().zip(qp.gradient.vectors()) {
        weights.extend(weight);
        gradient.extend(g);
    }
    weights.push(qp.weight_t);
    gradient.push(qp.gradient_t);
    weights.resize(variables, 1.0 / qp.compliance);
    gradient.resize(variables, 0.0);
    let hessian =
        CscMatrix::new(variables, variables, (0..=variables).collect(), (0..variables).collect(), weights);

    let mut rows = SparseRows::default();
    let half_h = 0.5 * qp.h;
    for i in 0..state {
        rows.put(i, 1.0);
        rows.end(qp.start[i]);
    }
    for k in 0..n {
        let (near, far) = (qp.dynamics.f.vector(k), qp.dynamics.f.vector(k + 1));
        for i in 0..state {
            rows.put((k + 1) * knot + i, 1.0);
            rows.put(k * knot + i, -1.0);
            rows.put_dynamics(&qp.dynamics, k, i, -half_h);
            rows.put_dynamics(&qp.dynamics, k + 1, i, -half_h);
            rows.put(t, -(near[i] + far[i]) / (2 * n) as f64);
            rows.end(-qp.defects.vector(k)[i]);
        }
    }
    for target in &qp.target {
        rows.put_row(n * knot, &target.coefficients, 1.0);
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
        for i in 0..state {
            for (sign, bound) in [(1.0, upper[i]), (-1.0, -lower[i])] {
                rows.put((k + 1) * knot + i, sign);
                end_bound(&mut rows, bound);
            }
        }
    }
    for (k, (lower, upper)) in qp.torque.bounds.iter().enumerate() {
        for i in 0..sizes.actuated() {
            for (sign, bound) in [(1.0, upper[i]), (-1.0, -lower[i])] {
                // In units of half the range, so that the row has entries near one.
                let scale = 2.0 * sign / (upper[i] - lower[i]);
                rows.put_row(k * knot, qp.torque.jacobian.row(k, i), scale);
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
    for (k, z) in found.x[..t].chunks_exact(knot).enumerate() {
        solution.z.vector_mut(k).copy_from_slice(z);
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
