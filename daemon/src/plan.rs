//! From a plan in shared memory to one that the controller may run.

use thiserror::Error;
use upswing_config::Config;
use upswing_ipc::{DamagedPlan, Plan as Payload};
pub use upswing_trajectory::Ending;
use upswing_trajectory::{Plan, Unfit};

/// Why a plan was refused: the first check that failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanRefusal {
    /// The message holds no plan.
    #[error(transparent)]
    Damaged(#[from] DamagedPlan),
    /// Made for another robot.
    #[error("fingerprint: the plan was made for the model {got:016x}, the daemon has {expected:016x}")]
    Fingerprint {
        /// Of the daemon's model.
        expected: u64,
        /// In the plan.
        got: u64,
    },
    /// The robot cannot follow it.
    #[error(transparent)]
    Unfit(#[from] Unfit),
}

/// Checks a plan: checksum, fingerprint, id, and what [`Config::plan_criteria`] asks. `payload` must be a copy that nobody else can
/// write to.
///
/// # Errors
/// The first check that failed, with its numbers.
pub fn accept(payload: &Payload, config: &Config) -> Result<Box<Plan>, PlanRefusal> {
    let plan = Box::<Plan>::try_from(payload)?;
    let expected = config.model.fingerprint();
    if plan.fingerprint != expected {
        return Err(PlanRefusal::Fingerprint { expected, got: plan.fingerprint });
    }
    config.plan_criteria().check(&config.model, &plan)?;
    Ok(plan)
}
