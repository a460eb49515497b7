//! A manoeuvre as a person asks for it: by its name, with values for the joints that its target leaves open, from a start pose.

use crate::database::standing;
use upswing_config::{Config, GivenOutsideLimits, PendulumStart};
use upswing_model::{Posture, StartError, State};

/// Error of the name of a manoeuvre, or of the values that its target asks for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WantedError {
    /// The settings have no manoeuvre of this name.
    #[error("unknown manoeuvre `{got}`: this system has {known}")]
    UnknownManoeuvre {
        /// The name.
        got: String,
        /// Names of the manoeuvres of the settings.
        known: String,
    },
    /// The target does not ask for a value of this joint.
    #[error("`{manoeuvre}` takes values of the joints {expected}; got `{got}`")]
    NotAsked {
        /// Name of the manoeuvre.
        manoeuvre: String,
        /// Names of the joints that it asks for.
        expected: String,
        /// The joint.
        got: String,
    },
    /// A joint has two values.
    #[error("joint `{joint}` twice: give one value")]
    Twice {
        /// Name of the joint.
        joint: String,
    },
    /// A value is outside the limits of its joint.
    #[error(transparent)]
    OutsideLimits(#[from] GivenOutsideLimits),
}

/// Error of the start pose of a manoeuvre.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WantedStartError {
    /// The pose is none at standstill within the limits.
    #[error(transparent)]
    Pose(#[from] StartError),
    /// The manoeuvre starts standing, and the unactuated joints have no equilibrium there.
    #[error("the unactuated joints cannot stand in this pose")]
    CannotStand,
}

/// Number of the manoeuvre `name` in the settings; the first one without a name.
///
/// # Errors
/// [`WantedError::UnknownManoeuvre`]
pub fn manoeuvre_number(config: &Config, name: Option<&str>) -> Result<usize, WantedError> {
    let number = match name {
        None => Some(0).filter(|first| *first < config.manoeuvres.len()),
        Some(name) => config.manoeuvres.iter().position(|manoeuvre| manoeuvre.name == name),
    };
    number.ok_or_else(|| {
        let names: Vec<_> = config.manoeuvres.iter().map(|m| format!("`{}`", m.name)).collect();
        WantedError::UnknownManoeuvre { got: name.unwrap_or_default().to_owned(), known: names.join(", ") }
    })
}

/// The values (rad or m) that pairs of a joint's name and its position give to the target of manoeuvre number `manoeuvre`: NaN for a joint
/// without one.
///
/// # Errors
/// [`WantedError`] if the manoeuvre does not ask for a joint, if a joint has two values, or one outside its limits.
pub fn given_values<'a>(
    config: &Config,
    manoeuvre: usize,
    to: impl IntoIterator<Item = (&'a str, f64)>,
) -> Result<Vec<f64>, WantedError> {
    let asked: Vec<usize> = config.manoeuvres[manoeuvre].given().map(|axis| axis.joint).collect();
    let mut given = vec![f64::NAN; asked.len()];
    for (joint, value) in to {
        let Some(i) = asked.iter().position(|i| config.model.joint_name(*i) == joint) else {
            let names: Vec<_> = asked.iter().map(|i| format!("`{}`", config.model.joint_name(*i))).collect();
            return Err(WantedError::NotAsked {
                manoeuvre: config.manoeuvres[manoeuvre].name.clone(),
                expected: if names.is_empty() { "none".to_owned() } else { names.join(", ") },
                got: joint.to_owned(),
            });
        };
        if !given[i].is_nan() {
            return Err(WantedError::Twice { joint: joint.to_owned() });
        }
        given[i] = value;
        GivenOutsideLimits::check(config, asked[i], value)?;
    }
    Ok(given)
}

/// The state at standstill in which manoeuvre number `manoeuvre` starts with the actuated joints at `q_a`, rad or m: the unactuated ones
/// hang as `pendulum` says, or stand, as the manoeuvre needs it.
///
/// # Errors
/// [`WantedStartError`]
pub fn start_of(
    config: &Config,
    manoeuvre: usize,
    q_a: &[f64],
    pendulum: PendulumStart,
) -> Result<State, WantedStartError> {
    let hanging = config.start_state(q_a, pendulum)?;
    match config.manoeuvres[manoeuvre].start {
        Posture::Hanging => Ok(hanging),
        Posture::Standing => standing(config, manoeuvre, &hanging.q_a()).ok_or(WantedStartError::CannotStand),
    }
}

/// Replaces each of the `given` values that is NaN by the position of its joint in `start`: the joint ends where it starts.
pub fn complete_given(config: &Config, manoeuvre: usize, given: &mut [f64], start: &State) {
    for (value, axis) in given.iter_mut().zip(config.manoeuvres[manoeuvre].given()) {
        if value.is_nan() {
            *value = start[axis.joint];
        }
    }
}
