//! What there is to see. SI units; numbers come from shared memory as they are and need not be finite.

use super::Status;
use serde::Serialize;
use upswing_model::NQ;

/// A running system at one moment.
#[derive(Clone, Debug, Serialize)]
pub struct View {
    /// Its domain.
    pub domain: String,
    /// Time since this process began to watch, s.
    pub t: f64,
    /// Whether there is a daemon.
    pub daemon: bool,
    /// Whether there is a planner.
    pub planner: bool,
    /// Whether there is a simulated plant.
    pub plant: bool,
    /// Mode of the newest cycle, or else of the status.
    pub mode: Option<String>,
    /// What the operator can do next; `None` where the mode is unknown.
    pub next: Option<String>,
    /// The daemon's last answer.
    pub status: Option<Status>,
    /// The newest cycle.
    pub cycle: Option<Cycle>,
    /// The newest plan.
    pub plan: Option<PlanView>,
    /// Cycles that were lost on the way here.
    pub lost: u64,
    /// Faults seen since `t` = 0.
    pub faults: u64,
    /// Plans seen since `t` = 0.
    pub plans: u64,
    /// A request that is being answered.
    pub asking: Option<&'static str>,
    /// What happened, oldest first.
    pub events: Vec<Event>,
}

/// One control cycle.
#[derive(Clone, Debug, Serialize)]
pub struct Cycle {
    /// Its number since the start of the daemon.
    pub seq: u64,
    /// Begin, s on the clock of the plant.
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
    /// Time since its start, s.
    pub t_plan: f64,
    /// Angle of the rod from upright, rad.
    pub tilt: f64,
    /// Direction from the last joint to the tip, world frame, z up, length 1.
    pub rod: [f64; 3],
    /// Largest distance from the reference, rad: joints 1-7 and 8-9.
    pub error_arm: f64,
    /// See `error_arm`.
    pub error_pendulum: f64,
    /// Joints 1-9.
    pub joints: [Joint; NQ],
}

/// One joint with its 100 % limits; those of the position are wider where plans may use more.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Joint {
    /// Position, rad.
    pub q: f64,
    /// Velocity, rad/s.
    pub qd: f64,
    /// Commanded torque, N m; 0 where there is no motor.
    pub tau: f64,
    /// Limits of the position, rad.
    pub q_min: f64,
    /// See `q_min`.
    pub q_max: f64,
    /// Limit of the velocity, rad/s.
    pub qd_max: f64,
    /// Limit of the torque, N m; `None`: no motor.
    pub tau_max: Option<f64>,
}

/// A plan that the planner published.
#[derive(Clone, Debug, Serialize)]
pub struct PlanView {
    /// Its id.
    pub id: String,
    /// Duration t_F, s.
    pub t_f: f64,
    /// Whether the rod stands in the end; else it hangs.
    pub stands: bool,
}

/// Something that happened.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// When, as in [`View::t`], s.
    pub t: f64,
    /// How much it matters.
    pub kind: Kind,
    /// What.
    pub text: String,
}

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Good to know.
    Note,
    /// A limit's warning level, a late cycle, a refusal.
    Warning,
    /// A fault.
    Fault,
}

impl Joint {
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
