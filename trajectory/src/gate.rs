//! What a plan has to fulfil before a robot follows it. The planner asks before it answers, the daemon before it loads: the
//! same code, with the same settings.

mod feedback;
mod motion;

pub use feedback::Delays;

use crate::{Plan, Trajectory};
use nalgebra::Vector3;
use upswing_model::{ActuatedVector, Limits, Model};

/// How far a plan may be past its limits, rad, rad/s and a share of the torque. A solver meets its limits up to a
/// tolerance, a start is measured a hair outside, and one QP around a database trajectory (14)-(17) meets the torque's
/// linearisation.
const POSITION_SLACK: f64 = 1e-3;
const VELOCITY_SLACK: f64 = 1e-2;
const TORQUE_SLACK: f64 = 0.05;
/// How far f_k may be from f(x_k, u_k) of the model, relative to 1 + |f|.
const DERIVATIVE_TOLERANCE: f64 = 1e-6;
/// How far the end of a plan may be from rest, rad/s, and its rod from the vertical, rad.
const END_SPEED: f64 = 1e-2;
const END_TILT: f64 = 2e-2;
/// Largest torque by which a gain may answer one deviation that the start tolerates, as a multiple of the 100 % limit. With
/// r of (20) at a hundredth of its setting it is 4: what is more is a blow, not feedback.
const MOST_STEP: f64 = 5.0;
/// Largest amplification of such a deviation: root of the sum of the squares of all rows at this and all later knots, in
/// units of the tolerance. It is 13 to 30 for plans of the planner: the arm has to move to catch the rod.
const MOST_AMPLIFIED: f64 = 100.0;

/// The limits that a plan is held to.
#[derive(Clone, Debug, PartialEq)]
pub struct Gate {
    /// Positions, velocities and torques that are open to plans.
    pub limits: Limits,
    /// Torque limits of the drives at 100 %, N m.
    pub tau_max: ActuatedVector,
    /// Largest defect of (6b), rad and rad/s per interval.
    pub defect: f64,
    /// Largest deviation of each angle (rad) and each velocity (rad/s) from the plan at its start.
    pub tolerance: (f64, f64),
    /// What delays the feedback.
    pub delays: Delays,
}

/// What a plan ends in, and so what follows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The rod stands: it has to be balanced.
    Upright,
    /// The rod hangs: the arm is held.
    Hanging,
}

impl Ending {
    /// Whether the rod along `rod` (world frame, z up) stands or hangs.
    pub fn of(rod: &Vector3<f64>) -> Self {
        if rod.z > 0.0 { Self::Upright } else { Self::Hanging }
    }
}

/// Why a plan is not fit to be followed: the first check that failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// A number is not finite.
    #[error("{what} at knot {knot} is {got}, expected a finite number")]
    NotFinite {
        /// Which part of the plan.
        what: &'static str,
        /// Number of the knot.
        knot: usize,
        /// What was found.
        got: f64,
    },
    /// t_F out of bounds.
    #[error("t_F is {got} s, expected more than 0 and at most {longest} s", longest = Trajectory::LONGEST)]
    Duration {
        /// t_F, s.
        got: f64,
    },
    /// The motion is beyond what plans may use.
    #[error("{what} of joint {} at knot {knot:.2} is {got:.4}, expected {lowest:.4} to {highest:.4} {unit}", .joint + 1)]
    Limit {
        /// Position, velocity or torque.
        what: &'static str,
        /// Unit of the numbers.
        unit: &'static str,
        /// The joint, 0-based.
        joint: usize,
        /// Number of the knot; with a fraction between two knots.
        knot: f64,
        /// What was found.
        got: f64,
        /// Lower limit.
        lowest: f64,
        /// Upper limit.
        highest: f64,
    },
    /// f_k is not that of the model.
    #[error("f at knot {knot}, row {row} is {got}, the model gives {expected}")]
    Derivative {
        /// Number of the knot.
        knot: usize,
        /// Row of f.
        row: usize,
        /// In the plan.
        got: f64,
        /// Of the model.
        expected: f64,
    },
    /// The spline jumps: (6b) does not hold.
    #[error(
        "{what} of joint {} jumps by {got:.2e} {unit} before knot {knot}: its defect (6b) is expected to be at most {most:.0e}",
        .joint + 1
    )]
    Defect {
        /// Position or velocity.
        what: &'static str,
        /// Its unit.
        unit: &'static str,
        /// The joint, 0-based.
        joint: usize,
        /// Number of the knot at the end of the interval.
        knot: usize,
        /// Magnitude of the defect.
        got: f64,
        /// The largest that is accepted.
        most: f64,
    },
    /// The plan ends neither standing nor hanging at rest.
    #[error(
        "the plan ends at {speed:.4} rad/s with the rod {upright:.4} rad from upright and {hanging:.4} rad from hanging, \
         expected at most {END_SPEED} rad/s and {END_TILT} rad from one of both"
    )]
    End {
        /// Largest joint velocity at x_N, rad/s.
        speed: f64,
        /// Angle of the rod from upright, rad.
        upright: f64,
        /// Angle of the rod from hanging, rad.
        hanging: f64,
    },
    /// The final gain does not keep the rod upright.
    #[error(
        "the closed loop at the end of the plan is unstable: spectral radius {radius:.6}, expected below 1"
    )]
    Unstable {
        /// Of the discrete closed loop with its delays.
        radius: f64,
    },
    /// A gain answers a deviation that the start tolerates with too much torque.
    #[error(
        "K at knot {knot} answers the tolerance at the start with {got:.3e} N m at joint {}, expected at most {most:.1} N m",
        .joint + 1
    )]
    Step {
        /// Number of the knot; past the last one for the final gain.
        knot: usize,
        /// The joint, 0-based.
        joint: usize,
        /// The torque, N m.
        got: f64,
        /// The largest that is accepted, N m.
        most: f64,
    },
    /// The feedback drives the motion away from its reference.
    #[error(
        "the closed loop amplifies a deviation at knot {knot} {got:.3e} times, expected at most {MOST_AMPLIFIED} times"
    )]
    Amplification {
        /// Number of the knot.
        knot: usize,
        /// Root of the sum of the squares of all rows at this and all later knots, in units of the tolerance at the start,
        /// for the deviation of one row by its tolerance.
        got: f64,
    },
}

impl Gate {
    /// Whether a robot may follow the plan, in this order: finite, t_F; positions and velocities (at the knots and
    /// at the extrema of the spline between them) and torques (9) (at the knots and on a grid between them); f_k against
    /// the model; (6b); an end at rest with the rod standing or hanging; the feedback. Time is monotone by construction:
    /// the knots are uniform. Who made the plan and for which robot is not asked.
    ///
    /// # Errors
    /// The first check that failed, with its numbers.
    pub fn check(&self, model: &Model, plan: &Plan) -> Result<(), Unfit> {
        self.check_motion(model, &plan.trajectory, &plan.f)?;
        self.check_feedback(model, &plan.trajectory, &plan.gains, &plan.final_gain)
    }
}

fn finite<'a>(what: &'static str, knots: impl Iterator<Item = &'a [f64]>) -> Result<(), Unfit> {
    for (knot, values) in knots.enumerate() {
        if let Some(got) = values.iter().find(|v| !v.is_finite()) {
            return Err(Unfit::NotFinite { what, knot, got: *got });
        }
    }
    Ok(())
}
