//! `plant.toml`.

use crate::check::{Check, FINITE, FULL_TURN, NON_NEGATIVE, POSITIVE, SHARE};
use crate::{ConfigError, Fault, Push, RobotSettings};
use serde::Deserialize;
use upswing_model::{Model, N_UNACTUATED, NQ, NU};

/// Most cycles that a command, or under a fault a measurement, can be late.
pub const MAX_DELAY: u32 = 63;

/// The simulated robot, pendulum, drives and encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantSettings {
    /// How the bodies differ from their URDF.
    pub model: ModelSettings,
    /// Integration steps per control period.
    pub substeps: u32,
    /// The encoders.
    pub encoder: EncoderSettings,
    /// The drives and brakes.
    pub drive: DriveSettings,
    /// Joint friction.
    pub friction: FrictionSettings,
    /// Joint stops.
    pub stops: StopSettings,
    /// The state after power-up.
    pub start: PlantStart,
    /// What breaks, and when; from a scenario.
    pub faults: Vec<Fault>,
    /// Pushes on the rod; from a scenario.
    pub pushes: Vec<Push>,
}

/// How the bodies that move differ from their URDF.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelSettings {
    /// The URDF: a file of the set, or a path with a `/`. It is read into [`crate::Config::plant_model`].
    pub urdf: String,
    /// Masses and inertias of the actuated bodies, relative to the URDF.
    pub arm_mass_scale: f64,
    /// Masses and inertias of the unactuated bodies, relative to the URDF.
    pub pendulum_mass_scale: f64,
    /// Length of the rod, relative to the URDF, at the same mass.
    pub pendulum_length_scale: f64,
    /// A point mass on the last actuated body, kg.
    pub payload: f64,
    /// Where it is in that body's frame, m.
    pub payload_position: [f64; 3],
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2.
    pub rotor_inertia: [f64; NU],
}

impl ModelSettings {
    /// The bodies and rotors that move, given the bodies of the URDF.
    pub fn apply(&self, urdf: &Model) -> Model {
        urdf.with_scaled_masses(self.arm_mass_scale, self.pendulum_mass_scale)
            .with_scaled_rod_length(self.pendulum_length_scale)
            .with_payload(self.payload, self.payload_position.into())
            .with_rotors(self.rotor_inertia)
    }
}

/// The encoders: the true angle plus bias plus noise, rounded to the resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSettings {
    /// Smallest step of the actuated joints' angles, rad.
    pub arm_resolution: f64,
    /// Smallest step of the unactuated joints' angles, rad: one turn over a power of two.
    pub pendulum_resolution: f64,
    /// Standard deviation of white Gaussian noise, rad.
    pub noise: [f64; NQ],
    /// Error of the zero position, rad.
    pub bias: [f64; NQ],
    /// Seed of the noise.
    pub seed: u64,
}

/// The drives and brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Control periods without a fresh command after which the brakes close.
    pub watchdog_cycles: u32,
    /// Time constant with which closed brakes stop the actuated joints, s.
    pub brake_time_constant: f64,
    /// Time from closing the brakes until they hold, s; the drives give no torque meanwhile.
    pub brake_engage: f64,
    /// Time constant of the torque loop, s; 0: none.
    pub torque_lag: f64,
    /// Control periods that a command spends on its way, 0..=[`MAX_DELAY`].
    pub command_delay: u32,
    /// Torque on the actuated joints on top of what the sensors show, N m.
    pub torque_offset: [f64; NU],
}

/// Joint stops: stiffness * depth + damping * velocity beyond +-q, pushing back only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopSettings {
    /// Where they are, rad, above 0.
    pub q: [f64; NQ],
    /// N m/rad; 0: there is none.
    pub stiffness: [f64; NQ],
    /// N m s/rad
    pub damping: [f64; NQ],
}

/// Friction torque against the motion: viscous qd + coulomb tanh(qd / coulomb_smoothing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionSettings {
    /// Unactuated joints, N m s/rad; assumed.
    pub pendulum_viscous: [f64; N_UNACTUATED],
    /// Unactuated joints, N m; assumed.
    pub pendulum_coulomb: [f64; N_UNACTUATED],
    /// Actuated joints, N m s/rad (Stuerz et al. 2017).
    pub arm_viscous: [f64; NU],
    /// Actuated joints, N m (Stuerz et al. 2017).
    pub arm_coulomb: [f64; NU],
    /// Share of the actuated joints' friction that the drives remove, in [0, 1].
    pub arm_compensation: f64,
    /// Speed at which Coulomb friction reaches 76 % of its value, rad/s.
    pub coulomb_smoothing: f64,
}

/// The state after power-up, at standstill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantStart {
    /// Angles of the actuated joints, rad.
    pub q: [f64; NU],
    /// Angles of the unactuated joints.
    pub pendulum: PendulumStart,
}

/// How the pendulum starts in a given pose of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum PendulumStart {
    /// In its rest position, g_U(q) = 0; poses without one inside the limits are refused.
    Rest,
    /// At q_U = 0 as in the paper's Section VI; an equilibrium only at a flange pitch of 90 deg.
    Zero,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    model: RawModel,
    integrator: RawIntegrator,
    encoder: RawEncoder,
    drive: RawDrive,
    friction: RawFriction,
    stops: RawStops,
    start: RawStart,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawModel {
    urdf: String,
    arm_mass_scale: f64,
    pendulum_mass_scale: f64,
    pendulum_length_scale: f64,
    payload_kg: f64,
    payload_position_m: Vec<f64>,
    rotor_inertia_kg_m2: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawIntegrator {
    substeps: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawEncoder {
    arm_resolution_rad: f64,
    pendulum_bits: i64,
    noise_rad: Vec<f64>,
    bias_deg: Vec<f64>,
    seed: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrive {
    watchdog_cycles: i64,
    brake_time_constant_ms: f64,
    brake_engage_ms: f64,
    torque_lag_ms: f64,
    command_delay_cycles: i64,
    torque_offset_nm: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStops {
    q_deg: Vec<f64>,
    stiffness: Vec<f64>,
    damping: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFriction {
    pendulum_viscous: Vec<f64>,
    pendulum_coulomb: Vec<f64>,
    arm_viscous: Vec<f64>,
    arm_coulomb: Vec<f64>,
    arm_compensation: f64,
    coulomb_smoothing_rad_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStart {
    q_deg: Vec<f64>,
    pendulum: PendulumStart,
}

impl PlantSettings {
    pub(crate) fn read(file: &str, text: &str, robot: &RobotSettings) -> Result<Self, ConfigError> {
        let check = Check { file };
        Self::from_raw(check, check.parse(text)?, robot)
    }

    /// From the tables of `plant.toml` with some values replaced.
    pub(crate) fn from_tables(
        check: Check<'_>,
        tables: toml::Table,
        robot: &RobotSettings,
    ) -> Result<Self, ConfigError> {
        let raw = tables.try_into().map_err(|e| {
            check.refuse("its values", "such as plant.toml has", e.message(), "compare with plant.toml")
        })?;
        Self::from_raw(check, raw, robot)
    }

    fn from_raw(check: Check<'_>, raw: Raw, robot: &RobotSettings) -> Result<Self, ConfigError> {
        let Raw { model, integrator, encoder, drive, friction, stops, start } = raw;
        let q_deg: [f64; NU] = check.list("start.q_deg", &start.q_deg, 1, &FULL_TURN)?;
        let mut q = [0.0; NU];
        for i in 0..NU {
            q[i] = check.angle("start.q_deg", q_deg[i], i, &robot.limits)?;
        }
        Ok(Self {
            model: read_model(check, model)?,
            substeps: check.integer("integrator.substeps", integrator.substeps, 1..=1000)?,
            encoder: read_encoder(check, &encoder)?,
            drive: read_drive(check, &drive)?,
            friction: read_friction(check, &friction)?,
            stops: StopSettings {
                q: check.list("stops.q_deg", &stops.q_deg, 1, &POSITIVE)?.map(f64::to_radians),
                stiffness: check.list("stops.stiffness", &stops.stiffness, 1, &NON_NEGATIVE)?,
                damping: check.list("stops.damping", &stops.damping, 1, &NON_NEGATIVE)?,
            },
            start: PlantStart { q, pendulum: start.pendulum },
            faults: Vec::new(),
            pushes: Vec::new(),
        })
    }
}

fn read_model(check: Check<'_>, raw: RawModel) -> Result<ModelSettings, ConfigError> {
    let scale = |key: &str, value: f64| check.number(key, value, &POSITIVE);
    let payload_position: [f64; 3] = raw.payload_position_m.as_slice().try_into().map_err(|_| {
        let got = raw.payload_position_m.len();
        check.refuse("model.payload_position_m", "3 numbers, x, y, z", got, "give a point of frame O7")
    })?;
    for value in payload_position {
        check.number("model.payload_position_m", value, &FINITE)?;
    }
    Ok(ModelSettings {
        urdf: raw.urdf,
        arm_mass_scale: scale("model.arm_mass_scale", raw.arm_mass_scale)?,
        pendulum_mass_scale: scale("model.pendulum_mass_scale", raw.pendulum_mass_scale)?,
        pendulum_length_scale: scale("model.pendulum_length_scale", raw.pendulum_length_scale)?,
        payload: check.number("model.payload_kg", raw.payload_kg, &NON_NEGATIVE)?,
        payload_position,
        rotor_inertia: check.list("model.rotor_inertia_kg_m2", &raw.rotor_inertia_kg_m2, 1, &NON_NEGATIVE)?,
    })
}

fn read_encoder(check: Check<'_>, raw: &RawEncoder) -> Result<EncoderSettings, ConfigError> {
    let bits: i32 = check.integer("encoder.pendulum_bits", raw.pendulum_bits, 1..=32)?;
    Ok(EncoderSettings {
        arm_resolution: check.number("encoder.arm_resolution_rad", raw.arm_resolution_rad, &POSITIVE)?,
        pendulum_resolution: std::f64::consts::TAU / 2_f64.powi(bits),
        noise: check.list("encoder.noise_rad", &raw.noise_rad, 1, &NON_NEGATIVE)?,
        bias: check.list("encoder.bias_deg", &raw.bias_deg, 1, &FULL_TURN)?.map(f64::to_radians),
        seed: check.integer("encoder.seed", raw.seed, 0..=i64::MAX)?,
    })
}

fn read_drive(check: Check<'_>, raw: &RawDrive) -> Result<DriveSettings, ConfigError> {
    let seconds = |key: &str, ms: f64, rule| Ok(check.number(key, ms, rule)? * 1e-3);
    Ok(DriveSettings {
        watchdog_cycles: check.integer("drive.watchdog_cycles", raw.watchdog_cycles, 1..=1_000_000)?,
        brake_time_constant: seconds("drive.brake_time_constant_ms", raw.brake_time_constant_ms, &POSITIVE)?,
        brake_engage: seconds("drive.brake_engage_ms", raw.brake_engage_ms, &NON_NEGATIVE)?,
        torque_lag: seconds("drive.torque_lag_ms", raw.torque_lag_ms, &NON_NEGATIVE)?,
        command_delay: check.integer(
            "drive.command_delay_cycles",
            raw.command_delay_cycles,
            0..=MAX_DELAY.into(),
        )?,
        torque_offset: check.list("drive.torque_offset_nm", &raw.torque_offset_nm, 1, &FINITE)?,
    })
}

fn read_friction(check: Check<'_>, raw: &RawFriction) -> Result<FrictionSettings, ConfigError> {
    const PENDULUM: usize = NU + 1;
    let pendulum = |key: &str, values: &[f64]| check.list(key, values, PENDULUM, &NON_NEGATIVE);
    let arm = |key: &str, values: &[f64]| check.list(key, values, 1, &NON_NEGATIVE);
    Ok(FrictionSettings {
        pendulum_viscous: pendulum("friction.pendulum_viscous", &raw.pendulum_viscous)?,
        pendulum_coulomb: pendulum("friction.pendulum_coulomb", &raw.pendulum_coulomb)?,
        arm_viscous: arm("friction.arm_viscous", &raw.arm_viscous)?,
        arm_coulomb: arm("friction.arm_coulomb", &raw.arm_coulomb)?,
        arm_compensation: check.number("friction.arm_compensation", raw.arm_compensation, &SHARE)?,
        coulomb_smoothing: check.number(
            "friction.coulomb_smoothing_rad_s",
            raw.coulomb_smoothing_rad_s,
            &POSITIVE,
        )?,
    })
}
