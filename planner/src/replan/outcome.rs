//! The result of a replan: a plan, or the reason of failure for each database entry that was tried.

use std::time::Duration;
use upswing_config::{Config, GivenError};
use upswing_model::RestError;
use upswing_ocp::interior_point::NlpStatus;
use upswing_ocp::lqr;
use upswing_ocp::qp::{ConflictingBound, QpStatus, Stall};
use upswing_trajectory::{DatabaseError, Gains, Margins, Neighbour, Plan, Trajectory, UnmetCriterion};

/// A database entry from which no plan could be made.
#[derive(Clone, Debug)]
pub struct FailedAttempt {
    /// The entry and its distance from the start.
    pub entry: Neighbour,
    /// Reason of the failure.
    pub failure: PlanningFailure,
}

/// The reason why a database entry gave no plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanningFailure {
    /// The constraints of a QP cannot be met together.
    #[error("QP {iteration} is infeasible{}", conflict.map_or(String::new(), |c| format!(": it would exceed {c}")))]
    Infeasible {
        /// Number of the linearisation, from 1.
        iteration: usize,
        /// Limit that the solution would exceed, if the solver knows it.
        conflict: Option<ConflictingBound>,
    },
    /// A QP was neither solved nor found infeasible.
    #[error("QP {iteration}: {stall}")]
    Stalled {
        /// Number of the linearisation, from 1.
        iteration: usize,
        /// Reason for which the solver stopped.
        stall: Stall,
    },
    /// The plan does not meet the daemon's criteria of acceptance.
    #[error("after {iterations} {}: {criterion}", if *method == Method::Quadratic { "QPs" } else { "iterations" })]
    Criterion {
        /// Method that found the trajectory.
        method: Method,
        /// Number of QPs, or of iterations of the full optimisation.
        iterations: usize,
        /// Violated criterion.
        criterion: UnmetCriterion,
    },
    /// The time budget was used up.
    #[error("the time budget was used up before QP {iteration} was solved")]
    Deadline {
        /// The QP that was not begun or not finished, from 1.
        iteration: usize,
    },
    /// The client cancelled the request or has disconnected.
    #[error("cancelled before QP {iteration} was solved")]
    Cancelled {
        /// The QP that was not begun or not finished, from 1.
        iteration: usize,
    },
    /// The full optimisation found no trajectory.
    #[error("{0}")]
    Optimisation(NlpStatus),
    /// The entry cannot be read.
    #[error("the database: {0}")]
    Entry(#[from] DatabaseError),
    /// The given values make no target.
    #[error("the target: {0}")]
    Target(#[from] GivenError),
    /// The unactuated joints have no rest position in which a reversal could end.
    #[error(transparent)]
    NoRest(#[from] RestError),
    /// There is no stabilising gain at the end of the trajectory.
    #[error(transparent)]
    Gain(#[from] lqr::NotStabilisable),
}

/// A quadratic program on which the structured solver made no progress and Clarabel was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SecondOpinion {
    /// Index of the database entry that was being adapted.
    pub entry: usize,
    /// Number of the linearisation, from 1.
    pub iteration: usize,
    /// Reason for which the structured solver stopped.
    pub stall: Stall,
    /// Status with which Clarabel stopped.
    pub clarabel: QpStatus,
}

impl std::fmt::Display for SecondOpinion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { entry, iteration, stall, clarabel } = self;
        write!(f, "QP {iteration} of entry {entry}: {stall}; second opinion of Clarabel: {clarabel}")
    }
}

/// Durations of the steps of a replan, and its second opinions.
#[derive(Clone, Debug, Default)]
pub struct ReplanStatistics {
    /// Search of the database.
    pub nearest: Duration,
    /// Solution of all QPs, with their linearisations.
    pub qp: Duration,
    /// The full optimisation.
    pub optimisation: Duration,
    /// Checks of the result on the real dynamics.
    pub check: Duration,
    /// Synthesis of the gains.
    pub lqr: Duration,
    /// The whole replan.
    pub total: Duration,
    /// The QPs, of all entries tried, on which Clarabel was asked.
    pub second_opinions: Vec<SecondOpinion>,
}

/// Method that found a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// QPs (16) around a database entry.
    Quadratic,
    /// The full optimisation (6).
    Optimisation,
}

/// A replanned trajectory with its gains.
#[derive(Clone, Debug)]
pub struct Replan {
    /// The trajectory from the given start.
    pub trajectory: Trajectory,
    /// The gains of the trajectory.
    pub gains: Gains,
    /// Method that found the trajectory.
    pub method: Method,
    /// The database entry that was adapted; for the full optimisation the nearest entry, if there is one.
    pub entry: Option<Neighbour>,
    /// The entries tried before it, which gave no plan, in order.
    pub failed: Vec<FailedAttempt>,
    /// Number of QPs for the entry used, each linearised around the result before, or of iterations of the full optimisation.
    pub iterations: usize,
    /// Largest defect (6b) of the nonlinear dynamics, rad or rad/s per interval.
    pub defect: f64,
    /// Margins to the limits, between knots too.
    pub margins: Margins,
    /// Durations of the steps, and the second opinions.
    pub statistics: ReplanStatistics,
}

impl Replan {
    /// Number of the QPs for the entry used that Clarabel solved in place of the structured solver.
    pub fn solved_by_clarabel(&self) -> usize {
        let entry = self.entry.map(|entry| entry.index);
        let of_entry = |o: &&SecondOpinion| Some(o.entry) == entry && o.clarabel == QpStatus::Solved;
        self.statistics.second_opinions.iter().filter(of_entry).count()
    }
}

/// Error of a replan without a plan: the failures of all methods tried.
#[derive(Clone, Debug)]
pub struct NoPlan {
    /// The entries tried, in order.
    pub failed: Vec<FailedAttempt>,
    /// Reason for which the full optimisation gave no plan; `None` if it was not tried.
    pub optimisation: Option<Box<PlanningFailure>>,
    /// The QPs, of all entries tried, on which Clarabel was asked.
    pub second_opinions: Vec<SecondOpinion>,
}

impl std::fmt::Display for NoPlan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // The most important part first: a response may truncate the text.
        match (&self.optimisation, self.failed.len()) {
            (Some(failure), 0) => return write!(f, "full optimisation: {failure}"),
            (Some(failure), n) => write!(f, "full optimisation: {failure}; none of the {n}")?,
            (None, n) => write!(f, "none of the {n}")?,
        }
        f.write_str(" nearest database entries could be adapted")?;
        self.failed.iter().try_for_each(|FailedAttempt { entry, failure }| {
            write!(f, "; entry {} ({:.3} rad away): {failure}", entry.index, entry.distance)
        })?;
        match self.second_opinions.len() {
            0 => Ok(()),
            n => write!(f, "; Clarabel was asked for a second opinion on {n} QPs"),
        }
    }
}

impl std::error::Error for NoPlan {}

impl NoPlan {
    /// Whether the time budget was the reason, not feasibility.
    pub fn out_of_time(&self) -> bool {
        matches!(self.optimisation.as_deref(), Some(PlanningFailure::Optimisation(NlpStatus::OutOfTime)))
            || self.failed.iter().any(|a| matches!(a.failure, PlanningFailure::Deadline { .. }))
    }
}

impl Replan {
    /// The plan for the daemon, without activation time.
    pub fn plan(&self, config: &Config) -> Plan {
        Plan::new(&config.model, self.trajectory.clone(), self.gains.clone())
    }
}
