//! `plant.toml`.

use crate::check::{Check, FULL_TURN, NON_NEGATIVE, POSITIVE, SHARE};
use crate::{ConfigError, RobotSettings};
use serde::Deserialize;
use upswing_model::{N_ACTUATED, N_UNACTUATED, NU};

/// The simulated robot, pendulum, drives and encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantSettings {
    /// Integration steps per control period.
    pub substeps: u32,
    /// The encoders.
    pub encoder: EncoderSettings,
    /// The drives and brakes.
    pub drive: DriveSettings,
    /// Joint friction.
    pub friction: FrictionSettings,
    /// The state after power-up.
    pub start: PlantStart,
}

/// The encoders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSettings {
    /// Smallest step of the actuated joints' angles, rad.
    pub arm_resolution: f64,
    /// Smallest step of the unactuated joints' angles, rad: one turn over a power of two.
    pub pendulum_resolution: f64,
}

/// The drives and brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Control periods without a fresh command after which the brakes close.
    pub watchdog_cycles: u32,
    /// Time constant with which closed brakes stop the actuated joints, s.
    pub brake_time_constant: f64,
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PendulumStart {
    /// In its hanging equilibrium, g_U(q) = 0; poses without one inside the limits are refused.
    Rest,
    /// At q_U = 0 as in the paper's Section VI; an equilibrium only at a flange pitch of 90 deg.
    Zero,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    integrator: RawIntegrator,
    encoder: RawEncoder,
    drive: RawDrive,
    friction: RawFriction,
    start: RawStart,
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
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrive {
    watchdog_cycles: i64,
    brake_time_constant_ms: f64,
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
        let Raw { integrator, encoder, drive, friction, start } = check.parse(text)?;

        let q_deg: [f64; NU] = check.list("start.q_deg", &start.q_deg, 1, &FULL_TURN)?;
        let mut q = [0.0; NU];
        for i in 0..NU {
            q[i] = check.angle("start.q_deg", q_deg[i], i, &robot.limits)?;
        }

        let bits: i32 = check.integer("encoder.pendulum_bits", encoder.pendulum_bits, 1..=32)?;
        let resolution = check.number("encoder.arm_resolution_rad", encoder.arm_resolution_rad, &POSITIVE)?;
        let brake_ms =
            check.number("drive.brake_time_constant_ms", drive.brake_time_constant_ms, &POSITIVE)?;
        Ok(Self {
            substeps: check.integer("integrator.substeps", integrator.substeps, 1..=1000)?,
            encoder: EncoderSettings {
                arm_resolution: resolution,
                pendulum_resolution: std::f64::consts::TAU / 2_f64.powi(bits),
            },
            drive: DriveSettings {
                watchdog_cycles: check.integer(
                    "drive.watchdog_cycles",
                    drive.watchdog_cycles,
                    1..=1_000_000,
                )?,
                brake_time_constant: brake_ms * 1e-3,
            },
            friction: read_friction(check, &friction)?,
            start: PlantStart { q, pendulum: start.pendulum },
        })
    }
}

fn read_friction(check: Check<'_>, raw: &RawFriction) -> Result<FrictionSettings, ConfigError> {
    const PENDULUM: usize = N_ACTUATED + 1;
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
