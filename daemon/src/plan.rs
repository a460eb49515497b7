//! From a plan in shared memory to one that the controller may run.

use thiserror::Error;
use upswing_config::Config;
use upswing_ipc::Plan as Payload;
use upswing_model::{ActuatedVector, NU, NX, State};
pub use upswing_trajectory::Ending;
use upswing_trajectory::{Gain, Plan, Trajectory, Unfit};

/// Why a plan was refused: the first check that failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanRefusal {
    /// The bytes are not those that the planner sealed.
    #[error("checksum: the plan names {expected:016x}, its contents give {got:016x}")]
    Checksum {
        /// In the plan.
        expected: u64,
        /// Of its contents.
        got: u64,
    },
    /// Made for another robot.
    #[error("fingerprint: the plan was made for the model {got:016x}, the daemon has {expected:016x}")]
    Fingerprint {
        /// Of the daemon's model.
        expected: u64,
        /// In the plan.
        got: u64,
    },
    /// The id that means "no plan".
    #[error("id: expected one above 0")]
    Id,
    /// The robot cannot follow it.
    #[error(transparent)]
    Unfit(#[from] Unfit),
}

/// Checks a plan: checksum, fingerprint, id, and what [`Config::gate`] asks. `payload` must be a copy that nobody else can
/// write to.
///
/// # Errors
/// The first check that failed, with its numbers.
pub fn accept(payload: &Payload, config: &Config) -> Result<Box<Plan>, PlanRefusal> {
    if !payload.is_intact() {
        return Err(PlanRefusal::Checksum { expected: payload.checksum, got: payload.checksum_of() });
    }
    let expected = config.model.fingerprint();
    if payload.fingerprint != expected {
        return Err(PlanRefusal::Fingerprint { expected, got: payload.fingerprint });
    }
    if payload.id == 0 {
        return Err(PlanRefusal::Id);
    }
    let plan = convert(payload);
    config.gate().check(&config.model, &plan)?;
    Ok(plan)
}

fn convert(payload: &Payload) -> Box<Plan> {
    let gain = |k: &[[f64; NX]; NU]| Gain::from_fn(|i, j| k[i][j]);
    Box::new(Plan {
        id: payload.id,
        fingerprint: payload.fingerprint,
        trajectory: Trajectory {
            t_f: payload.t_f,
            x: payload.x.iter().map(|x| State::from(*x)).collect(),
            u: payload.u.iter().map(|u| ActuatedVector::from(*u)).collect(),
        },
        f: payload.f.iter().map(|f| State::from(*f)).collect(),
        gains: payload.k.iter().map(gain).collect(),
        final_gain: gain(&payload.k_final),
        activation_ns: Some(payload.activation_ns).filter(|ns| *ns != 0),
    })
}
