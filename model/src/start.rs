//! States at standstill within the limits of the joints: where a motion can start.

use crate::{ActuatedVector, JointVector, Limits, Model, RestError, State, UnactuatedVector, Workspace};

/// Why a pose cannot be a start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The wrong number of positions.
    #[error(
        "expected {} positions of the actuated joints, separated by commas ({}); got {got}",
        .joints.len(), .joints.join(",")
    )]
    Length {
        /// Names of the actuated joints with the units of their positions.
        joints: Vec<String>,
        /// Positions given.
        got: usize,
    },
    /// A position is NaN or infinite.
    #[error("position of joint `{joint}`: expected a number, got {value}")]
    NotFinite {
        /// Name of the joint.
        joint: String,
        /// What was given.
        value: f64,
    },
    /// A position is outside the limits.
    #[error("position of joint `{joint}`: expected {min:.3} to {max:.3} {unit}, got {got:.3} {unit}")]
    OutsideLimits {
        /// Name of the joint.
        joint: String,
        /// Lowest position, in `unit`.
        min: f64,
        /// Highest position, in `unit`.
        max: f64,
        /// Position given, in `unit`.
        got: f64,
        /// deg or m.
        unit: &'static str,
    },
    /// An unactuated joint would rest outside its limits.
    #[error(
        "in this pose the rest position of joint `{joint}` is {got:.1} {unit}, outside its range of {min:.1} to {max:.1} {unit}; \
         choose a pose in which it hangs within its range"
    )]
    RestOutsideLimits {
        /// Name of the joint.
        joint: String,
        /// Lowest position, in `unit`.
        min: f64,
        /// Highest position, in `unit`.
        max: f64,
        /// Position of rest, in `unit`.
        got: f64,
        /// deg or m.
        unit: &'static str,
    },
    /// The unactuated joints have no rest position in this pose.
    #[error(transparent)]
    NoRest(#[from] RestError),
}

impl Model {
    /// The state with qd = 0, the actuated joints at `q_a` (rad or m) and the unactuated joints at `q_u`, or, with
    /// `None`, in their hanging equilibrium g_U(q) = 0. All joints have to be within the positions of `limits`.
    ///
    /// # Errors
    /// [`StartError`] if `q_a` has another length, a position is not finite or outside the limits, or there is no equilibrium.
    pub fn standstill(
        &self,
        limits: &Limits,
        q_a: &[f64],
        q_u: Option<&UnactuatedVector>,
    ) -> Result<State, StartError> {
        let sizes = self.sizes();
        let q_a = self.one_per_actuated_joint(q_a)?;
        let q = JointVector::joined(&q_a, q_u.unwrap_or(&UnactuatedVector::zeros(sizes)));
        for i in 0..sizes.actuated() {
            self.check_position(limits, i, q[i])?;
        }
        let q = match q_u {
            Some(_) => q,
            None => self.rest_position(&q, &mut Workspace::default())?,
        };
        for i in sizes.actuated()..sizes.joints() {
            self.check_position(limits, i, q[i]).map_err(|e| match e {
                StartError::OutsideLimits { joint, min, max, got, unit } => {
                    StartError::RestOutsideLimits { joint, min, max, got, unit }
                }
                other => other,
            })?;
        }
        Ok(State::new(&q, &JointVector::zeros(sizes)))
    }

    /// q_A (rad or m) of the positions of the actuated joints as a person writes them, in deg or m.
    ///
    /// # Errors
    /// [`StartError::Length`] unless there is one position per actuated joint.
    pub fn actuated_from_shown(&self, shown: &[f64]) -> Result<ActuatedVector, StartError> {
        let shown = self.one_per_actuated_joint(shown)?;
        Ok(ActuatedVector::from_fn(self.sizes(), |i| self.joint_kind(i).position(shown[i])))
    }

    fn one_per_actuated_joint(&self, positions: &[f64]) -> Result<ActuatedVector, StartError> {
        let sizes = self.sizes();
        ActuatedVector::from_slice(sizes, positions).ok_or_else(|| {
            let joint = |i| format!("{} in {}", self.joint_name(i), self.joint_kind(i).shown(0.0).1);
            let joints = (0..sizes.actuated()).map(joint).collect();
            StartError::Length { joints, got: positions.len() }
        })
    }

    /// Checks the `position` (rad or m) of the joint of index `coordinate` in sorted vectors against `limits`.
    ///
    /// # Errors
    /// [`StartError::NotFinite`] or [`StartError::OutsideLimits`].
    pub fn check_position(
        &self,
        limits: &Limits,
        coordinate: usize,
        position: f64,
    ) -> Result<(), StartError> {
        let joint = || self.joint_name(coordinate).to_owned();
        let (min, max) = (limits.q_min[coordinate], limits.q_max[coordinate]);
        if !position.is_finite() {
            return Err(StartError::NotFinite { joint: joint(), value: position });
        }
        if (min..=max).contains(&position) {
            return Ok(());
        }
        let [(min, unit), (max, _), (got, _)] =
            [min, max, position].map(|v| self.joint_kind(coordinate).shown(v));
        Err(StartError::OutsideLimits { joint: joint(), min, max, got, unit })
    }
}
