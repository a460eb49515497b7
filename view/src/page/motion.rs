//! Samples of the motion in columns, as the scripts of both pages read them.

use serde::Serialize;
use upswing_ipc::Telemetry;
use upswing_model::Sizes;

/// Rounds `value` to a multiple of 1 / `per_unit`: digits that no screen shows would double the size of the page.
pub(super) fn round(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

/// Samples of the motion, one column per joint in the chain's order: rad, rad/s, N m, or m, m/s, N.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct MotionColumns {
    /// Times of the samples, s.
    t: Vec<f64>,
    q: Vec<Vec<f64>>,
    qd: Vec<Vec<f64>>,
    q_d: Vec<Vec<f64>>,
    qd_d: Vec<Vec<f64>>,
    /// Motor torques.
    tau: Vec<Vec<f64>>,
}

impl MotionColumns {
    /// Columns of a chain without samples.
    pub(crate) fn new(sizes: Sizes) -> Self {
        let columns = |n| vec![Vec::new(); n];
        Self {
            t: Vec::new(),
            q: columns(sizes.joints()),
            qd: columns(sizes.joints()),
            q_d: columns(sizes.joints()),
            qd_d: columns(sizes.joints()),
            tau: columns(sizes.actuated()),
        }
    }

    /// Appends a sample at time `t`, s.
    pub(crate) fn push(&mut self, t: f64, record: &Telemetry) {
        self.t.push(t);
        for (columns, values) in [
            (&mut self.q, &record.q[..]),
            (&mut self.qd, &record.qd),
            (&mut self.q_d, &record.q_d),
            (&mut self.qd_d, &record.qd_d),
            (&mut self.tau, &record.tau),
        ] {
            for (column, value) in columns.iter_mut().zip(values) {
                column.push(round(*value, 1e4));
            }
        }
    }
}
