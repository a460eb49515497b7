//! `daemon.toml`.

use crate::check::{ACUTE, Check, NON_NEGATIVE, POSITIVE};
use crate::{ConfigError, RobotSettings};
use serde::Deserialize;
use std::time::Duration;
use upswing_model::{NQ, NU};

/// The control daemon.
#[derive(Clone, Debug, PartialEq)]
pub struct DaemonSettings {
    /// The control cycle.
    pub cycle: CycleSettings,
    /// Holding a pose.
    pub hold: HoldGains,
    /// Deceleration of each actuated joint when stopping, rad/s^2.
    pub stop_deceleration: [f64; NU],
    /// What makes the daemon give up control.
    pub trip: TripLimits,
    /// Tilt of the rod from upright at which balance counts as lost, rad.
    pub balance_lost: f64,
    /// How well the measured state has to agree with the start of a plan.
    pub start: StartTolerance,
    /// The real-time thread.
    pub realtime: RealtimeSettings,
}

/// The control cycle, Section VI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSettings {
    /// Control period T_s.
    pub period: Duration,
    /// Time constant T_1 of the differential filter, s.
    pub velocity_filter: f64,
}

/// Gains of u = stiffness (reference - q) - damping qd for the actuated joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldGains {
    /// rad/s^2 per rad.
    pub stiffness: [f64; NU],
    /// rad/s^2 per rad/s.
    pub damping: [f64; NU],
}

/// What makes the daemon give up control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TripLimits {
    /// How far an angle may be past the range open to plans, rad.
    pub position_margin: f64,
    /// Speed as a share of the 100 % limits.
    pub velocity_fraction: f64,
    /// Largest difference between an angle and its reference, rad.
    pub tracking_error: f64,
    /// Age of the newest measurement, cycles.
    pub measurement_max_age: u32,
}

/// How well the measured state has to agree with the start of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartTolerance {
    /// Each angle, rad.
    pub position: f64,
    /// Each velocity, rad/s.
    pub velocity: f64,
}

/// The real-time thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealtimeSettings {
    /// What to do if real-time scheduling is refused.
    pub mode: RealtimeMode,
    /// SCHED_FIFO priority, 1 to 99.
    pub priority: u8,
    /// CPU the thread is pinned to, counted from 0.
    pub cpu: Option<usize>,
}

/// What to do if the system refuses locked memory or real-time scheduling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RealtimeMode {
    /// Warn and run anyway.
    Warn,
    /// Refuse to start.
    Strict,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    cycle: RawCycle,
    hold: RawHold,
    stop: RawStop,
    limits: RawTrip,
    balance: RawBalance,
    start: RawStart,
    realtime: RawRealtime,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCycle {
    period_us: i64,
    velocity_filter_ms: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHold {
    stiffness: Vec<f64>,
    damping: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStop {
    deceleration_rad_s2: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTrip {
    position_trip_margin_deg: f64,
    velocity_trip_fraction: f64,
    tracking_error_trip_rad: f64,
    measurement_max_age_cycles: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBalance {
    lost_deg: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStart {
    tolerance_rad: f64,
    tolerance_rad_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRealtime {
    mode: RealtimeMode,
    priority: i64,
    cpu: i64,
}

impl DaemonSettings {
    pub(crate) fn read(file: &str, text: &str, robot: &RobotSettings) -> Result<Self, ConfigError> {
        let check = Check { file };
        let raw: Raw = check.parse(text)?;

        let period_us: u64 = check.integer("cycle.period_us", raw.cycle.period_us, 1..=100_000)?;
        let filter_ms = check.number("cycle.velocity_filter_ms", raw.cycle.velocity_filter_ms, &POSITIVE)?;
        check.above(
            "cycle.velocity_filter_ms",
            filter_ms,
            period_us as f64 / 1e3,
            "cycle.period_us (in ms)",
        )?;

        let limits = &raw.limits;
        let velocity_fraction =
            check.number("limits.velocity_trip_fraction", limits.velocity_trip_fraction, &POSITIVE)?;
        for i in 0..NQ {
            let planned = robot.planning.qd_max[i] / robot.limits.qd_max[i];
            let planned_key = "usage.velocity_fraction_* in robot.toml";
            check.above("limits.velocity_trip_fraction", velocity_fraction, planned, planned_key)?;
        }

        Ok(Self {
            cycle: CycleSettings {
                period: Duration::from_micros(period_us),
                velocity_filter: filter_ms * 1e-3,
            },
            hold: HoldGains {
                stiffness: check.list("hold.stiffness", &raw.hold.stiffness, 1, &POSITIVE)?,
                damping: check.list("hold.damping", &raw.hold.damping, 1, &POSITIVE)?,
            },
            stop_deceleration: check.list(
                "stop.deceleration_rad_s2",
                &raw.stop.deceleration_rad_s2,
                1,
                &POSITIVE,
            )?,
            trip: TripLimits {
                position_margin: check
                    .number(
                        "limits.position_trip_margin_deg",
                        limits.position_trip_margin_deg,
                        &NON_NEGATIVE,
                    )?
                    .to_radians(),
                velocity_fraction,
                tracking_error: check.number(
                    "limits.tracking_error_trip_rad",
                    limits.tracking_error_trip_rad,
                    &POSITIVE,
                )?,
                measurement_max_age: check.integer(
                    "limits.measurement_max_age_cycles",
                    limits.measurement_max_age_cycles,
                    1..=1_000_000,
                )?,
            },
            balance_lost: check.number("balance.lost_deg", raw.balance.lost_deg, &ACUTE)?.to_radians(),
            start: StartTolerance {
                position: check.number("start.tolerance_rad", raw.start.tolerance_rad, &POSITIVE)?,
                velocity: check.number("start.tolerance_rad_s", raw.start.tolerance_rad_s, &POSITIVE)?,
            },
            realtime: RealtimeSettings {
                mode: raw.realtime.mode,
                priority: check.integer("realtime.priority", raw.realtime.priority, 1..=99)?,
                cpu: match check.integer("realtime.cpu", raw.realtime.cpu, -1..=1023)? {
                    -1 => None,
                    cpu => usize::try_from(cpu).ok(),
                },
            },
        })
    }
}
