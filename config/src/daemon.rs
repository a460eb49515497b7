//! Settings of the control daemon, `daemon.toml`.

use crate::RobotSettings;
use crate::conflict::{SettingsConflict, milliseconds};
use crate::joints::{Prismatic, Revolute, both_kinds};
use crate::rule::{
    BetweenZeroAndOne, Count, NonNegative, Positive, Quantity, QuarterTurn, Rule, Share, WaitingTime, Whole,
};
use serde::de::{Deserialize, Deserializer, Error};
use std::marker::PhantomData;
use std::path::PathBuf;
use std::time::Duration;
use upswing_model::{ActuatedVector, JointVector, Joints, Period};

/// Settings of the control daemon.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DaemonSettings {
    /// Control cycle.
    pub cycle: CycleSettings,
    /// Feedback in the mode Hold.
    pub hold: HoldGains,
    /// Deceleration in the mode Stop.
    pub stop: StopSettings,
    /// Disturbance estimate.
    pub disturbance: DisturbanceSettings,
    /// Detection of stuck encoders.
    pub standstill: StandstillSettings,
    /// Levels at which the daemon warns and at which it trips to Stop or Fault.
    pub limits: Levels,
    /// Criteria for the acceptance of plans.
    pub plans: PlanSettings,
    /// Swing-up after a lost balance.
    pub recovery: RecoverySettings,
    /// Flight recorder.
    pub recorder: RecorderSettings,
    /// Largest difference between the measured state and the start of a plan.
    pub start: StartTolerance,
    /// Real-time thread.
    pub realtime: RealtimeSettings,
}

/// Settings of the control cycle, Section VI.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CycleSettings {
    /// Control period T_s.
    #[serde(rename = "period_us", deserialize_with = "Whole::<1, 100_000>::period")]
    pub period: Period,
    /// Time constant T_1 of the differential filter, s; above T_s.
    #[serde(rename = "velocity_filter_ms", deserialize_with = "Positive::milli")]
    pub velocity_filter: f64,
    /// Method of the velocity estimate.
    pub velocity: VelocityEstimate,
}

/// Method that estimates velocities from measured angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum VelocityEstimate {
    /// The differential filter alone, as in the paper.
    Filter,
    /// The filter, with its lag corrected by the model.
    Model,
}

/// Gains of u = stiffness (reference - q) - damping qd for the actuated joints.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HoldGains {
    /// Gain of the position, 1/s^2.
    #[serde(deserialize_with = "Positive::read")]
    pub stiffness: ActuatedVector,
    /// Gain of the velocity, 1/s.
    #[serde(deserialize_with = "Positive::read")]
    pub damping: ActuatedVector,
}

/// Settings of the mode Stop.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopSettings {
    /// Deceleration of each actuated joint, rad/s^2 or m/s^2.
    #[serde(rename = "deceleration_rad_s2", deserialize_with = "Positive::read")]
    pub deceleration: ActuatedVector,
}

/// Settings of the disturbance observer, which estimates the torque on the arm in addition to the commanded torque.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DisturbanceSettings {
    /// Bandwidth in directions of large inertia, rad/s; 0: no estimate.
    #[serde(rename = "bandwidth_rad_s", deserialize_with = "NonNegative::read")]
    pub bandwidth: f64,
    /// Bandwidth in directions of small inertia, rad/s; not below `bandwidth`.
    #[serde(rename = "light_bandwidth_rad_s", deserialize_with = "NonNegative::read")]
    pub light_bandwidth: f64,
    /// Inertia of a direction whose bandwidth is the mean of `bandwidth` and `light_bandwidth`, kg m^2.
    #[serde(rename = "light_inertia_kg_m2", deserialize_with = "Positive::read")]
    pub light_inertia: f64,
    /// Largest estimated torque, as a share of the 100 % torque limits.
    #[serde(rename = "torque_fraction", deserialize_with = "Share::read")]
    pub most: f64,
}

/// Settings of the detector of stuck encoders, which monitors angles that do not change.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StandstillSettings {
    /// Smallest motion of each joint that its encoder always detects, rad or m.
    #[serde(rename = "angle_rad", deserialize_with = "Positive::read")]
    pub angle: JointVector,
    /// Largest presliding friction of each joint, N m s/rad or N s/m.
    #[serde(rename = "friction_nms_rad", deserialize_with = "NonNegative::read")]
    pub friction: JointVector,
    /// Unknown torque that may act on each joint at standstill, N m or N.
    #[serde(rename = "unknown_torque_nm", deserialize_with = "NonNegative::read")]
    pub unknown: JointVector,
    /// Smallest change of a commanded torque that a torque sensor always detects, as a share of the 100 % torque limits.
    #[serde(rename = "torque_fraction", deserialize_with = "Share::read")]
    pub torque: f64,
}

/// Two levels of a monitored quantity: the daemon warns above `warn` and trips above `trip`; warn < trip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Warning level.
    pub warn: f64,
    /// Trip level.
    pub trip: f64,
}

impl Quantity for Level {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        #[derive(serde::Deserialize)]
        #[serde(deny_unknown_fields, bound = "R: Rule")]
        struct LevelInFile<R> {
            #[serde(deserialize_with = "R::read")]
            warn: f64,
            #[serde(deserialize_with = "R::read")]
            trip: f64,
            #[serde(skip)]
            rule: PhantomData<R>,
        }
        let LevelInFile { warn, trip, .. } = LevelInFile::<R>::deserialize(from)?;
        SettingsConflict::unless_above(".trip", trip, warn, "warn").map_err(D::Error::custom)?;
        Ok(Self { warn: warn * unit, trip: trip * unit })
    }
}

/// Levels of all quantities that the daemon monitors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Levels {
    /// Age of the newest measurement, cycles.
    #[serde(rename = "measurement_age_cycles", deserialize_with = "Count::read")]
    pub measurement_age: Level,
    /// Duration for which the drives are off although the brakes are commanded open, cycles.
    #[serde(rename = "drives_stopped_cycles", deserialize_with = "Count::read")]
    pub drives_stopped: Level,
    /// Number of measurements missed between two received measurements.
    #[serde(deserialize_with = "Count::read")]
    pub measurement_gap: Level,
    /// Change of an angle between two measurements beyond the change at the joint's largest speed, rad.
    #[serde(rename = "encoder_jump_rad", deserialize_with = "Positive::read")]
    pub encoder_jump: Level,
    /// The same for prismatic joints, m.
    #[serde(deserialize_with = "Positive::read")]
    pub encoder_jump_m: Level,
    /// Distance of an angle beyond the position limits of plans, rad.
    #[serde(rename = "position_margin_deg", deserialize_with = "NonNegative::degrees")]
    pub position_margin: Level,
    /// The same for prismatic joints, m.
    #[serde(deserialize_with = "NonNegative::read")]
    pub position_margin_m: Level,
    /// Speed of the actuated joints, as a share of the 100 % limits.
    #[serde(deserialize_with = "Positive::read")]
    pub velocity_fraction: Level,
    /// Measured torque, as a share of the 100 % limits.
    #[serde(deserialize_with = "Positive::read")]
    pub torque_fraction: Level,
    /// Rate of the commanded torque, as a share of the 100 % limits per s.
    #[serde(rename = "torque_rate_per_ms", deserialize_with = "Positive::per_milli")]
    pub torque_rate: Level,
    /// Difference between an angle and its reference, rad.
    #[serde(rename = "tracking_error_rad", deserialize_with = "Positive::read")]
    pub tracking_error: Level,
    /// The same for prismatic joints, m.
    #[serde(deserialize_with = "Positive::read")]
    pub tracking_error_m: Level,
    /// Disturbance torque on the arm that the model does not explain, as a share of the 100 % limits.
    #[serde(rename = "collision_torque_fraction", deserialize_with = "Positive::read")]
    pub collision_torque: Level,
    /// Shortest duration of the unexplained torque that counts as a collision, s.
    #[serde(rename = "collision_ms", deserialize_with = "Positive::milli")]
    pub collision_time: f64,
    /// Distance of an actuated joint from the pose held in Hold, rad.
    #[serde(rename = "hold_error_rad", deserialize_with = "Positive::read")]
    pub hold_error: Level,
    /// The same for prismatic joints, m.
    #[serde(deserialize_with = "Positive::read")]
    pub hold_error_m: Level,
    /// Distance of an actuated joint from the end of the plan in Balance, rad.
    #[serde(rename = "balance_error_rad", deserialize_with = "Positive::read")]
    pub balance_error: Level,
    /// The same for prismatic joints, m.
    #[serde(deserialize_with = "Positive::read")]
    pub balance_error_m: Level,
    /// Distance |q_U - q_U,N| of the unactuated joints from the end of the plan in Balance, rad; 1 m of a prismatic joint counts as 1 rad.
    #[serde(rename = "balance_distance_rad", deserialize_with = "QuarterTurn::read")]
    pub balance_distance: Level,
    /// Predicted speed of the actuated joints in Balance, as a share of the 100 % limits.
    #[serde(rename = "balance_speed_fraction", deserialize_with = "Positive::read")]
    pub balance_speed: Level,
    /// Number of consecutive late cycles.
    #[serde(deserialize_with = "Count::read")]
    pub late_cycles: Level,
    /// Age of a loaded plan, s.
    #[serde(rename = "plan_age_s", deserialize_with = "Positive::read")]
    pub plan_age: Level,
}

/// Settings of the acceptance of plans, used by [`crate::Config::plan_criteria`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanSettings {
    /// Treatment of plans that arrive in the mode Track.
    pub while_tracking: PlanWhileTracking,
    /// Largest defect of (6b), rad and rad/s per interval.
    #[serde(deserialize_with = "BetweenZeroAndOne::read")]
    pub defect: f64,
    /// Largest defect of a plan from one QP ([`crate::ReplanSettings::iterations`] = 1), rad and rad/s per interval.
    #[serde(deserialize_with = "BetweenZeroAndOne::read")]
    pub defect_of_one_qp: f64,
    /// Largest amplification of a deviation by the start tolerance, see [`upswing_trajectory::PlanCriteria::amplification`].
    #[serde(deserialize_with = "Positive::read")]
    pub amplification: f64,
    /// Delay from a measurement to its torque in the stability check of the closed loop, periods.
    #[serde(rename = "delay_cycles", deserialize_with = "Whole::<0, 8>::read")]
    pub delay: usize,
}

/// Treatment of plans that arrive in the mode Track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlanWhileTracking {
    /// The newest plan is kept for the next start.
    Queue,
    /// Plans are refused.
    Refuse,
}

/// Settings of the swing-up after a lost balance.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecoverySettings {
    /// Largest number of consecutive swing-ups that the daemon starts without a request of the operator; 0: none.
    #[serde(deserialize_with = "Whole::<0, 1000>::read")]
    pub attempts: u32,
    /// Speed below which an unactuated joint is at rest, rad/s.
    #[serde(rename = "rest_speed_rad_s", deserialize_with = "Positive::read")]
    pub rest_speed: f64,
    /// Time for which the unactuated joints have to be at rest before a plan is requested.
    #[serde(rename = "rest_s", deserialize_with = "WaitingTime::read")]
    pub rest: Duration,
    /// Longest wait for the rest of the pendulum, and for a plan.
    #[serde(rename = "patience_s", deserialize_with = "WaitingTime::read")]
    pub patience: Duration,
}

/// Settings of the flight recorder.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecorderSettings {
    /// Folder of the flight records; `None` (an empty path in the file): no flight records.
    #[serde(deserialize_with = "folder")]
    pub directory: Option<PathBuf>,
    /// Number of flight records to keep, at least 1.
    #[serde(deserialize_with = "Whole::<1, 10_000>::read")]
    pub keep: usize,
}

fn folder<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
    Ok(Some(PathBuf::deserialize(from)?).filter(|path| !path.as_os_str().is_empty()))
}

/// Largest difference between the measured state and the start of a plan.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(try_from = "StartToleranceInFile")]
pub struct StartTolerance {
    /// Tolerance of each position, rad or m.
    pub position: JointVector,
    /// Tolerance of each velocity, rad/s or m/s.
    pub velocity: JointVector,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct StartToleranceInFile {
    #[serde(default, deserialize_with = "Positive::read")]
    tolerance_rad: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "Positive::read")]
    tolerance_m: Option<Prismatic<Joints>>,
    #[serde(default, deserialize_with = "Positive::read")]
    tolerance_rad_s: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "Positive::read")]
    tolerance_m_s: Option<Prismatic<Joints>>,
}

impl TryFrom<StartToleranceInFile> for StartTolerance {
    type Error = String;

    fn try_from(file: StartToleranceInFile) -> Result<Self, String> {
        let (rad, m) = (("tolerance_rad", file.tolerance_rad), ("tolerance_m", file.tolerance_m));
        let (sizes, position) = both_kinds(rad, m)?;
        let (rad, m) = (("tolerance_rad_s", file.tolerance_rad_s), ("tolerance_m_s", file.tolerance_m_s));
        let (_, velocity) = both_kinds(rad, m)?;
        let vector = |values: Vec<f64>| JointVector::from_fn(sizes, |i| values[i]);
        Ok(Self { position: vector(position), velocity: vector(velocity) })
    }
}

/// Settings of the real-time thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealtimeSettings {
    /// Reaction to a refusal of real-time scheduling.
    pub mode: RealtimeMode,
    /// SCHED_FIFO priority, 1 to 99.
    #[serde(deserialize_with = "Whole::<1, 99>::read")]
    pub priority: u8,
    /// CPU to which the thread is pinned, counted from 0; `None` (-1 in the file): any CPU.
    #[serde(deserialize_with = "cpu")]
    pub cpu: Option<usize>,
}

fn cpu<'de, D: Deserializer<'de>>(from: D) -> Result<Option<usize>, D::Error> {
    Whole::<-1, 1023>::read(from).map(|cpu: i64| usize::try_from(cpu).ok())
}

/// Reaction to a system that refuses locked memory or real-time scheduling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RealtimeMode {
    /// The daemon warns and runs.
    Warn,
    /// The daemon does not start.
    Strict,
}

impl DaemonSettings {
    /// Checks the rules between the settings of the daemon, and between them and the limits of the robot.
    pub(crate) fn validate(&self, robot: &RobotSettings) -> Result<(), SettingsConflict> {
        let period = milliseconds(self.cycle.period.seconds());
        let filter = milliseconds(self.cycle.velocity_filter);
        SettingsConflict::unless_above(
            "cycle.velocity_filter_ms",
            filter,
            period,
            "cycle.period_us (in ms)",
        )?;

        let DisturbanceSettings { bandwidth, light_bandwidth, .. } = self.disturbance;
        if light_bandwidth < bandwidth {
            return Err(SettingsConflict::new(
                "disturbance.light_bandwidth_rad_s",
                format!("at least disturbance.bandwidth_rad_s, {bandwidth}"),
                light_bandwidth,
                "a torque accelerates a small inertia more",
            ));
        }

        let trip = self.limits.velocity_fraction.trip;
        let mut speeds = robot.planning.qd_max.iter().zip(robot.limits.qd_max.iter());
        speeds.try_for_each(|(planned, rated)| {
            let planned_key = "usage.velocity_fraction_* in robot.toml";
            SettingsConflict::unless_above(
                "limits.velocity_fraction.trip",
                trip,
                planned / rated,
                planned_key,
            )
        })
    }
}
