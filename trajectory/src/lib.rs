//! Swing-up trajectories xi (7): their spline (12), gain schedule, checks against limits, and the database
//! file that holds them.

/// Number of collocation intervals, the paper's N.
pub const N: usize = 100;
/// Number of knots, x_0..x_N.
pub const KNOTS: usize = N + 1;
/// One value per knot, in the order of time; on the heap, because the gains alone are 100 KB.
pub type Knots<T> = Box<[T; KNOTS]>;

mod certificate;
mod database;
mod gate;
mod margins;
mod plan;
mod trajectory;

pub use certificate::{Certificate, follow};
pub use database::{Database, DatabaseError, Entry, Heading, Outcome, Record};
pub use gate::{Delays, Ending, Gate, Unfit};
pub use margins::{Margin, Margins};
pub use plan::{Gain, Plan, Reference};
pub use trajectory::{Spline, Trajectory};

/// Largest absolute component; infinite if one is not a number.
fn largest(v: &upswing_model::State) -> f64 {
    v.iter().fold(0.0, |worst: f64, v| if v.is_nan() { f64::INFINITY } else { worst.max(v.abs()) })
}
