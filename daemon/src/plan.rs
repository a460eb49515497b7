//! Acceptance of plans: converts a plan in shared memory to one that the controller may run.

use thiserror::Error;
use upswing_config::Config;
use upswing_ipc::{DamagedPlan, PlanMessage};
use upswing_trajectory::{Plan, UnmetCriterion};

/// Refusal of a plan: the first check that failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanRefusal {
    /// The message contains no valid plan.
    #[error(transparent)]
    Damaged(#[from] DamagedPlan),
    /// The plan was made for another robot.
    #[error("fingerprint: the plan was made for the model {got:016x}, the daemon has {expected:016x}")]
    Fingerprint {
        /// Fingerprint of the daemon's model.
        expected: u64,
        /// Fingerprint in the plan.
        got: u64,
    },
    /// The plan violates a criterion: the robot cannot follow it.
    #[error(transparent)]
    Criterion(#[from] UnmetCriterion),
}

/// Checks a plan: checksum, numbers of joints, id, fingerprint, and [`Config::plan_criteria`]; for a plan that replaces a running one
/// [`Config::replacement_criteria`].
///
/// # Errors
/// The first check that failed, with its numbers.
pub fn accept(message: &PlanMessage, config: &Config) -> Result<Box<Plan>, PlanRefusal> {
    let plan = Box::new(message.plan(config.model.order())?);
    let expected = config.model.fingerprint();
    if plan.fingerprint != expected {
        return Err(PlanRefusal::Fingerprint { expected, got: plan.fingerprint });
    }
    let criteria = match plan.replaces {
        None => config.plan_criteria(),
        Some(_) => config.replacement_criteria(),
    };
    criteria.check(&config.model, &plan)?;
    Ok(plan)
}
