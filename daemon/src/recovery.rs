//! Recovery after a lost balance: wait until the pendulum hangs at rest, ask for a plan, wait until the plan is loaded and due,
//! start it. Pure functions; the service thread performs the [`RecoveryAction`]s.

use crate::step::CycleRecord;
use crate::trip::TripCause;
use upswing_config::RecoverySettings;
use upswing_ipc::operator::PublishedPlan;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::Order;

/// The next action of a recovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecoveryAction {
    /// Ask the planner for a swing-up from the current state.
    AskPlanner,
    /// Start the loaded plan with this id.
    Start(u64),
}

/// Stage of a recovery; times in ns on the daemon's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RecoveryStage {
    /// No recovery is in progress.
    Off,
    /// Waiting until the pendulum hangs at rest: time of the lost balance, and time since which the pendulum has been at rest.
    Settling { lost: u64, rest: Option<u64> },
    /// Waiting for the planner: time of the request.
    Planning { asked: u64 },
    /// Waiting until the plan is loaded and due: the plan, and the time of the request.
    Planned { plan: PublishedPlan, asked: u64 },
}

/// Recovery by a limited number of new swing-ups.
#[derive(Clone, Debug)]
pub struct Recovery {
    settings: RecoverySettings,
    /// Joints of the records.
    order: Order,
    stage: RecoveryStage,
    /// Attempts since the last request of the operator.
    attempts: u32,
    mode: Mode,
    /// Start of the newest cycle, ns on the daemon's clock.
    now: u64,
}

impl Recovery {
    /// Creates the state without a recovery in progress. `order`: the joints of the robot.
    pub fn new(settings: RecoverySettings, order: Order) -> Self {
        Self { settings, order, stage: RecoveryStage::Off, attempts: 0, mode: Mode::Idle, now: 0 }
    }

    /// Whether a recovery is in progress.
    pub fn is_active(&self) -> bool {
        self.stage != RecoveryStage::Off
    }

    /// Ends a recovery in favour of the operator; all attempts are available again.
    pub fn yield_to_operator(&mut self) {
        (self.stage, self.attempts) = (RecoveryStage::Off, 0);
    }

    /// Takes the answer of the planner: the published plan, or `None` if there is none.
    pub fn planned(&mut self, plan: Option<PublishedPlan>) {
        if let RecoveryStage::Planning { asked } = self.stage {
            self.stage = plan.map_or(RecoveryStage::Off, |plan| RecoveryStage::Planned { plan, asked });
        }
    }

    /// Takes the record of a cycle; `loaded` is the id of the loaded plan. Returns each action once.
    pub fn note(&mut self, record: &CycleRecord, loaded: u64) -> Option<RecoveryAction> {
        let telemetry = &record.telemetry;
        let before = self.mode;
        (self.mode, self.now) = (telemetry.mode().unwrap_or(Mode::Fault), telemetry.t_ns);
        // A trip in Track is a lost balance only if a recovery had started the swing-up.
        let fell = match record.trip.map(|trip| trip.cause) {
            Some(TripCause::BalanceLost | TripCause::BalanceSpeed) => true,
            Some(TripCause::PendulumRange | TripCause::TrackingError) => {
                before == Mode::Balance || self.attempts > 0
            }
            _ => false,
        };
        // Later records keep the cause: only a stop from these modes is its consequence.
        let stops = self.mode == Mode::Stop && matches!(before, Mode::Track | Mode::Balance);
        if stops && fell && self.attempts < self.settings.attempts {
            self.stage = RecoveryStage::Settling { lost: self.now, rest: None };
        }
        if !matches!(self.mode, Mode::Stop | Mode::Hold) {
            self.stage = RecoveryStage::Off;
        }
        match self.stage {
            RecoveryStage::Off => None,
            RecoveryStage::Settling { lost, rest } => self.settle(lost, rest, telemetry),
            RecoveryStage::Planning { asked } => {
                self.give_up_after(asked);
                None
            }
            RecoveryStage::Planned { plan, .. } if plan.is_due(loaded, self.now) => {
                self.stage = RecoveryStage::Off;
                Some(RecoveryAction::Start(plan.id))
            }
            RecoveryStage::Planned { asked, .. } => {
                self.give_up_after(asked);
                None
            }
        }
    }

    fn settle(&mut self, lost: u64, rest: Option<u64>, telemetry: &Telemetry) -> Option<RecoveryAction> {
        let slow = |qd: &f64| qd.abs() <= self.settings.rest_speed;
        let still = telemetry.vectors(&self.order).is_ok_and(|vectors| vectors.x.qd_u().iter().all(slow));
        let rest = if still && self.mode == Mode::Hold { Some(rest.unwrap_or(self.now)) } else { None };
        self.stage = RecoveryStage::Settling { lost, rest };
        if rest.is_some_and(|since| self.elapsed(since) >= self.settings.rest.as_nanos()) {
            self.stage = RecoveryStage::Planning { asked: self.now };
            self.attempts += 1;
            return Some(RecoveryAction::AskPlanner);
        }
        self.give_up_after(lost);
        None
    }

    fn elapsed(&self, since: u64) -> u128 {
        u128::from(self.now.saturating_sub(since))
    }

    fn give_up_after(&mut self, since: u64) {
        if self.elapsed(since) > self.settings.patience.as_nanos() {
            self.stage = RecoveryStage::Off;
        }
    }
}
