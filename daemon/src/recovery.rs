//! After a lost balance: wait until the pendulum hangs at rest, get a new plan, swing up again. Pure; the service thread
//! does what it asks for.

use crate::controller::Record;
use crate::trip::TripCause;
use upswing_config::RecoverySettings;
use upswing_ipc::Mode;
use upswing_model::{NQ, NU};

/// What is to be done next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Ask the planner for a swing-up from now.
    AskPlanner,
    /// Start the loaded plan, which has this id.
    Start(u64),
}

/// The plan that the planner published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Planned {
    /// Its id.
    pub id: u64,
    /// When it may be started, ns on the daemon's clock.
    pub activation_ns: u64,
}

/// How far the recovery is; times in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Nothing to recover from, or given up.
    Off,
    /// Since the loss; and since when the pendulum has been at rest.
    Settling { lost: u64, rest: Option<u64> },
    /// Asked the planner.
    Planning { asked: u64 },
    /// Got a plan.
    Planned { plan: Planned, asked: u64 },
}

/// Limited attempts to swing up again.
#[derive(Clone, Debug)]
pub struct Recovery {
    settings: RecoverySettings,
    stage: Stage,
    /// Attempts since the last request of the operator.
    attempts: u32,
    mode: Mode,
    /// Time of the newest cycle, ns.
    now: u64,
}

impl Recovery {
    /// Nothing to recover from yet.
    pub fn new(settings: RecoverySettings) -> Self {
        Self { settings, stage: Stage::Off, attempts: 0, mode: Mode::Idle, now: 0 }
    }

    /// Whether it works on a recovery.
    pub fn is_active(&self) -> bool {
        self.stage != Stage::Off
    }

    /// The operator takes over.
    pub fn yield_to_operator(&mut self) {
        (self.stage, self.attempts) = (Stage::Off, 0);
    }

    /// The planner answered: with the plan that it published, or without one.
    pub fn planned(&mut self, plan: Option<Planned>) {
        if let Stage::Planning { asked } = self.stage {
            self.stage = plan.map_or(Stage::Off, |plan| Stage::Planned { plan, asked });
        }
    }

    /// Takes in a cycle; `loaded` is the id of the loaded plan. Returns what is to be done, once.
    pub fn note(&mut self, record: &Record, loaded: u64) -> Option<Action> {
        let telemetry = &record.telemetry;
        let before = self.mode;
        (self.mode, self.now) = (telemetry.mode().unwrap_or(Mode::Fault), telemetry.t_ns);
        // A loss while tracking is one to recover from only if the recovery itself had begun to swing up.
        let fell = match record.trip.map(|trip| trip.cause) {
            Some(TripCause::BalanceLost | TripCause::BalanceSpeed) => true,
            Some(TripCause::PendulumRange | TripCause::TrackingError) => {
                before == Mode::Balance || self.attempts > 0
            }
            _ => false,
        };
        // The cause stays in later records: only a stop out of these modes follows from it.
        let stops = self.mode == Mode::Stop && matches!(before, Mode::Track | Mode::Balance);
        if stops && fell && self.attempts < self.settings.attempts {
            self.stage = Stage::Settling { lost: self.now, rest: None };
        }
        if !matches!(self.mode, Mode::Stop | Mode::Hold) {
            self.stage = Stage::Off;
        }
        match self.stage {
            Stage::Off => None,
            Stage::Settling { lost, rest } => self.settle(lost, rest, &telemetry.qd),
            Stage::Planning { asked } => {
                self.give_up_after(asked);
                None
            }
            Stage::Planned { plan, .. } if plan.id == loaded && plan.activation_ns <= self.now => {
                self.stage = Stage::Off;
                Some(Action::Start(plan.id))
            }
            Stage::Planned { asked, .. } => {
                self.give_up_after(asked);
                None
            }
        }
    }

    fn settle(&mut self, lost: u64, rest: Option<u64>, qd: &[f64; NQ]) -> Option<Action> {
        let still = qd[NU..].iter().all(|qd| qd.abs() <= self.settings.rest_speed);
        let rest = if still && self.mode == Mode::Hold { Some(rest.unwrap_or(self.now)) } else { None };
        self.stage = Stage::Settling { lost, rest };
        if rest.is_some_and(|since| self.elapsed(since) >= self.settings.rest.as_nanos()) {
            self.stage = Stage::Planning { asked: self.now };
            self.attempts += 1;
            return Some(Action::AskPlanner);
        }
        self.give_up_after(lost);
        None
    }

    fn elapsed(&self, since: u64) -> u128 {
        u128::from(self.now.saturating_sub(since))
    }

    fn give_up_after(&mut self, since: u64) {
        if self.elapsed(since) > self.settings.patience.as_nanos() {
            self.stage = Stage::Off;
        }
    }
}
