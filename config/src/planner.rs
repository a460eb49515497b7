//! `planner.toml`.

use crate::ConfigError;
use crate::check::{BELOW_ONE, Check, DURATION, PART, POSITIVE};
use serde::Deserialize;
use std::time::Duration;
use upswing_model::{NQ, NU};

/// How swing-ups are computed.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannerSettings {
    /// Trajectory optimisation for the database.
    pub offline: OfflineSettings,
    /// Replanning from a measured start.
    pub replan: ReplanSettings,
    /// Weights of the trajectory controller.
    pub lqr: LqrWeights,
    /// What is different for the gain that balances.
    pub balance: BalanceWeights,
}

/// Trajectory optimisation (6), (8) with (9) or (11).
#[derive(Clone, Debug, PartialEq)]
pub struct OfflineSettings {
    /// r of R = r I in (6a), s^4/rad^2.
    pub input_weight: f64,
    /// Shortest duration t_F, s.
    pub t_f_min: f64,
    /// Longest duration t_F, s.
    pub t_f_max: f64,
    /// Form of the torque constraint.
    pub torque: TorqueConstraint,
    /// Largest scaled residual of a solution, no unit.
    pub tolerance: f64,
    /// Iterations before giving up.
    pub max_iterations: usize,
}

/// Form of the torque constraint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TorqueConstraint {
    /// (9), with the Coriolis torques.
    Exact,
    /// (11), without them but tightened by their bound c.
    Paper,
}

/// Replanning by quadratic programs, (14)-(17).
#[derive(Clone, Debug, PartialEq)]
pub struct ReplanSettings {
    /// Most linearisations per replan, each around the result before; 1 is the paper's mode.
    pub iterations: usize,
    /// Largest component of (6b) on the real dynamics (rad, rad/s per interval) at which no further linearisation is
    /// needed.
    pub defect: f64,
    /// Share of the range of each limit that stays free at the knots.
    pub knot_margin: f64,
    /// Torque constraint of (16c).
    pub torque: TorqueConstraint,
    /// Sub-horizons that are solved one after the other, one of [`SUB_HORIZONS`]; 1 is the whole horizon.
    pub sub_horizons: usize,
    /// From the request to the start of a plan that begins with a moving pendulum.
    pub lead: Duration,
    /// Diagonal of Q, (17).
    pub weights: ReplanWeights,
    /// Solver of the quadratic programs.
    pub backend: QpBackend,
    /// How many of the nearest database entries are tried.
    pub neighbours: usize,
    /// Weight of each actuated joint in the squared distance between start poses, no unit.
    pub metric: [f64; NU],
}

/// Solver of the quadratic programs of a replan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum QpBackend {
    /// The interior-point method that knows the stages of (16).
    Structured,
    /// Clarabel, a general sparse solver.
    Clarabel,
}

/// Diagonal of Q in (17), the same at every knot.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplanWeights {
    /// Duration, 1/s^2.
    pub t_f: f64,
    /// Angles, 1/rad^2.
    pub q: [f64; NQ],
    /// Velocities, s^2/rad^2.
    pub qd: [f64; NQ],
    /// Inputs, s^4/rad^2.
    pub u: [f64; NU],
}

/// Weights Q_c and R_c of (20).
#[derive(Clone, Debug, PartialEq)]
pub struct LqrWeights {
    /// All angles, 1/rad^2.
    pub q_angles: f64,
    /// Velocities of the actuated joints, s^2/rad^2.
    pub q_velocities_actuated: f64,
    /// Velocities of the unactuated joints, s^2/rad^2.
    pub q_velocities_unactuated: f64,
    /// r of R_c = r I, s^4/rad^2.
    pub r: f64,
}

/// The gain that holds x_N, where it differs from [`LqrWeights`].
#[derive(Clone, Debug, PartialEq)]
pub struct BalanceWeights {
    /// Angles of the actuated joints, 1/rad^2.
    pub q_angles_actuated: f64,
    /// Angles of the unactuated joints, 1/rad^2.
    pub q_angles_unactuated: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    offline: RawOffline,
    replan: RawReplan,
    lqr: RawLqr,
    balance: RawBalance,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawOffline {
    input_weight: f64,
    t_f_min_s: f64,
    t_f_max_s: f64,
    torque: TorqueConstraint,
    tolerance: f64,
    max_iterations: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawReplan {
    iterations: i64,
    defect: f64,
    knot_margin: f64,
    torque: TorqueConstraint,
    sub_horizons: i64,
    lead_ms: i64,
    backend: QpBackend,
    weight_t_f: f64,
    weight_q: Vec<f64>,
    weight_qd: Vec<f64>,
    weight_u: Vec<f64>,
    neighbours: i64,
    metric: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLqr {
    q_angles: f64,
    q_velocities_actuated: f64,
    q_velocities_unactuated: f64,
    r: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBalance {
    q_angles_actuated: f64,
    q_angles_unactuated: f64,
}

impl PlannerSettings {
    pub(crate) fn read(file: &str, text: &str) -> Result<Self, ConfigError> {
        let check = Check { file };
        let Raw { offline, replan, lqr, balance } = check.parse(text)?;
        Ok(Self {
            offline: read_offline(check, &offline)?,
            replan: ReplanSettings {
                iterations: check.integer("replan.iterations", replan.iterations, 1..=1000)?,
                defect: check.number("replan.defect", replan.defect, &BELOW_ONE)?,
                knot_margin: check.number("replan.knot_margin", replan.knot_margin, &PART)?,
                torque: replan.torque,
                sub_horizons: read_sub_horizons(check, replan.sub_horizons)?,
                lead: Duration::from_millis(check.integer("replan.lead_ms", replan.lead_ms, 0..=1000)?),
                weights: ReplanWeights {
                    t_f: check.number("replan.weight_t_f", replan.weight_t_f, &POSITIVE)?,
                    q: check.list("replan.weight_q", &replan.weight_q, 1, &POSITIVE)?,
                    qd: check.list("replan.weight_qd", &replan.weight_qd, 1, &POSITIVE)?,
                    u: check.list("replan.weight_u", &replan.weight_u, 1, &POSITIVE)?,
                },
                backend: replan.backend,
                neighbours: check.integer("replan.neighbours", replan.neighbours, 1..=1000)?,
                metric: check.list("replan.metric", &replan.metric, 1, &POSITIVE)?,
            },
            lqr: LqrWeights {
                q_angles: check.number("lqr.q_angles", lqr.q_angles, &POSITIVE)?,
                q_velocities_actuated: check.number(
                    "lqr.q_velocities_actuated",
                    lqr.q_velocities_actuated,
                    &POSITIVE,
                )?,
                q_velocities_unactuated: check.number(
                    "lqr.q_velocities_unactuated",
                    lqr.q_velocities_unactuated,
                    &POSITIVE,
                )?,
                r: check.number("lqr.r", lqr.r, &POSITIVE)?,
            },
            balance: BalanceWeights {
                q_angles_actuated: check.number(
                    "balance.q_angles_actuated",
                    balance.q_angles_actuated,
                    &POSITIVE,
                )?,
                q_angles_unactuated: check.number(
                    "balance.q_angles_unactuated",
                    balance.q_angles_unactuated,
                    &POSITIVE,
                )?,
            },
        })
    }
}

/// Numbers of sub-horizons that divide the intervals of a trajectory evenly.
pub const SUB_HORIZONS: [usize; 5] = [1, 2, 4, 5, 10];

fn read_sub_horizons(check: Check<'_>, value: i64) -> Result<usize, ConfigError> {
    SUB_HORIZONS.into_iter().find(|n| *n as i64 == value).ok_or_else(|| {
        let expected = format!("one of {SUB_HORIZONS:?}");
        check.refuse("replan.sub_horizons", expected, value, "they divide the 100 intervals evenly")
    })
}

fn read_offline(check: Check<'_>, raw: &RawOffline) -> Result<OfflineSettings, ConfigError> {
    let t_f_min = check.number("offline.t_f_min_s", raw.t_f_min_s, &DURATION)?;
    let t_f_max = check.number("offline.t_f_max_s", raw.t_f_max_s, &DURATION)?;
    check.above("offline.t_f_max_s", t_f_max, t_f_min, "offline.t_f_min_s")?;
    Ok(OfflineSettings {
        input_weight: check.number("offline.input_weight", raw.input_weight, &POSITIVE)?,
        t_f_min,
        t_f_max,
        torque: raw.torque,
        tolerance: check.number("offline.tolerance", raw.tolerance, &BELOW_ONE)?,
        max_iterations: check.integer("offline.max_iterations", raw.max_iterations, 1..=1_000_000)?,
    })
}
