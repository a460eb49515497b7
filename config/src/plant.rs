//! Settings of the simulated plant, `plant.toml`.

use crate::conflict::SettingsConflict;
use crate::joints::{Prismatic, Revolute, both_kinds};
use crate::rule::{Angle, Finite, NonNegative, Positive, Rule, Share, Whole};
use crate::{Fault, Push, RobotSettings};
use serde::Deserialize;
use upswing_model::{Actuated, ActuatedVector, JointVector, Joints, Model};

/// Largest delay of a command, and of a measurement under the fault `DelayMeasurement`, cycles.
pub const MAX_DELAY: u32 = 63;

/// Settings of the simulated robot, pendulum, drives and encoders.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantSettings {
    /// Differences between the simulated bodies and their URDF.
    pub model: ModelSettings,
    /// Integration of the equations of motion.
    pub integrator: IntegratorSettings,
    /// Encoders of all joints.
    pub encoder: EncoderSettings,
    /// Drives and brakes.
    pub drive: DriveSettings,
    /// Joint friction.
    pub friction: FrictionSettings,
    /// Joint stops.
    pub stops: JointStopSettings,
    /// State after power-up.
    pub start: PlantStart,
    /// Faults of the scenario; empty without a scenario.
    #[serde(skip)]
    pub faults: Vec<Fault>,
    /// Pushes of the scenario on the rod; empty without a scenario.
    #[serde(skip)]
    pub pushes: Vec<Push>,
}

/// Differences between the simulated bodies and their URDF.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelSettings {
    /// URDF of the simulated bodies: a file of the set, or a path with a `/`. [`crate::Config::plant_model`] is read from it.
    pub urdf: String,
    /// Factor of the masses and inertias of the actuated bodies.
    #[serde(deserialize_with = "Positive::read")]
    pub actuated_mass_scale: f64,
    /// Factor of the masses and inertias of the unactuated bodies.
    #[serde(deserialize_with = "Positive::read")]
    pub unactuated_mass_scale: f64,
    /// Factor of the length of the rod, at the same mass.
    #[serde(deserialize_with = "Positive::read")]
    pub unactuated_length_scale: f64,
    /// Point mass on the last actuated body, kg.
    #[serde(rename = "payload_kg", deserialize_with = "NonNegative::read")]
    pub payload: f64,
    /// Position of the point mass in the frame of the last actuated body, m.
    #[serde(rename = "payload_position_m", deserialize_with = "Finite::read")]
    pub payload_position: [f64; 3],
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2 or kg.
    #[serde(rename = "rotor_inertia_kg_m2", deserialize_with = "NonNegative::read")]
    pub rotor_inertia: ActuatedVector,
}

/// Settings of the integration of the equations of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IntegratorSettings {
    /// Runge-Kutta steps per control period.
    #[serde(deserialize_with = "Whole::<1, 1000>::read")]
    pub substeps: u32,
}

/// Settings of the encoders: the true position plus bias plus noise, rounded to the resolution.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "EncoderInFile")]
pub struct EncoderSettings {
    /// Resolution of each position, rad or m.
    pub resolution: JointVector,
    /// Standard deviation of the white Gaussian noise of each position, rad or m.
    pub noise: JointVector,
    /// Error of the zero position of each joint, rad or m.
    pub bias: JointVector,
    /// Seed of the encoder noise.
    pub seed: u64,
}

/// Settings of the encoders as a file states them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EncoderInFile {
    #[serde(default, deserialize_with = "Positive::read")]
    resolution_rad: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "Positive::read")]
    resolution_m: Option<Prismatic<Joints>>,
    #[serde(default, deserialize_with = "NonNegative::read")]
    noise_rad: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "NonNegative::read")]
    noise_m: Option<Prismatic<Joints>>,
    #[serde(default, deserialize_with = "Angle::degrees")]
    bias_deg: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "Finite::read")]
    bias_m: Option<Prismatic<Joints>>,
    #[serde(deserialize_with = "Whole::<0, { i64::MAX }>::read")]
    seed: u64,
}

impl TryFrom<EncoderInFile> for EncoderSettings {
    type Error = String;

    fn try_from(file: EncoderInFile) -> Result<Self, String> {
        let (rad, m) = (("resolution_rad", file.resolution_rad), ("resolution_m", file.resolution_m));
        let (sizes, resolution) = both_kinds(rad, m)?;
        let (_, noise) = both_kinds(("noise_rad", file.noise_rad), ("noise_m", file.noise_m))?;
        let (_, bias) = both_kinds(("bias_deg", file.bias_deg), ("bias_m", file.bias_m))?;
        let vector = |values: Vec<f64>| JointVector::from_fn(sizes, |i| values[i]);
        Ok(Self { resolution: vector(resolution), noise: vector(noise), bias: vector(bias), seed: file.seed })
    }
}

/// Settings of the drives and brakes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveSettings {
    /// Time without a new command after which the brakes close, control periods.
    #[serde(deserialize_with = "Whole::<1, 1_000_000>::read")]
    pub watchdog_cycles: u32,
    /// Time constant of the deceleration of the actuated joints by closed brakes, s.
    #[serde(rename = "brake_time_constant_ms", deserialize_with = "Positive::milli")]
    pub brake_time_constant: f64,
    /// Time from the command to close the brakes until they hold, s; the drives give no torque meanwhile.
    #[serde(rename = "brake_engage_ms", deserialize_with = "NonNegative::milli")]
    pub brake_engage: f64,
    /// Time constant of the torque loop, s; 0: no lag.
    #[serde(rename = "torque_lag_ms", deserialize_with = "NonNegative::milli")]
    pub torque_lag: f64,
    /// Transport delay of a command, control periods, 0..=[`MAX_DELAY`].
    #[serde(rename = "command_delay_cycles", deserialize_with = "Whole::<0, { MAX_DELAY as i64 }>::read")]
    pub command_delay: u32,
    /// Torque on the actuated joints that their torque sensors do not measure, N m or N.
    #[serde(rename = "torque_offset_nm", deserialize_with = "Finite::read")]
    pub torque_offset: ActuatedVector,
}

/// Settings of the joint stops: stiffness * depth + damping * velocity beyond `q_min` and `q_max`, pushing back only.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "JointStopsInFile")]
pub struct JointStopSettings {
    /// Position of the lower stops, rad or m.
    pub q_min: JointVector,
    /// Position of the upper stops, rad or m; above `q_min`.
    pub q_max: JointVector,
    /// Stiffness, N m/rad or N/m; 0: no stop.
    pub stiffness: JointVector,
    /// Damping, N m s/rad or N s/m.
    pub damping: JointVector,
}

/// Settings of the joint stops as a file states them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointStopsInFile {
    #[serde(default, deserialize_with = "NonNegative::degrees")]
    margin_deg: Option<Revolute<Joints>>,
    #[serde(default, deserialize_with = "NonNegative::read")]
    margin_m: Option<Prismatic<Joints>>,
    #[serde(deserialize_with = "NonNegative::read")]
    stiffness: JointVector,
    #[serde(deserialize_with = "NonNegative::read")]
    damping: JointVector,
}

impl TryFrom<JointStopsInFile> for JointStopSettings {
    type Error = String;

    fn try_from(file: JointStopsInFile) -> Result<Self, String> {
        let (sizes, margin) = both_kinds(("margin_deg", file.margin_deg), ("margin_m", file.margin_m))?;
        // Relative to the limits of the robot, which `PlantSettings::finish` adds.
        let margin = JointVector::from_fn(sizes, |i| margin[i]);
        Ok(Self { q_min: -margin, q_max: margin, stiffness: file.stiffness, damping: file.damping })
    }
}

/// Settings of the friction torque against the motion: viscous qd + coulomb tanh(qd / coulomb_smoothing).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionSettings {
    /// Viscous friction of each joint, N m s/rad or N s/m.
    #[serde(deserialize_with = "NonNegative::read")]
    pub viscous: JointVector,
    /// Coulomb friction of each joint, N m or N.
    #[serde(deserialize_with = "NonNegative::read")]
    pub coulomb: JointVector,
    /// Share of the actuated joints' friction that the drives compensate, in [0, 1].
    #[serde(deserialize_with = "Share::read")]
    pub compensation: f64,
    /// Speed at which Coulomb friction reaches 76 % of its value, rad/s or m/s.
    #[serde(rename = "coulomb_smoothing_rad_s", deserialize_with = "Positive::read")]
    pub coulomb_smoothing: f64,
}

/// State after power-up, at standstill.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "StartInFile")]
pub struct PlantStart {
    /// Positions of the actuated joints, rad or m.
    pub q: ActuatedVector,
    /// Positions of the unactuated joints.
    pub pendulum: PendulumStart,
}

/// State after power-up as a file states it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StartInFile {
    #[serde(default, deserialize_with = "Angle::degrees")]
    q_deg: Option<Revolute<Actuated>>,
    #[serde(default, deserialize_with = "Finite::read")]
    q_m: Option<Prismatic<Actuated>>,
    unactuated: PendulumStart,
}

impl TryFrom<StartInFile> for PlantStart {
    type Error = String;

    fn try_from(StartInFile { q_deg, q_m, unactuated: pendulum }: StartInFile) -> Result<Self, String> {
        let (sizes, q) = both_kinds(("q_deg", q_deg), ("q_m", q_m))?;
        Ok(Self { q: ActuatedVector::from_fn(sizes, |i| q[i]), pendulum })
    }
}

/// Angles of the pendulum at the start, for a given pose of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum PendulumStart {
    /// In its rest position, g_U(q) = 0; poses without one inside the limits are refused.
    Rest,
    /// At q_U = 0 as in the paper's Section VI; an equilibrium only at a flange pitch of 90 deg.
    Zero,
}

impl PlantSettings {
    /// Places the stops beyond the rated limits of the robot, and checks that the start pose is within these.
    pub(crate) fn finish(&mut self, robot: &RobotSettings, model: &Model) -> Result<(), SettingsConflict> {
        self.stops.q_min += robot.limits.q_min;
        self.stops.q_max += robot.limits.q_max;
        let mut positions = self.start.q.iter().enumerate();
        positions.try_for_each(|(joint, q)| {
            SettingsConflict::unless_within("start.q", *q, joint, &robot.limits, model)
        })
    }
}
