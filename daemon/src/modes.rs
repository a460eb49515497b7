//! Modes of the controller with their data: the reference of the arm in Hold and Stop, the plan in Track
//! and Balance.

use crate::arm::ArmReference;
use crate::checks::Checks;
use crate::observer::Observer;
use crate::supervisor::is_braked;
use crate::trip::Trip;
use upswing_ipc::Mode;
use upswing_model::{ActuatedVector, Posture, State};
use upswing_trajectory::{Plan, Reference};

/// Setpoint of one cycle: the reference of the torque law (24), and the input after feedback.
pub struct Setpoint {
    /// x_d
    pub x_d: State,
    /// u_d
    pub u_d: ActuatedVector,
    /// u = u_d + feedback
    pub u: ActuatedVector,
    /// Time since the start of the plan, s; 0 without a plan.
    pub t_plan: f64,
}

/// The mode of the controller with its data.
#[derive(Clone, Debug)]
pub enum ActiveMode {
    /// Brakes closed.
    Idle,
    /// The arm keeps a pose.
    Hold(ArmReference),
    /// Robot and pendulum follow a plan.
    Track(RunningPlan),
    /// The final gain of the plan keeps the rod upright.
    Balance(RunningPlan),
    /// The arm decelerates.
    Stop(ArmReference),
    /// Brakes closed after a trip, until a reset.
    Fault,
}

impl ActiveMode {
    /// Returns the mode without its data.
    pub fn mode(&self) -> Mode {
        match self {
            Self::Idle => Mode::Idle,
            Self::Hold(_) => Mode::Hold,
            Self::Track(_) => Mode::Track,
            Self::Balance(_) => Mode::Balance,
            Self::Stop(_) => Mode::Stop,
            Self::Fault => Mode::Fault,
        }
    }

    /// Whether the brakes hold the arm, without torque.
    pub fn is_braked(&self) -> bool {
        is_braked(self.mode())
    }

    /// Changes Track to Balance with the same plan; leaves other modes unchanged.
    pub fn balance(&mut self) {
        *self = match std::mem::replace(self, Self::Idle) {
            Self::Track(plan) => Self::Balance(plan),
            mode => mode,
        };
    }

    /// Id of the running plan; 0: none.
    pub fn plan_id(&self) -> u64 {
        match self {
            Self::Track(running) | Self::Balance(running) => running.loaded.plan.id,
            _ => 0,
        }
    }
}

/// A plan that waits for its start.
#[derive(Clone, Debug)]
pub struct LoadedPlan {
    /// Checked plan.
    pub plan: Box<Plan>,
    /// Time at which the controller received the plan, ns on the plant's clock.
    pub since_ns: u64,
}

impl LoadedPlan {
    /// Time for which the controller has had the plan at the time `now_ns`, s.
    pub fn age(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.since_ns) as f64 * 1e-9
    }
}

/// A plan that was started.
#[derive(Clone, Debug)]
pub struct RunningPlan {
    /// The plan, with the time at which the controller received it.
    pub loaded: LoadedPlan,
    /// Time of the plan's t = 0, ns on the plant's clock.
    start_ns: u64,
    /// Posture of the unactuated joints at x_N.
    ending: Posture,
}

impl RunningPlan {
    /// Starts a plan with t = 0 at the time `start_ns`, that ends in the posture `ending`.
    pub fn new(loaded: LoadedPlan, start_ns: u64, ending: Posture) -> Self {
        Self { loaded, start_ns, ending }
    }

    /// Time t of the plan at the time `now_ns`, s.
    fn time(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.start_ns) as f64 * 1e-9
    }

    /// dx/dt of the plan at the time `now_ns`.
    pub fn derivative(&self, now_ns: u64) -> State {
        self.loaded.plan.spline().derivative(self.time(now_ns))
    }

    /// Reference at the end x_N of the plan.
    pub fn end(&self) -> Reference<'_> {
        self.loaded.plan.end()
    }

    /// Returns the posture in which the plan ends if t >= t_F at the time `now_ns`; otherwise `None`.
    pub fn ending(&self, now_ns: u64) -> Option<Posture> {
        (self.time(now_ns) >= self.loaded.plan.trajectory.t_f).then_some(self.ending)
    }

    /// Track: writes the setpoint at the time `now_ns`.
    ///
    /// # Errors
    /// The [`Trip`] if the robot is too far from the reference, or the pendulum beyond its range.
    pub fn track(
        &self,
        now_ns: u64,
        x: &State,
        checks: &mut Checks,
        setpoint: &mut Setpoint,
    ) -> Result<(), Trip> {
        let t_plan = self.time(now_ns);
        let reference = self.loaded.plan.reference(t_plan);
        let lost = checks.tracking(x, &reference.x);
        let u = reference.input(x);
        match checks.pendulum(x).or(lost) {
            Some(trip) => Err(trip),
            None => {
                *setpoint = Setpoint { x_d: reference.x, u_d: reference.u, u, t_plan };
                Ok(())
            }
        }
    }

    /// Balance: writes the setpoint at the end of the plan, with its final gain.
    ///
    /// # Errors
    /// The [`Trip`] if the pendulum or the arm is too far from x_N, the arm would have to move too fast, or the pendulum is beyond its
    /// range.
    pub fn balance(
        &self,
        now_ns: u64,
        observer: &Observer,
        checks: &mut Checks,
        setpoint: &mut Setpoint,
    ) -> Result<(), Trip> {
        let (x, end) = (&observer.x, self.end());
        let lost = checks.balance(x, &end.x);
        let u = end.input(x);
        let astray = checks.balance_error(x, &end.x);
        let fast = checks.balance_speed(&observer.filtered.actuated(), &u);
        match checks.pendulum(x).or(lost).or(astray).or(fast) {
            Some(trip) => Err(trip),
            None => {
                *setpoint = Setpoint { x_d: end.x, u_d: end.u, u, t_plan: self.time(now_ns) };
                Ok(())
            }
        }
    }
}
