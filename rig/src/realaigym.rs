//! The RealAIGym benchmark of acrobot and pendubot: its machine, its simulations, and the scores of its leaderboards, performance, robustness and
//! uptime. Definitions and parameters are those of Wiebe et al., IEEE Robotics & Automation Magazine 31 (2024), DOI 10.1109/MRA.2023.3341257, and of the
//! repository github.com/dfki-ric-underactuated-lab/double_pendulum, commit 1e8544e.

mod boards;
mod machine;
mod pilot;
mod scores;

pub use boards::{Benchmark, Category, Controller, Robustness, UPTIME, Uptime, Version, machine};
pub use machine::{Condition, DT, Joints, Parameters, State};
pub use pilot::Pilot;
pub use scores::{Motion, Performance, csv};

use upswing_config::{Config, Level, System};
use upswing_model::{JointVector, Model, Workspace};

/// The system with the motor of the benchmark, as its own settings have it.
#[derive(Clone, Debug)]
pub struct DoublePendulum {
    /// Settings, without the trip levels that protect a machine.
    pub config: Config,
    /// Largest torques, N m, shoulder and elbow.
    pub limits: Joints,
}

impl DoublePendulum {
    /// The system of `config` with the machine of a version of the leaderboards, and the weight r of (6a) for plans, s^4/rad^2.
    ///
    /// # Errors
    /// A message if it is no double pendulum with one motor, or its model is not the machine of the benchmark.
    pub fn new(mut config: Config, version: Version, input_weight: f64) -> Result<Self, String> {
        let order = *config.model.order();
        let system = config.system().to_string();
        let (joints, actuated) = (order.sizes().joints(), order.sizes().actuated());
        if (joints, actuated) != (2, 1) {
            return Err(format!(
                "{system}: expected a double pendulum, 2 joints and 1 of them actuated, got {joints} and {actuated}; choose \
                 another system"
            ));
        }
        if !(input_weight > 0.0 && input_weight.is_finite()) {
            return Err(format!("input weight: expected a number above 0, got {input_weight}"));
        }
        config.planner.offline.input_weight = input_weight;
        never_trip(&mut config);
        let mut limits: Joints = [0.0; 2];
        limits[order.joint(0)] = config.robot.limits.tau_max[0];
        let machine = machine(version, &limits);
        if version == Version::One {
            config.model = Model::from_urdf(&machine.urdf(&limits)).map_err(|e| e.to_string())?;
        }
        agree(&config.model, &machine).map_err(|e| format!("{system}: {e}"))?;
        Ok(Self { config, limits })
    }

    /// As [`Self::new`], of a shipped system or a folder.
    ///
    /// # Errors
    /// As of [`Self::new`], and of settings that cannot be read.
    pub fn load(system: &System, version: Version, input_weight: f64) -> Result<Self, String> {
        Self::new(Config::load(system).map_err(|e| e.to_string())?, version, input_weight)
    }
}

/// Raises the trip levels that protect a machine, which the benchmark does not have, out of reach.
fn never_trip(config: &mut Config) {
    let never = Level { warn: f64::INFINITY, trip: f64::INFINITY };
    let limits = &mut config.daemon.limits;
    for level in [
        &mut limits.encoder_jump,
        &mut limits.position_margin,
        &mut limits.velocity_fraction,
        &mut limits.torque_rate,
        &mut limits.collision_torque,
        &mut limits.tracking_error,
        &mut limits.balance_error,
        &mut limits.balance_distance,
        &mut limits.balance_speed,
    ] {
        *level = never;
    }
}

/// Checks that the model of planner and daemon is the machine of the benchmark.
fn agree(model: &Model, machine: &Parameters) -> Result<(), String> {
    let (order, mut work) = (model.order(), Workspace::default());
    for n in 0..100 {
        let number = |k: i32| ((f64::from(n) * 7.0 + f64::from(k)) * 1.7).sin();
        let x = [4.0 * number(1), 4.0 * number(2), 15.0 * number(3), 15.0 * number(4)];
        let mut tau = [0.0; 2];
        tau[order.joint(0)] = 6.0 * number(5);
        let sorted = |chain: &[f64]| JointVector::from_fn(order.sizes(), |c| chain[order.joint(c)]);
        let ours = model.forward_dynamics(&sorted(&x[..2]), &sorted(&x[2..]), &sorted(&tau), &mut work);
        let theirs = sorted(&machine.acceleration(&x, &tau));
        let difference = ours.map_or(f64::INFINITY, |ours: JointVector| (ours - theirs).amax());
        // Rounding errors.
        if !(difference <= 1e-9 * theirs.amax()) {
            return Err(format!(
                "expected the machine of the benchmark, got one whose accelerations differ by {difference:.1e} rad/s^2 \
                 at {x:.2?}; choose another system"
            ));
        }
    }
    Ok(())
}
