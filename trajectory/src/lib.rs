//! Trajectories xi (7), the spline (12) through their knots, plans with their feedback gains, the criteria that a plan
//! has to meet, and the database file.

/// Number of collocation intervals, N of the paper.
pub const N: usize = 100;
/// Number of knots, x_0..x_N.
pub const KNOTS: usize = N + 1;
/// One value per knot, in the order of time; on the heap, because the gains alone are 100 KB.
pub type Knots<T> = Box<[T; KNOTS]>;

mod certificate;
mod criteria;
mod database;
mod margins;
mod plan;
mod trajectory;

pub use certificate::{Certificate, open_loop_end};
pub use criteria::{Ending, LoopDelays, PlanCriteria, UnmetCriterion};
pub use database::{Database, DatabaseError, DatabaseHeading, Entry, PoseOutcome, PoseRecord};
pub use margins::{Margin, Margins};
pub use plan::{Gain, Gains, Plan, Reference};
pub use trajectory::{Spline, Trajectory};

/// Largest absolute component of a state; infinite if a component is NaN.
fn largest(x: &upswing_model::State) -> f64 {
    x.iter().fold(0.0, |worst: f64, v| if v.is_nan() { f64::INFINITY } else { worst.max(v.abs()) })
}
