//! `daemon.toml`.

use crate::check::{ACUTE, BELOW_ONE, COUNT, Check, NON_NEGATIVE, POSITIVE, SHARE};
use crate::{ConfigError, RobotSettings};
use serde::Deserialize;
use std::path::PathBuf;
use std::time::Duration;
use upswing_model::{NQ, NU, Period};

/// The control daemon.
#[derive(Clone, Debug, PartialEq)]
pub struct DaemonSettings {
    /// The control cycle.
    pub cycle: CycleSettings,
    /// Holding a pose.
    pub hold: HoldGains,
    /// Deceleration of each actuated joint when stopping, rad/s^2.
    pub stop_deceleration: [f64; NU],
    /// Estimate of the torque that acts besides the commanded one.
    pub disturbance: DisturbanceSettings,
    /// Encoders that are stuck.
    pub standstill: StandstillSettings,
    /// When the daemon warns and when it gives up control.
    pub limits: Levels,
    /// Which plans are accepted.
    pub plans: PlanSettings,
    /// What follows a lost balance.
    pub recovery: RecoverySettings,
    /// The flight recorder.
    pub recorder: RecorderSettings,
    /// How well the measured state has to agree with the start of a plan.
    pub start: StartTolerance,
    /// The real-time thread.
    pub realtime: RealtimeSettings,
}

/// The control cycle, Section VI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSettings {
    /// Control period T_s.
    pub period: Period,
    /// Time constant T_1 of the differential filter, s.
    pub velocity_filter: f64,
    /// Where velocities come from.
    pub velocity: VelocityEstimate,
}

/// Where velocities come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum VelocityEstimate {
    /// The differential filter alone, as in the paper.
    Filter,
    /// The filter, with its lag corrected by the model.
    Model,
}

/// Gains of u = stiffness (reference - q) - damping qd for the actuated joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldGains {
    /// rad/s^2 per rad.
    pub stiffness: [f64; NU],
    /// rad/s^2 per rad/s.
    pub damping: [f64; NU],
}

/// Estimate of the torque that acts on the arm besides the commanded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisturbanceSettings {
    /// Bandwidth where the arm is heavy, rad/s; 0: no estimate.
    pub bandwidth: f64,
    /// Bandwidth where the arm is light, rad/s; not below `bandwidth`.
    pub light_bandwidth: f64,
    /// Inertia in whose direction the bandwidth is the mean of both, kg m^2.
    pub light_inertia: f64,
    /// Largest estimate, as a share of the 100 % torque limits.
    pub most: f64,
}

/// When an angle that does not change belongs to a stuck encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandstillSettings {
    /// Motion that every encoder shows, rad.
    pub angle: [f64; NQ],
    /// Largest presliding friction, N m s/rad.
    pub friction: [f64; NQ],
    /// Torque that may act without being known, N m.
    pub unknown: [f64; NQ],
    /// Change of a commanded torque that every torque sensor shows, as a share of the 100 % torque limits.
    pub torque: f64,
}

/// Above `warn` the daemon warns, above `trip` it gives up control; warn < trip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Warning.
    pub warn: f64,
    /// Loss of control.
    pub trip: f64,
}

/// When the daemon warns and when it gives up control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    /// Age of the newest measurement, cycles.
    pub measurement_age: Level,
    /// Cycles in which the drives do not act although the brakes are commanded open.
    pub drives_stopped: Level,
    /// Measurements missed between two that were seen.
    pub measurement_gap: Level,
    /// Change of an angle between two measurements beyond what its speed explains, rad.
    pub encoder_jump: Level,
    /// How far an angle is past the range open to plans, rad.
    pub position_margin: Level,
    /// Speed of the arm as a share of the 100 % limits.
    pub velocity_fraction: Level,
    /// Measured torque as a share of the 100 % limits.
    pub torque_fraction: Level,
    /// Change of the commanded torque, share of the 100 % limits per s.
    pub torque_rate: Level,
    /// Difference between an angle and its reference, rad.
    pub tracking_error: Level,
    /// Torque on the arm that nothing explains, share of the 100 % limits.
    pub collision_torque: Level,
    /// How long it lasts until it is a collision, s.
    pub collision_time: f64,
    /// Distance of the arm from the pose that it holds, rad.
    pub hold_error: Level,
    /// Distance of the arm from the end of the plan in balance, rad.
    pub balance_error: Level,
    /// Tilt of the rod from upright in balance, rad.
    pub balance_tilt: Level,
    /// Speed that balancing is about to ask of the arm, share of the 100 % limits.
    pub balance_speed: Level,
    /// Cycles in a row that ended late.
    pub late_cycles: Level,
    /// Age of a loaded plan, s.
    pub plan_age: Level,
}

/// Which plans are accepted, see [`crate::Config::plan_criteria`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanSettings {
    /// What happens to plans that arrive while one is being tracked.
    pub while_tracking: PlanWhileTracking,
    /// Largest defect of (6b), rad and rad/s per interval.
    pub defect: f64,
    /// The same where a plan is made by one QP, [`crate::ReplanSettings::iterations`] = 1.
    pub defect_of_one_qp: f64,
    /// Periods from a measurement until its torque acts, as the closed loop is judged.
    pub delay: usize,
}

/// What happens to plans that arrive while one is being tracked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlanWhileTracking {
    /// The newest is kept for the next start.
    Queue,
    /// They are refused.
    Refuse,
}

/// What follows a lost balance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecoverySettings {
    /// Swing-ups in a row that the daemon starts by itself.
    pub attempts: u32,
    /// Speed below which a joint of the pendulum is at rest, rad/s.
    pub rest_speed: f64,
    /// How long both have to be at rest.
    pub rest: Duration,
    /// Longest wait for the rest, and for a plan.
    pub patience: Duration,
}

/// The flight recorder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecorderSettings {
    /// Folder of its files; `None`: writes nothing.
    pub directory: Option<PathBuf>,
    /// Files to keep, at least 1.
    pub keep: usize,
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
    disturbance: RawDisturbance,
    standstill: RawStandstill,
    limits: RawLevels,
    plans: RawPlans,
    recovery: RawRecovery,
    recorder: RawRecorder,
    start: RawStart,
    realtime: RawRealtime,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCycle {
    period_us: i64,
    velocity_filter_ms: f64,
    velocity: VelocityEstimate,
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
struct RawDisturbance {
    bandwidth_rad_s: f64,
    light_bandwidth_rad_s: f64,
    light_inertia_kg_m2: f64,
    torque_fraction: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStandstill {
    angle_rad: Vec<f64>,
    friction_nms_rad: Vec<f64>,
    unknown_torque_nm: Vec<f64>,
    torque_fraction: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLevel {
    warn: f64,
    trip: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLevels {
    measurement_age_cycles: RawLevel,
    drives_stopped_cycles: RawLevel,
    measurement_gap: RawLevel,
    encoder_jump_rad: RawLevel,
    position_margin_deg: RawLevel,
    velocity_fraction: RawLevel,
    torque_fraction: RawLevel,
    torque_rate_per_ms: RawLevel,
    collision_torque_fraction: RawLevel,
    collision_ms: f64,
    tracking_error_rad: RawLevel,
    hold_error_rad: RawLevel,
    balance_error_rad: RawLevel,
    balance_tilt_deg: RawLevel,
    balance_speed_fraction: RawLevel,
    late_cycles: RawLevel,
    plan_age_s: RawLevel,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPlans {
    while_tracking: PlanWhileTracking,
    defect: f64,
    defect_of_one_qp: f64,
    delay_cycles: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRecovery {
    attempts: i64,
    rest_speed_rad_s: f64,
    rest_s: f64,
    patience_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRecorder {
    directory: PathBuf,
    keep: i64,
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

        let period_us: u32 = check.integer("cycle.period_us", raw.cycle.period_us, 1..=100_000)?;
        let filter_ms = check.number("cycle.velocity_filter_ms", raw.cycle.velocity_filter_ms, &POSITIVE)?;
        check.above(
            "cycle.velocity_filter_ms",
            filter_ms,
            f64::from(period_us) / 1e3,
            "cycle.period_us (in ms)",
        )?;

        let limits = raw.limits.check(check)?;
        for i in 0..NQ {
            let planned = robot.planning.qd_max[i] / robot.limits.qd_max[i];
            let planned_key = "usage.velocity_fraction_* in robot.toml";
            check.above(
                "limits.velocity_fraction.trip",
                limits.velocity_fraction.trip,
                planned,
                planned_key,
            )?;
        }
        let recovery = &raw.recovery;
        let RawDisturbance { bandwidth_rad_s, light_bandwidth_rad_s, .. } = raw.disturbance;
        if light_bandwidth_rad_s < bandwidth_rad_s {
            return Err(check.refuse(
                "disturbance.light_bandwidth_rad_s",
                format!("at least disturbance.bandwidth_rad_s, {bandwidth_rad_s}"),
                light_bandwidth_rad_s,
                "what is light is accelerated more",
            ));
        }

        Ok(Self {
            cycle: CycleSettings {
                period: Period::from_micros(period_us),
                velocity_filter: filter_ms * 1e-3,
                velocity: raw.cycle.velocity,
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
            disturbance: DisturbanceSettings {
                bandwidth: check.number(
                    "disturbance.bandwidth_rad_s",
                    raw.disturbance.bandwidth_rad_s,
                    &NON_NEGATIVE,
                )?,
                light_bandwidth: check.number(
                    "disturbance.light_bandwidth_rad_s",
                    raw.disturbance.light_bandwidth_rad_s,
                    &NON_NEGATIVE,
                )?,
                light_inertia: check.number(
                    "disturbance.light_inertia_kg_m2",
                    raw.disturbance.light_inertia_kg_m2,
                    &POSITIVE,
                )?,
                most: check.number("disturbance.torque_fraction", raw.disturbance.torque_fraction, &SHARE)?,
            },
            standstill: StandstillSettings {
                angle: check.list("standstill.angle_rad", &raw.standstill.angle_rad, 1, &POSITIVE)?,
                friction: check.list(
                    "standstill.friction_nms_rad",
                    &raw.standstill.friction_nms_rad,
                    1,
                    &NON_NEGATIVE,
                )?,
                unknown: check.list(
                    "standstill.unknown_torque_nm",
                    &raw.standstill.unknown_torque_nm,
                    1,
                    &NON_NEGATIVE,
                )?,
                torque: check.number("standstill.torque_fraction", raw.standstill.torque_fraction, &SHARE)?,
            },
            limits,
            plans: PlanSettings {
                while_tracking: raw.plans.while_tracking,
                defect: check.number("plans.defect", raw.plans.defect, &BELOW_ONE)?,
                defect_of_one_qp: check.number(
                    "plans.defect_of_one_qp",
                    raw.plans.defect_of_one_qp,
                    &BELOW_ONE,
                )?,
                delay: check.integer("plans.delay_cycles", raw.plans.delay_cycles, 0..=8)?,
            },
            recovery: RecoverySettings {
                attempts: check.integer("recovery.attempts", recovery.attempts, 0..=1000)?,
                rest_speed: check.number(
                    "recovery.rest_speed_rad_s",
                    recovery.rest_speed_rad_s,
                    &POSITIVE,
                )?,
                rest: check.seconds("recovery.rest_s", recovery.rest_s)?,
                patience: check.seconds("recovery.patience_s", recovery.patience_s)?,
            },
            recorder: RecorderSettings {
                directory: Some(raw.recorder.directory).filter(|path| !path.as_os_str().is_empty()),
                keep: check.integer("recorder.keep", raw.recorder.keep, 1..=10_000)?,
            },
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

impl RawLevels {
    fn check(&self, check: Check<'_>) -> Result<Levels, ConfigError> {
        let level = |key: &str, raw: &RawLevel, rule| {
            let key = |level| format!("limits.{key}.{level}");
            let warn = check.number(&key("warn"), raw.warn, rule)?;
            let trip = check.number(&key("trip"), raw.trip, rule)?;
            check.above(&key("trip"), trip, warn, "warn")?;
            Ok::<_, ConfigError>(Level { warn, trip })
        };
        let scaled =
            |level: Level, factor: f64| Level { warn: level.warn * factor, trip: level.trip * factor };
        let to_rad = 1_f64.to_radians();
        Ok(Levels {
            measurement_age: level("measurement_age_cycles", &self.measurement_age_cycles, &COUNT)?,
            drives_stopped: level("drives_stopped_cycles", &self.drives_stopped_cycles, &COUNT)?,
            measurement_gap: level("measurement_gap", &self.measurement_gap, &COUNT)?,
            encoder_jump: level("encoder_jump_rad", &self.encoder_jump_rad, &POSITIVE)?,
            position_margin: scaled(
                level("position_margin_deg", &self.position_margin_deg, &NON_NEGATIVE)?,
                to_rad,
            ),
            velocity_fraction: level("velocity_fraction", &self.velocity_fraction, &POSITIVE)?,
            torque_fraction: level("torque_fraction", &self.torque_fraction, &POSITIVE)?,
            torque_rate: scaled(level("torque_rate_per_ms", &self.torque_rate_per_ms, &POSITIVE)?, 1e3),
            collision_torque: level("collision_torque_fraction", &self.collision_torque_fraction, &POSITIVE)?,
            collision_time: check.number("limits.collision_ms", self.collision_ms, &POSITIVE)? * 1e-3,
            tracking_error: level("tracking_error_rad", &self.tracking_error_rad, &POSITIVE)?,
            hold_error: level("hold_error_rad", &self.hold_error_rad, &POSITIVE)?,
            balance_error: level("balance_error_rad", &self.balance_error_rad, &POSITIVE)?,
            balance_tilt: scaled(level("balance_tilt_deg", &self.balance_tilt_deg, &ACUTE)?, to_rad),
            balance_speed: level("balance_speed_fraction", &self.balance_speed_fraction, &POSITIVE)?,
            late_cycles: level("late_cycles", &self.late_cycles, &COUNT)?,
            plan_age: level("plan_age_s", &self.plan_age_s, &POSITIVE)?,
        })
    }
}
