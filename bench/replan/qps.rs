//! QPs and their solutions as a file of doubles (little-endian) for a peer, `compare.py`.

use crate::solvers::MeasuredTime;
use upswing_model::{NU, NX};
use upswing_ocp::qp::{Qp, QpSolution};
use upswing_trajectory::N;

/// First N, NX, NU and the number of target rows; then one record per QP, all of the same length, in the order of
/// [`QpFile::push`]. Matrices by rows.
#[derive(Default)]
pub struct QpFile(Vec<f64>);

impl QpFile {
    /// Adds a QP with the times and solutions of the structured solver and of Clarabel.
    pub fn push(&mut self, qp: &Qp, results: [(MeasuredTime, &QpSolution); 2]) {
        let out = &mut self.0;
        if out.is_empty() {
            out.extend([N, NX, NU, qp.target.len()].map(|n| n as f64));
        }
        for (took, solution) in results {
            out.extend([took.cpu.as_secs_f64(), took.wall.as_secs_f64(), solution.iterations as f64]);
            out.extend(solution.z.iter().flat_map(|z| z.iter()));
            out.push(solution.t);
        }
        out.extend([qp.h, qp.weight_t, qp.gradient_t, qp.t.0, qp.t.1]);
        out.extend(qp.weight.iter().chain(&qp.gradient).flat_map(|v| v.iter()));
        for knot in &qp.dynamics {
            out.extend(knot.qdd_u_x.transpose().iter());
            out.extend(knot.qdd_u_u.transpose().iter());
            out.extend(knot.f.iter());
        }
        out.extend(qp.defects.iter().flat_map(|r| r.iter()));
        out.extend(qp.start.iter());
        for row in &qp.target {
            out.extend(row.coefficients.iter());
            out.push(row.value);
        }
        out.extend(qp.x.iter().flat_map(|(lower, upper)| lower.iter().chain(upper.iter())));
        for torque in &qp.torque {
            out.extend(torque.jacobian.transpose().iter());
            out.extend(torque.lower.iter().chain(torque.upper.iter()));
        }
    }

    /// The file.
    pub fn bytes(&self) -> Vec<u8> {
        self.0.iter().flat_map(|v| v.to_le_bytes()).collect()
    }
}
