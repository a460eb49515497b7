//! QPs and their solutions as a file of doubles (little-endian) for a peer, `compare.py`.

use crate::solvers::MeasuredTime;
use upswing_ocp::qp::{Qp, QpSolution};

/// First N, the dimensions of state and input, and the number of target rows; then one record per QP, all of the same length, in the order of
/// [`QpFile::push`]. Matrices by rows.
#[derive(Default)]
pub struct QpFile(Vec<f64>);

impl QpFile {
    /// Adds a QP with the times and solutions of the structured solver and of Clarabel, and the solution that all others are compared with.
    pub fn push(&mut self, qp: &Qp, results: [(MeasuredTime, &QpSolution); 2], reference: &QpSolution) {
        let (out, sizes) = (&mut self.0, qp.sizes());
        if out.is_empty() {
            let head = [qp.intervals(), sizes.state(), sizes.actuated(), qp.target.len()];
            out.extend(head.map(|n| n as f64));
        }
        for (took, solution) in results {
            out.extend([took.cpu.as_secs_f64(), took.wall.as_secs_f64(), solution.iterations as f64]);
            out.extend(solution.z.vectors().flatten());
        }
        out.extend(reference.z.vectors().flatten());
        out.extend([qp.h, qp.weight_t, qp.gradient_t, qp.t.0, qp.t.1]);
        out.extend(qp.weight.vectors().chain(qp.gradient.vectors()).flatten());
        for k in 0..=qp.intervals() {
            // d qdd_U / dx, then d qdd_U / du.
            let rows = (0..sizes.unactuated()).map(|i| qp.dynamics.rows.row(k, i).split_at(sizes.state()));
            out.extend(rows.clone().flat_map(|(along_x, _)| along_x));
            out.extend(rows.flat_map(|(_, along_u)| along_u));
            out.extend(qp.dynamics.f.vector(k));
        }
        out.extend(qp.defects.vectors().flatten());
        out.extend(qp.start.iter());
        for row in &qp.target {
            out.extend(row.coefficients.iter());
            out.push(row.value);
        }
        out.extend(qp.x.iter().flat_map(|(lower, upper)| lower.iter().chain(upper.iter())));
        for (k, (lower, upper)) in qp.torque.bounds.iter().enumerate() {
            out.extend((0..sizes.actuated()).flat_map(|i| qp.torque.jacobian.row(k, i)));
            out.extend(lower.iter().chain(upper.iter()));
        }
    }

    /// The file.
    pub fn bytes(&self) -> Vec<u8> {
        self.0.iter().flat_map(|v| v.to_le_bytes()).collect()
    }
}
