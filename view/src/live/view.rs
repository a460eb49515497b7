//! The state of a running system for display. SI units; numbers are those of shared memory and need not be finite.

use super::DaemonStatus;
use serde::Serialize;

/// State of a running system at one moment.
#[derive(Clone, Debug, Serialize)]
pub struct View {
    /// Domain of the system.
    pub domain: String,
    /// Time since the start of this process, s.
    pub t: f64,
    /// Whether a daemon is running.
    pub daemon: bool,
    /// Whether a planner is running.
    pub planner: bool,
    /// Whether a simulated plant is running.
    pub plant: bool,
    /// Mode of the newest cycle, or else of the status.
    pub mode: Option<String>,
    /// Next action that is open to the operator; `None` if the mode is unknown.
    pub next: Option<String>,
    /// Newest status of the daemon.
    pub status: Option<DaemonStatus>,
    /// The newest cycle.
    pub cycle: Option<CycleView>,
    /// The newest plan.
    pub plan: Option<PlanView>,
    /// Number of cycles whose telemetry was lost.
    pub lost: u64,
    /// Number of faults since `t` = 0.
    pub faults: u64,
    /// Number of plans since `t` = 0.
    pub plans: u64,
    /// Name of the request that is in progress.
    pub asking: Option<String>,
    /// Events, oldest first.
    pub events: Vec<EventView>,
}

/// One control cycle.
#[derive(Clone, Debug, Serialize)]
pub struct CycleView {
    /// Number of the cycle since the start of the daemon.
    pub seq: u64,
    /// Start of the cycle, s on the clock of the plant.
    pub t: f64,
    /// The latched fault.
    pub fault: Option<&'static str>,
    /// Limits beyond their warning level.
    pub warnings: Vec<&'static str>,
    /// Whether the brakes are closed.
    pub brakes: bool,
    /// Whether the torque limiter cut the command.
    pub limited: bool,
    /// Id of the running plan.
    pub plan: Option<String>,
    /// Time since the start of the running plan, s.
    pub t_plan: f64,
    /// Angle of the rod from upright, rad.
    pub tilt: f64,
    /// Direction from the last joint to the tip, world frame, z up, length 1.
    pub rod: [f64; 3],
    /// Largest distance of an actuated joint from the reference, rad or m.
    pub error_arm: f64,
    /// Largest distance of an unactuated joint from the reference, rad or m.
    pub error_pendulum: f64,
    /// The joints in the chain's order; empty if the record is that of another chain.
    pub joints: Vec<JointView>,
}

/// State of one joint with its 100 % limits; position limits are those of plans where these are wider.
#[derive(Clone, Debug, Serialize)]
pub struct JointView {
    /// Name in the URDF.
    pub name: String,
    /// Position, rad or m.
    pub q: f64,
    /// Position in `unit`.
    pub shown: f64,
    /// Unit in which the position is shown: deg or m.
    pub unit: &'static str,
    /// Velocity, rad/s or m/s.
    pub qd: f64,
    /// Commanded torque, N m or N; 0 without a motor.
    pub tau: f64,
    /// Lower limit of the position, rad or m.
    pub q_min: f64,
    /// Upper limit of the position, rad or m.
    pub q_max: f64,
    /// Limit of the velocity, rad/s or m/s.
    pub qd_max: f64,
    /// Limit of the torque, N m or N; `None`: no motor.
    pub tau_max: Option<f64>,
}

/// A plan that the planner published.
#[derive(Clone, Debug, Serialize)]
pub struct PlanView {
    /// Id of the plan.
    pub id: String,
    /// Duration t_F, s.
    pub t_f: f64,
    /// Whether the rod stands at the end of the plan; otherwise it hangs.
    pub stands: bool,
}

/// An event of the system or of a request.
#[derive(Clone, Debug, Serialize)]
pub struct EventView {
    /// Time of the event, as [`View::t`], s.
    pub t: f64,
    /// Severity of the event.
    pub kind: Severity,
    /// Description for people.
    pub text: String,
}

/// Severity of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Information.
    Note,
    /// A limit beyond its warning level, a late cycle, or a refused request.
    Warning,
    /// A fault.
    Fault,
}

impl JointView {
    /// Position from -1 (lower limit) over 0 (middle of the range) to 1.
    pub fn position(&self) -> f64 {
        let (middle, half) = (0.5 * (self.q_min + self.q_max), 0.5 * (self.q_max - self.q_min));
        (self.q - middle) / half
    }

    /// Velocity as a share of its limit.
    pub fn velocity(&self) -> f64 {
        self.qd / self.qd_max
    }

    /// Torque as a share of its limit.
    pub fn torque(&self) -> Option<f64> {
        self.tau_max.map(|max| self.tau / max)
    }
}
