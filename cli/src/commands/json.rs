//! Types of JSON output that several commands share.

use serde::Serialize;
use upswing_trajectory::Trajectory;

/// A trajectory as JSON: t_F in s, x (KNOTS x NX) in rad and rad/s, u (KNOTS x NU) in rad/s^2.
#[derive(Clone, Debug, Serialize)]
pub struct TrajectoryJson {
    /// t_F, s.
    pub t_f: f64,
    /// States x_k at the knots, rad and rad/s.
    pub x: Vec<Vec<f64>>,
    /// Inputs u_k, rad/s^2.
    pub u: Vec<Vec<f64>>,
}

impl From<&Trajectory> for TrajectoryJson {
    fn from(t: &Trajectory) -> Self {
        Self {
            t_f: t.t_f,
            x: t.x.iter().map(|x| x.iter().copied().collect()).collect(),
            u: t.u.iter().map(|u| u.iter().copied().collect()).collect(),
        }
    }
}
