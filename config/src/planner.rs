//! Settings of the planner, `planner.toml`.

use crate::RobotSettings;
use crate::conflict::SettingsConflict;
use crate::rule::{BetweenZeroAndOne, MotionTime, Positive, Rule, ShareBelowOne, Whole, refused};
use serde::{Deserialize, Deserializer};
use std::time::Duration;
use upswing_model::{ActuatedVector, JointVector};
use upswing_trajectory::INTERVALS;

/// Settings of the planner.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannerSettings {
    /// Trajectory optimisation for the database.
    pub offline: OfflineSettings,
    /// Replanning from a measured start.
    pub replan: ReplanSettings,
    /// Continuous replanning while a plan is tracked.
    pub continuous: ContinuousSettings,
    /// Weights of the trajectory controller.
    pub lqr: LqrSettings,
    /// Weights of the gain of the mode Balance.
    pub balance: BalanceSettings,
}

/// Settings of the trajectory optimisation (6), (8) with (9) or (11).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OfflineSettings {
    /// N, number of collocation intervals of every trajectory.
    #[serde(deserialize_with = "Whole::<{ *INTERVALS.start() as i64 }, { *INTERVALS.end() as i64 }>::read")]
    pub intervals: usize,
    /// r of R = r I in (6a), s^4/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub input_weight: f64,
    /// Shortest duration t_F, s.
    #[serde(rename = "t_f_min_s", deserialize_with = "MotionTime::read")]
    pub t_f_min: f64,
    /// Longest duration t_F, s.
    #[serde(rename = "t_f_max_s", deserialize_with = "MotionTime::read")]
    pub t_f_max: f64,
    /// Form of the torque constraint.
    pub torque: TorqueForm,
    /// Largest scaled residual of a solution, no unit.
    #[serde(deserialize_with = "BetweenZeroAndOne::read")]
    pub tolerance: f64,
    /// Largest number of iterations.
    #[serde(deserialize_with = "Whole::<1, 1_000_000>::read")]
    pub max_iterations: usize,
}

/// Form of the torque constraint: with the Coriolis torques or without.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TorqueForm {
    /// (9), with the Coriolis torques.
    Exact,
    /// (11), without the Coriolis torques but tightened by their bound c.
    Paper,
}

/// Settings of replanning by quadratic programs, (14)-(17).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplanSettings {
    /// Largest number of linearisations per replan, each around the previous solution; 1 as in the paper.
    #[serde(deserialize_with = "Whole::<1, 1000>::read")]
    pub iterations: usize,
    /// Largest defect of (6b) with the nonlinear dynamics at which the linearisations end, rad and rad/s per interval.
    #[serde(deserialize_with = "BetweenZeroAndOne::read")]
    pub defect: f64,
    /// Margin of the limits at the knots, as a share of the range of each limit, of entries and of plans.
    #[serde(deserialize_with = "ShareBelowOne::read")]
    pub knot_margin: f64,
    /// Form of the torque constraint (16c).
    pub torque: TorqueForm,
    /// Number of sub-horizons, solved one after the other, one of [`SUB_HORIZONS`]; 1: the whole horizon at once.
    #[serde(deserialize_with = "sub_horizons")]
    pub sub_horizons: usize,
    /// Time from a request to the start of its plan while the pendulum moves.
    #[serde(rename = "lead_ms", deserialize_with = "Whole::<0, 1000>::millis")]
    pub lead: Duration,
    /// Solver of the quadratic programs.
    pub backend: QpBackend,
    /// Share of the duration of an entry by which the duration in (17) is shorter; 0 as in the paper.
    #[serde(deserialize_with = "ShareBelowOne::read")]
    pub shortening: f64,
    /// Weight of the duration in the diagonal of Q, (17), 1/s^2.
    #[serde(deserialize_with = "Positive::read")]
    pub weight_t_f: f64,
    /// Weights of the positions in the diagonal of Q, the same at every knot, 1/rad^2 or 1/m^2.
    #[serde(deserialize_with = "Positive::read")]
    pub weight_q: JointVector,
    /// Weights of the velocities in the diagonal of Q, the same at every knot, s^2/rad^2 or s^2/m^2.
    #[serde(deserialize_with = "Positive::read")]
    pub weight_qd: JointVector,
    /// Weights of the inputs in the diagonal of Q, the same at every knot, s^4/rad^2 or s^4/m^2.
    #[serde(deserialize_with = "Positive::read")]
    pub weight_u: ActuatedVector,
    /// Number of nearest database entries that a replan tries.
    #[serde(deserialize_with = "Whole::<1, 1000>::read")]
    pub neighbours: usize,
    /// Weight of each actuated joint in the squared distance between start poses, no unit.
    #[serde(deserialize_with = "Positive::read")]
    pub metric: ActuatedVector,
}

/// Numbers of sub-horizons to choose from.
pub const SUB_HORIZONS: [usize; 5] = [1, 2, 4, 5, 10];

fn sub_horizons<'de, D: Deserializer<'de>>(from: D) -> Result<usize, D::Error> {
    let value = i64::deserialize(from)?;
    SUB_HORIZONS
        .into_iter()
        .find(|n| *n as i64 == value)
        .ok_or_else(|| refused(format!("one of {SUB_HORIZONS:?}"), value))
}

/// Solver of the quadratic programs of a replan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum QpBackend {
    /// The interior-point method that exploits the stages of (16).
    Structured,
    /// Clarabel, a general sparse solver.
    Clarabel,
}

/// Settings of continuous replanning: the rest of a running plan is planned again and again from the newest state.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContinuousSettings {
    /// Whether studies replan while a plan is tracked.
    pub enabled: bool,
    /// Time from one replan to the next.
    #[serde(rename = "period_ms", deserialize_with = "Whole::<1, 1000>::millis")]
    pub period: Duration,
    /// Time from the measured state to the activation of the plan that follows from it.
    #[serde(rename = "lead_ms", deserialize_with = "Whole::<1, 1000>::millis")]
    pub lead: Duration,
    /// Shortest rest of a plan, from the activation to t_F, that is planned again, s.
    #[serde(rename = "shortest_rest_s", deserialize_with = "MotionTime::read")]
    pub shortest_rest: f64,
}

/// Settings of the LQR along a trajectory: its weights Q_c and R_c of (20), and its recursion (23).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LqrSettings {
    /// Weight of all angles, 1/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub q_angles: f64,
    /// Weight of the velocities of the actuated joints, s^2/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub q_velocities_actuated: f64,
    /// Weight of the velocities of the unactuated joints, s^2/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub q_velocities_unactuated: f64,
    /// r of R_c = r I, s^4/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub r: f64,
    /// How (23) is computed.
    pub recursion: LqrRecursion,
}

/// How the recursion (23) is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LqrRecursion {
    /// From a few longer periods, extrapolated to the control period.
    Extrapolated,
    /// With the control period.
    Periods,
}

/// Settings of the LQR gain of the mode Balance, which holds x_N: its weights, which replace those of [`LqrSettings`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceSettings {
    /// Weight of the angles of the actuated joints, 1/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub q_angles_actuated: f64,
    /// Weight of the angles of the unactuated joints, 1/rad^2.
    #[serde(deserialize_with = "Positive::read")]
    pub q_angles_unactuated: f64,
}

impl PlannerSettings {
    /// Checks the rules between the settings of the planner, and between them and those of the robot.
    pub(crate) fn validate(&self, robot: &RobotSettings) -> Result<(), SettingsConflict> {
        for (key, torque) in [("offline.torque", self.offline.torque), ("replan.torque", self.replan.torque)]
        {
            if torque == TorqueForm::Paper && robot.coriolis_bound.is_none() {
                return Err(SettingsConflict::new(
                    key,
                    "\"exact\", because robot.toml has no [coriolis_bound]",
                    "\"paper\"",
                    "change it, or state the bound that `upswing model bound` determines",
                ));
            }
        }
        let OfflineSettings { intervals, t_f_min, t_f_max, .. } = self.offline;
        let sub_horizons = self.replan.sub_horizons;
        if !intervals.is_multiple_of(sub_horizons) {
            let expected = format!("a number that divides the {intervals} of offline.intervals evenly");
            return Err(SettingsConflict::new(
                "replan.sub_horizons",
                expected,
                sub_horizons,
                "change one of both",
            ));
        }
        SettingsConflict::unless_above("offline.t_f_max_s", t_f_max, t_f_min, "offline.t_f_min_s")
    }
}
