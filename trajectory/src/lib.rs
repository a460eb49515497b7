//! Trajectories xi (7), the spline (12) through their knots, plans with their feedback gains, the criteria that a plan
//! has to meet, and the database file.

mod certificate;
mod criteria;
mod database;
mod gains;
mod margins;
mod plan;
mod trajectory;

pub use certificate::{Certificate, end_error, open_loop_end};
pub use criteria::{LoopDelays, PlanCriteria, UnmetCriterion};
pub use database::{
    Database, DatabaseContents, DatabaseError, DatabaseHeading, DatabaseSource, Entry, Index, KeyTree,
    Neighbour, PoseOutcome, PoseRecord, RecordScan, read_record,
};
pub use gains::{Gain, Gains, InterpolatedGain};
pub use margins::{Margin, Margins};
pub use plan::{Plan, Reference};
pub use trajectory::{Spline, Trajectory};

/// Numbers of collocation intervals, N of the paper, that a trajectory may have.
pub const INTERVALS: std::ops::RangeInclusive<usize> = 20..=1000;

/// Largest absolute component of a state; infinite if a component is NaN.
fn largest(x: &upswing_model::State) -> f64 {
    x.iter().fold(0.0, |worst: f64, v| if v.is_nan() { f64::INFINITY } else { worst.max(v.abs()) })
}
