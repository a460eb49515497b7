//! Verification of a database: recomputes the figures and outcomes that its records state.

use super::{Task, certify, has_grid_of};
use crate::offline::{lqr_recursion, lqr_weights, optimize_entry, options, target};
use rayon::prelude::*;
use upswing_config::Config;
use upswing_model::{State, Workspace};
use upswing_ocp::interior_point::NlpStatus;
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::lqr::{self, NotStabilisable};
use upswing_trajectory::{
    Certificate, Database, DatabaseError, Entry, KeyTree, Margins, PoseOutcome, PoseRecord, end_error,
};

/// A pose whose record differs from the result of a build with these settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discrepancy {
    /// Number of the pose.
    pub pose: u64,
    /// Flaw of the record.
    pub flaw: RecordFlaw,
}

/// Flaw of a record of a database.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RecordFlaw {
    /// The certificate in the record differs from that of the trajectory.
    #[error("recorded {recorded:?}, computed {computed:?}")]
    Certificate {
        /// Certificate in the file.
        recorded: Certificate,
        /// Certificate computed from the trajectory.
        computed: Certificate,
    },
    /// Start, end or duration in the index differ from those of the trajectory.
    #[error("the index has another key, end or duration than the record")]
    Index,
    /// The rules of the grid leave out a pose that the file has, or the file leaves out a pose that the grid has.
    #[error("the grid {} this pose, the file does not", if *leaves_out { "leaves out" } else { "has" })]
    Rule {
        /// Whether the rules leave the pose out.
        leaves_out: bool,
    },
    /// The trajectory does not start in the start state of the pose.
    #[error("starts {by:.2e} (rad or rad/s) from the grid's pose, in entry {row} of the state")]
    Start {
        /// Entry of x_0.
        row: usize,
        /// Distance from the start state, rad or rad/s.
        by: f64,
    },
    /// The given values in the key of the entry leave no rest position of the unactuated joints.
    #[error("has a target without a rest position")]
    NoTarget,
    /// The trajectory does not end in the target (8).
    #[error("misses row {row} of the target (8) by {by:.2e} rad or rad/s")]
    End {
        /// Row of (8).
        row: usize,
        /// Residual of the row, rad or rad/s.
        by: f64,
    },
    /// The trajectory violates the dynamics between two knots.
    #[error("defect (6b) of {got:.2e} rad or rad/s, expected at most {most:.0e}")]
    Defect {
        /// Largest defect, rad or rad/s.
        got: f64,
        /// Largest accepted defect, `replan.defect`.
        most: f64,
    },
    /// A limit is exceeded.
    #[error("exceeds a limit of {what} {at} by {by:.4} of half its range, expected at most {most}")]
    Limit {
        /// Position, velocity or torque.
        what: &'static str,
        /// Location: at or between the knots.
        at: &'static str,
        /// Excess, as a share of half the range.
        by: f64,
        /// Largest accepted excess, as a share of half the range.
        most: f64,
    },
    /// There are no gains with which the trajectory can be followed.
    #[error("cannot be followed: {0}")]
    Gains(NotStabilisable),
    /// Followed with its gains, the trajectory misses its end by too much.
    #[error(
        "followed with its gains, misses its end by {got:.2} rad or rad/s, expected at most {FARTHEST_END}"
    )]
    EndError {
        /// Largest distance of a row of the state from x_N, rad or rad/s.
        got: f64,
    },
    /// A pose recorded as without solution has one.
    #[error("recorded as without solution, but a trajectory of cost {cost:.5} is found")]
    Solvable {
        /// Cost of the solution found.
        cost: f64,
    },
}

/// Largest difference of two computations, rad or rad/s or relative: another order of sums, in another version of the programs, changes
/// the last digits, which an unstable pendulum amplifies.
const ROUNDING: f64 = 1e-6;
/// Largest distance from x_N at t_F of a trajectory that is followed with its gains, rad or rad/s. The trapezoidal rule is exact to h^2, which
/// the feedback leaves as at most 0.31 in the shipped databases (three rods on a cart; 0.07 in the others). A rod that ends hanging misses its end by pi.
const FARTHEST_END: f64 = 1.0;

/// Recomputes all statements of the records, in parallel: figures, start, target, limits, and that poses without a trajectory
/// have no solution. Starts are compared where the database [has the settings' grid](has_grid_of). Between knots a limit may
/// be exceeded by `replan.knot_margin`, the margin that a replan keeps at the knots for this excess.
///
/// # Errors
/// [`DatabaseError`] if a record is damaged.
pub fn verify(
    config: &Config,
    manoeuvre: usize,
    database: &Database,
    progress: impl Fn() + Sync,
) -> Result<Vec<Discrepancy>, DatabaseError> {
    let compare_poses = has_grid_of(config, manoeuvre, database);
    let (keys, ends) = (by_number(database.keys()), by_number(database.ends()?));
    let judge = |number: usize, record: &PoseRecord| {
        if compare_poses {
            let task = Task::of(config, manoeuvre, record.pose as usize);
            let leaves_out = task.is_none();
            if leaves_out != matches!(record.outcome, PoseOutcome::Rejected) {
                return Err(RecordFlaw::Rule { leaves_out });
            }
            if let Some(Task { start, target, .. }) = task {
                has_start(config, record, &start, target)?;
            }
        }
        match &record.outcome {
            PoseOutcome::Solved(entry) => {
                let end: &[f64] = &entry.trajectory.end().q_a();
                let t_f = database.durations()[number];
                if (keys[number], ends[number], t_f) != (&entry.key, end, entry.trajectory.t_f) {
                    return Err(RecordFlaw::Index);
                }
                let verdict = verify_entry(config, manoeuvre, entry);
                progress();
                verdict
            }
            _ => Ok(()),
        }
    };
    let judged = (0..database.len()).into_par_iter().map(|number| {
        let record = database.record(number)?;
        let flaw = judge(number, &record).err();
        Ok(flaw.map(|flaw| Discrepancy { pose: record.pose, flaw }))
    });
    let mut found: Vec<_> = judged.filter_map(Result::transpose).collect::<Result<_, _>>()?;
    found.sort_by_key(|discrepancy: &Discrepancy| discrepancy.pose);
    Ok(found)
}

/// The keys of a tree in the order of their numbers.
fn by_number(tree: &KeyTree) -> Vec<&[f64]> {
    let mut keys: Vec<_> = tree.keys().collect();
    keys.sort_unstable_by_key(|(number, _)| *number);
    keys.into_iter().map(|(_, key)| key).collect()
}

/// Checks that the trajectory of a record starts in `start` (rad, rad/s); without a trajectory, that none to `target` is found from
/// there.
fn has_start(
    config: &Config,
    record: &PoseRecord,
    start: &State,
    target: Vec<TargetRow>,
) -> Result<(), RecordFlaw> {
    match &record.outcome {
        PoseOutcome::Solved(entry) => {
            let away = (entry.trajectory.x[0] - start).abs();
            let (row, by) =
                away.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
            if by <= ROUNDING { Ok(()) } else { Err(RecordFlaw::Start { row, by }) }
        }
        _ => {
            let solution = optimize_entry(config, target, *start, &[], &options(config));
            match solution.status {
                NlpStatus::Solved => Err(RecordFlaw::Solvable { cost: solution.cost }),
                _ => Ok(()),
            }
        }
    }
}

fn verify_entry(config: &Config, manoeuvre: usize, entry: &Entry) -> Result<(), RecordFlaw> {
    let (trajectory, recorded) = (&entry.trajectory, entry.certificate);
    let computed = certify(config, trajectory);
    if recorded.difference(&computed) > ROUNDING {
        return Err(RecordFlaw::Certificate { recorded, computed });
    }
    let given = entry.key.get(config.model.sizes().actuated()..).unwrap_or_default();
    let target = target(config, manoeuvre, given).map_err(|_| RecordFlaw::NoTarget)?;
    for (row, target) in target.iter().enumerate() {
        let by = target.residual(trajectory.end()).abs();
        // Written so that NaN fails, here and below.
        if !(by <= ROUNDING) {
            return Err(RecordFlaw::End { row, by });
        }
    }
    let most = config.planner.replan.defect;
    if !(computed.defect <= most) {
        return Err(RecordFlaw::Defect { got: computed.defect, most });
    }
    let knots = Margins::of(trajectory, &config.model, &config.robot.planning, 0);
    let between = config.planner.replan.knot_margin;
    for (what, at_knots, everywhere) in [
        ("position", knots.q.share, computed.margin_q),
        ("velocity", knots.qd.share, computed.margin_qd),
        ("torque", knots.tau.share, computed.margin_tau),
    ] {
        for (at, margin, most) in [("at a knot", at_knots, ROUNDING), ("between knots", everywhere, between)]
        {
            if !(margin >= -most) {
                return Err(RecordFlaw::Limit { what, at, by: -margin, most });
            }
        }
    }
    let (model, mut work) = (&config.model, Workspace::default());
    let weights = lqr_weights(&config.planner, model.sizes());
    let period = config.daemon.cycle.period.seconds();
    let gains =
        lqr::synthesize(model, trajectory, &weights, period, lqr_recursion(&config.planner), &mut work)
            .map_err(RecordFlaw::Gains)?;
    let got = end_error(trajectory, &gains, model, &mut work);
    if got <= FARTHEST_END { Ok(()) } else { Err(RecordFlaw::EndError { got }) }
}
