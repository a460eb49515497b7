//! States at standstill within the limits of the joints: where a motion can start.

use crate::{
    ActuatedVector, JointParts, JointVector, Limits, Model, NQ, NU, RestError, State, UnactuatedVector,
    Workspace, state,
};

/// Why a pose cannot be a start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The wrong number of angles.
    #[error("expected {NU} joint angles in deg, separated by commas, as in 0,-15,0,-95,0,10,0; got {got}")]
    Length {
        /// Angles given.
        got: usize,
    },
    /// An angle is NaN or infinite.
    #[error("angle of joint {joint}: expected a number, got {value}")]
    NotFinite {
        /// The joint, counted from 1.
        joint: usize,
        /// What was given.
        value: f64,
    },
    /// An angle is outside the limits.
    #[error("angle of joint {joint}: expected {min_deg:.1} to {max_deg:.1} deg, got {got_deg:.2} deg")]
    OutsideLimits {
        /// The joint, counted from 1.
        joint: usize,
        /// Lowest angle, deg.
        min_deg: f64,
        /// Highest angle, deg.
        max_deg: f64,
        /// Angle given, deg.
        got_deg: f64,
    },
    /// The pendulum would rest outside its limits.
    #[error(
        "in this pose the rest position of joint {joint} is {got_deg:.1} deg, outside its range of {min_deg:.1} to \
         {max_deg:.1} deg; choose a pose whose flange is closer to horizontal (q2 - q4 + q6 near 90 deg)"
    )]
    RestOutsideLimits {
        /// The joint, counted from 1.
        joint: usize,
        /// Lowest angle, deg.
        min_deg: f64,
        /// Highest angle, deg.
        max_deg: f64,
        /// Angle of rest, deg.
        got_deg: f64,
    },
    /// The pendulum has no rest position in this pose.
    #[error(transparent)]
    NoRest(#[from] RestError),
}

impl Model {
    /// The state with qd = 0, the actuated joints at `q_a` (7 angles, rad) and the unactuated joints at `q_u` (rad), or, with
    /// `None`, in their hanging equilibrium g_U(q) = 0. All joints have to be within the positions of `limits`.
    ///
    /// # Errors
    /// [`StartError`] if `q_a` has another length, an angle is not finite or outside the limits, or there is no equilibrium.
    pub fn standstill(
        &self,
        limits: &Limits,
        q_a: &[f64],
        q_u: Option<&UnactuatedVector>,
    ) -> Result<State, StartError> {
        if q_a.len() != NU {
            return Err(StartError::Length { got: q_a.len() });
        }
        let mut q = JointVector::zeros();
        q.actuated_mut().copy_from(&ActuatedVector::from_column_slice(q_a));
        for i in 0..NU {
            limits.check_angle(i, q[i])?;
        }
        match q_u {
            Some(q_u) => q.unactuated_mut().copy_from(q_u),
            None => q = self.rest_position(&q, &mut Workspace::default())?,
        }
        for i in NU..NQ {
            limits.check_angle(i, q[i]).map_err(|e| match e {
                StartError::OutsideLimits { joint, min_deg, max_deg, got_deg } => {
                    StartError::RestOutsideLimits { joint, min_deg, max_deg, got_deg }
                }
                other => other,
            })?;
        }
        Ok(state(&q, &JointVector::zeros()))
    }
}

impl Limits {
    /// Checks the `angle` (rad) of a joint, counted from 0, against its lowest and highest position.
    ///
    /// # Errors
    /// [`StartError::NotFinite`] or [`StartError::OutsideLimits`].
    pub fn check_angle(&self, joint: usize, angle: f64) -> Result<(), StartError> {
        let (min, max) = (self.q_min[joint], self.q_max[joint]);
        if !angle.is_finite() {
            return Err(StartError::NotFinite { joint: joint + 1, value: angle });
        }
        if (min..=max).contains(&angle) {
            return Ok(());
        }
        Err(StartError::OutsideLimits {
            joint: joint + 1,
            min_deg: min.to_degrees(),
            max_deg: max.to_degrees(),
            got_deg: angle.to_degrees(),
        })
    }
}
