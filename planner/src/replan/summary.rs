//! Figures of a plan for reports and studies.

use super::Replan;
use serde::{Deserialize, Serialize};
use upswing_trajectory::Margins;

/// Summary of a replan, without its t_F.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlanSummary {
    /// Index of the nearest database entry, from which the plan was adapted; none without a database.
    pub nearest_entry: Option<usize>,
    /// Distance of the start from that entry, rad.
    pub distance: Option<f64>,
    /// Number of entries tried.
    pub attempts: usize,
    /// Number of QPs, each linearised around the previous result.
    pub iterations: usize,
    /// Defect of the nonlinear dynamics, rad or rad/s per interval.
    pub defect: f64,
    /// Smallest margins of the plan.
    #[serde(flatten)]
    pub margins: MarginShares,
}

impl From<&Replan> for PlanSummary {
    fn from(replan: &Replan) -> Self {
        Self {
            nearest_entry: replan.entry.map(|entry| entry.index),
            distance: replan.entry.map(|entry| entry.distance),
            attempts: replan.failed.len() + 1,
            iterations: replan.iterations,
            defect: replan.defect,
            margins: (&replan.margins).into(),
        }
    }
}

/// Smallest margins to the limits as shares of half the range; negative: violated.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct MarginShares {
    /// Smallest margin of the positions.
    pub margin_q: f64,
    /// Smallest margin of the velocities.
    pub margin_qd: f64,
    /// Smallest margin of the torques.
    pub margin_tau: f64,
}

impl From<&Margins> for MarginShares {
    fn from(m: &Margins) -> Self {
        Self { margin_q: m.q.share, margin_qd: m.qd.share, margin_tau: m.tau.share }
    }
}

impl std::fmt::Display for MarginShares {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { margin_q, margin_qd, margin_tau } = self;
        write!(f, "position {margin_q:.3}, velocity {margin_qd:.3}, torque {margin_tau:.3}")
    }
}
