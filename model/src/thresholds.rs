//! Thresholds of rest and of equal positions, of all programs in one table.
//!
//! "At rest" and "the same position" have a threshold per purpose: each is above the noise or rounding of the quantity that
//! it judges, and below the smallest difference that matters there.
//!
//! | Constant | Judged | Above | Below |
//! |---|---|---|---|
//! | [`REST_SPEED_STOP`] | measured arm at the end of Stop | 0.05 rad/s that a swinging pendulum leaves in joints 5 and 7 | speeds that Hold would have to catch |
//! | [`REST_SPEED_ESTIMATE`] | measured arm while the disturbance estimate settles | noise of the velocity filter | speeds at which model errors change the estimate |
//! | [`REST_SPEED_REPORT`] | measured arm after a swing-up | a third of it, left one second into Balance | a swing-up that did not settle |
//! | [`REST_SPEED_START`] | measured state before a plan is made | noise of the velocity filter | the tolerance of a plan's start, 0.2 rad/s |
//! | [`REST_SPEED_PLAN_END`] | computed end of a plan | the tolerance of a solver | [`REST_SPEED_START`]: the plan adds nothing that is measured |
//! | [`REST_SPEED_BRAKED`] | simulated joint behind closed brakes | rounding; the speed decays without end | everything that an encoder shows |
//! | [`PLAN_END_ACCELERATION`] | pendulum in the computed end of a plan | the tolerance of a solver | [`HELD_ACCELERATION`] |
//! | [`HELD_ACCELERATION`] | pendulum of an arm at rest | bearings hold a rod 2 deg off its hanging position | the turning point of a swing |
//! | [`EQUILIBRIUM_ACCELERATION`] | pendulum in the target x_T | rounding | what bearings hold |
//! | [`SAME_START`] | starts of two plans | encoder steps | a hundredth of the tolerance of a plan's start |
//! | [`START_SLACK`] | measured start beside its limits | noise of an arm that stands on its limit | what a plan could not return from |
//! | [`PLAN_POSITION_SLACK`] | plan beside its limits | [`START_SLACK`], the tolerance of a solver | what the drives could not follow |
//! | [`REPORT_POSITION_SLACK`] | measured joint beside its limit | a few steps of an encoder | a joint that left its range |
//!
//! A speed that the operator may change is a setting: `recovery.rest_speed_rad_s` in `daemon.toml` judges the pendulum before a
//! swing-up of the recovery.

/// Speed of each actuated joint, rad/s, below which Stop may end in Hold.
pub const REST_SPEED_STOP: f64 = 0.1;

/// Speed of the actuated joints, rad/s, below which the disturbance estimate changes because a joint does not move.
pub const REST_SPEED_ESTIMATE: f64 = 0.05;

/// Largest speed of the arm, rad/s, in the last second of a successful swing-up. Assumed: three times the speed of a nominal
/// swing-up after one second of Balance.
pub const REST_SPEED_REPORT: f64 = 0.05;

/// The same for fast machines, as a share of the largest 100 % speed of an actuated joint. Assumed: their encoders are coarser for their
/// speed.
pub const REST_SHARE_REPORT: f64 = 0.02;

/// Largest speed of each joint, rad/s, in a measured state from which a plan starts at rest.
pub const REST_SPEED_START: f64 = 0.02;

/// Largest speed of each joint, rad/s, at the end of a plan.
pub const REST_SPEED_PLAN_END: f64 = 1e-2;

/// Largest acceleration of the unactuated joints, rad/s^2, at the end of a plan, with the actuated joints at rest.
pub const PLAN_END_ACCELERATION: f64 = 0.5;

/// Speed of a simulated joint, rad/s, below which closed brakes hold it.
pub const REST_SPEED_BRAKED: f64 = 1e-6;

/// Largest acceleration of the unactuated joints, rad/s^2, of a pendulum that bearings hold where it hangs.
pub const HELD_ACCELERATION: f64 = 1.0;

/// Largest acceleration of the unactuated joints, rad/s^2, in an equilibrium of the model.
pub const EQUILIBRIUM_ACCELERATION: f64 = 1e-3;

/// Largest difference of each angle, rad, between two states at rest for which one plan serves.
pub const SAME_START: f64 = 5e-4;

/// Largest excess of a measured start over a position limit, rad.
pub const START_SLACK: f64 = 1e-3;

/// Largest excess of a plan over a position limit, rad.
pub const PLAN_POSITION_SLACK: f64 = 1e-3;

/// Largest excess of a measured joint over a position limit, rad, in the report of a run.
pub const REPORT_POSITION_SLACK: f64 = 1e-4;
