//! The criteria that a plan has to meet before a robot follows it. The planner checks them before it answers, the daemon
//! again before it loads the plan: with the same code and the same settings.

mod feedback;
mod matrix;
mod motion;

pub use feedback::LoopDelays;

use crate::{INTERVALS, Plan, Trajectory};
use upswing_model::thresholds::{PLAN_END_ACCELERATION, REST_SPEED_PLAN_END};
use upswing_model::{ActuatedVector, LimitKind, Limits, Model, Sizes, State};

/// Largest excess of a plan over its velocity limits, rad/s, and its torque limits, as a share. A solver meets its limits up to a
/// tolerance, a start may be measured just outside, and one QP around a database trajectory (14)-(17) meets the
/// linearised torque limits only.
const VELOCITY_SLACK: f64 = 1e-2;
const TORQUE_SLACK: f64 = 0.05;
/// Largest difference between f_k and f(x_k, u_k) of the model, relative to 1 + |f|.
const DERIVATIVE_TOLERANCE: f64 = 1e-6;
/// Largest torque with which a gain may answer a deviation of one row of the state by the start tolerance, as a multiple of
/// the 100 % limit. With r of (20) at a hundredth of its setting it is 4; a larger one is a blow, not feedback.
const MOST_STEP: f64 = 5.0;
/// Number of intervals for which [`PlanCriteria::amplification`] is stated: with more knots each counts less, so that N does not matter.
const AMPLIFIED_INTERVALS: f64 = 100.0;

/// The criteria that a plan has to meet.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanCriteria {
    /// Limits of positions, velocities and torques that a plan may use.
    pub limits: Limits,
    /// Torque limits of the drives at 100 %, N m.
    pub tau_max: ActuatedVector,
    /// Largest defect (6b) of an interval, rad and rad/s.
    pub defect: f64,
    /// Start tolerance: largest deviation of each position (rad or m) and each velocity (rad/s or m/s) from the plan at its start.
    pub tolerance: State,
    /// Delays of the feedback loop.
    pub delays: LoopDelays,
    /// Largest amplification of a deviation of one row of the state by the start tolerance: root of the sum of the squares of all rows at
    /// this and all later knots, in units of the start tolerance, as if the plan had 100 intervals.
    pub amplification: f64,
}

/// The first criterion that a plan does not meet.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnmetCriterion {
    /// The plan has too few or too many intervals.
    #[error("N is {got}, expected {} to {}", INTERVALS.start(), INTERVALS.end())]
    Intervals {
        /// Number of intervals.
        got: usize,
    },
    /// A part of the plan has another number of knots than its states.
    #[error("{what} has {got} knots, x has {expected}")]
    Knots {
        /// Symbol of the quantity in the plan.
        what: &'static str,
        /// Number of knots of x.
        expected: usize,
        /// Number of knots of the quantity.
        got: usize,
    },
    /// A part of the plan was made for a chain with other numbers of joints.
    #[error(
        "{what} is for {} joints with {} motors, the model has {} joints with {} motors",
        .got.joints(), .got.actuated(), .expected.joints(), .expected.actuated()
    )]
    Sizes {
        /// Symbol of the quantity in the plan.
        what: &'static str,
        /// Numbers of joints of the model.
        expected: Sizes,
        /// Numbers of joints of the quantity.
        got: Sizes,
    },
    /// A number of the plan is NaN or infinite.
    #[error("{what} at knot {knot} is {got}, expected a finite number")]
    NotFinite {
        /// Symbol of the quantity in the plan.
        what: &'static str,
        /// Number of the knot.
        knot: usize,
        /// The number.
        got: f64,
    },
    /// t_F is not above 0, or above [`Trajectory::LONGEST`].
    #[error("t_F is {got} s, expected more than 0 and at most {longest} s", longest = Trajectory::LONGEST)]
    Duration {
        /// t_F, s.
        got: f64,
    },
    /// The trajectory exceeds a limit.
    #[error(
        "{kind} of joint `{name}` at knot {knot:.2} is {got:.4}, expected {lowest:.4} to {highest:.4} {unit}"
    )]
    Limit {
        /// The kind of the limit.
        kind: LimitKind,
        /// Index of the joint in sorted vectors.
        joint: usize,
        /// Name of the joint.
        name: String,
        /// Unit of the numbers below.
        unit: &'static str,
        /// Number of the knot; with a fraction between two knots.
        knot: f64,
        /// The value in the plan.
        got: f64,
        /// Lower limit, with the slack that plans are granted.
        lowest: f64,
        /// Upper limit, with the slack that plans are granted.
        highest: f64,
    },
    /// f_k is not f(x_k, u_k) of the daemon's model.
    #[error("f at knot {knot}, row {row} is {got}, the model gives {expected}")]
    Derivative {
        /// Number of the knot.
        knot: usize,
        /// Row of f.
        row: usize,
        /// The value in the plan, rad/s or rad/s^2.
        got: f64,
        /// The value of the model, rad/s or rad/s^2.
        expected: f64,
    },
    /// The spline (12) jumps at a knot: the defect (6b) is too large.
    #[error(
        "{kind} of joint `{name}` jumps by {got:.2e} {unit} before knot {knot}: its defect (6b) is expected to be at most {most:.0e}"
    )]
    Defect {
        /// Position or velocity.
        kind: LimitKind,
        /// Index of the joint in sorted vectors.
        joint: usize,
        /// Name of the joint.
        name: String,
        /// Unit of the numbers below.
        unit: &'static str,
        /// Number of the knot at the end of the interval.
        knot: usize,
        /// Magnitude of the defect.
        got: f64,
        /// Largest accepted magnitude.
        most: f64,
    },
    /// The plan does not end at rest in an equilibrium of the unactuated joints.
    #[error(
        "the plan ends at {speed:.4} rad/s, and the unactuated joints accelerate with {acceleration:.4} rad/s^2 there, \
         expected at most {REST_SPEED_PLAN_END} rad/s and {PLAN_END_ACCELERATION} rad/s^2"
    )]
    End {
        /// Largest joint velocity at x_N, rad/s or m/s.
        speed: f64,
        /// Largest acceleration of an unactuated joint in the pose of x_N at rest, rad/s^2 or m/s^2.
        acceleration: f64,
    },
    /// The final gain does not keep the unactuated joints where they stand.
    #[error(
        "the closed loop at the end of the plan is unstable: spectral radius {radius:.6}, expected below 1"
    )]
    Unstable {
        /// Spectral radius of the discrete closed loop with its delays.
        radius: f64,
    },
    /// A gain answers a deviation of one row of the state by the start tolerance with too much torque.
    #[error(
        "K at knot {knot} demands {got:.3e} {unit} at joint `{name}` for a deviation by the start tolerance, expected at most \
         {most:.1} {unit}"
    )]
    Step {
        /// Number of the knot; N + 1 for the gain that holds x_N.
        knot: usize,
        /// Index of the joint in sorted vectors.
        joint: usize,
        /// Name of the joint.
        name: String,
        /// Unit of the numbers below.
        unit: &'static str,
        /// The torque or force.
        got: f64,
        /// Largest accepted torque or force.
        most: f64,
    },
    /// The closed loop amplifies a deviation from the plan too much.
    #[error(
        "the closed loop amplifies a deviation at knot {knot} {got:.3e} times, expected at most {most} times"
    )]
    Amplification {
        /// Number of the knot.
        knot: usize,
        /// Root of the sum of the squares of all rows at this and all later knots, in units of the start tolerance, for a
        /// deviation of one row by its tolerance at this knot; as if the plan had 100 intervals.
        got: f64,
        /// Largest accepted amplification.
        most: f64,
    },
}

impl PlanCriteria {
    /// Checks that a robot may follow the plan, in this order: numbers of knots and joints; all numbers finite; t_F; positions and velocities (at the
    /// knots and at the extrema of the spline between them) and torques (9) (at the knots and at points between them); f_k
    /// against the model; defects (6b); rest at the end, in an equilibrium; the gains. Id and fingerprint of
    /// the plan are not checked here.
    ///
    /// # Errors
    /// The first criterion that the plan does not meet, with its numbers.
    pub fn check(&self, model: &Model, plan: &Plan) -> Result<(), UnmetCriterion> {
        self.check_motion(model, &plan.spline())?;
        self.check_feedback(model, &plan.trajectory, &plan.gains)
    }
}

/// Checks that all numbers of a quantity are finite, knot by knot.
fn finite<'a>(what: &'static str, knots: impl Iterator<Item = &'a [f64]>) -> Result<(), UnmetCriterion> {
    for (knot, values) in knots.enumerate() {
        if let Some(got) = values.iter().find(|v| !v.is_finite()) {
            return Err(UnmetCriterion::NotFinite { what, knot, got: *got });
        }
    }
    Ok(())
}

/// Checks that all parts of a quantity are for the numbers of joints of the model.
fn same_sizes(
    what: &'static str,
    model: &Model,
    mut sizes: impl Iterator<Item = Sizes>,
) -> Result<(), UnmetCriterion> {
    let expected = model.sizes();
    match sizes.find(|got| *got != expected) {
        Some(got) => Err(UnmetCriterion::Sizes { what, expected, got }),
        None => Ok(()),
    }
}
