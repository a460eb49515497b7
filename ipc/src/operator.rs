//! What an operator asks of a running system, and what it answers.

use crate::{
    CallError, Client, ControlCommand, ControlRequest, ControlResponse, IpcError, Node, PlannerKind,
    PlannerRequest,
};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long to wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// What can be requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Plan from the present state, then start the plan
    SwingUp,
    /// Plan from upright to hanging at rest, then start the plan
    SwingDown,
    /// Hold the arm where it is
    Hold,
    /// Decelerate the arm, then hold
    Stop,
    /// Open the brakes and hold
    Enable,
    /// Leave a fault; brakes stay closed
    Reset,
}

impl Action {
    /// Every action.
    pub const ALL: [Self; 6] =
        [Self::SwingUp, Self::SwingDown, Self::Hold, Self::Stop, Self::Enable, Self::Reset];

    /// As on the command line: `swing-up`, ...
    pub const fn name(self) -> &'static str {
        match self {
            Self::SwingUp => "swing-up",
            Self::SwingDown => "swing-down",
            Self::Hold => "hold",
            Self::Stop => "stop",
            Self::Enable => "enable",
            Self::Reset => "reset",
        }
    }

    /// What it does, in a line.
    pub const fn purpose(self) -> &'static str {
        match self {
            Self::SwingUp => "Plan from the present state, then start the plan",
            Self::SwingDown => "Plan from upright to hanging at rest, then start the plan",
            Self::Hold => "Hold the arm where it is",
            Self::Stop => "Decelerate the arm, then hold",
            Self::Enable => "Open the brakes and hold",
            Self::Reset => "Leave a fault; brakes stay closed",
        }
    }

    /// The action of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|action| action.name() == name)
    }

    /// What is asked of planner or daemon.
    pub const fn kind(self) -> Kind {
        match self {
            Self::SwingUp => Kind::Plan(PlannerKind::SwingUp),
            Self::SwingDown => Kind::Plan(PlannerKind::SwingDown),
            Self::Hold => Kind::Control(ControlCommand::Hold),
            Self::Stop => Kind::Control(ControlCommand::Stop),
            Self::Enable => Kind::Control(ControlCommand::Enable),
            Self::Reset => Kind::Control(ControlCommand::Reset),
        }
    }
}

/// Who is asked first.
pub enum Kind {
    /// The daemon alone.
    Control(ControlCommand),
    /// The planner, then the daemon.
    Plan(PlannerKind),
}

/// Why a request had no success.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// The daemon says no.
    #[error("the daemon refused `{command}` in mode {mode}: {reason}")]
    Daemon {
        /// What was asked.
        command: ControlCommand,
        /// Why not.
        reason: String,
        /// Its mode.
        mode: String,
    },
    /// The planner says no.
    #[error("the planner refused: {0}")]
    Planner(String),
    /// The plan does not reach the daemon.
    #[error("the daemon did not take the plan: {0}")]
    NotTaken(String),
    /// Withdrawn in time.
    #[error("interrupted before the start of the plan; nothing moves")]
    Interrupted,
    /// Withdrawn just after the start.
    #[error("interrupted at the start of the plan; the arm stops")]
    Stopped,
    /// No answer.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Shared memory.
    #[error(transparent)]
    Ipc(#[from] IpcError),
}

/// An accepted request.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Accepted {
    /// Always true.
    pub success: bool,
    /// Mode of the daemon afterwards.
    pub mode: String,
    /// Id of the plan that was started.
    pub plan_id: Option<String>,
    /// Duration of the plan t_F, s.
    pub t_f: Option<f64>,
    /// From the request to the plan, s.
    pub planning_s: Option<f64>,
}

impl std::fmt::Display for Accepted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "accepted; mode {}", self.mode)?;
        if let (Some(t_f), Some(planning)) = (self.t_f, self.planning_s) {
            write!(f, "; plan of {t_f:.3} s {}", planning_text(planning))?;
        }
        Ok(())
    }
}

/// A connection to the daemon; stays in its thread.
pub struct Operator {
    control: Client<ControlRequest>,
    node: Node,
}

impl Operator {
    /// Connects, whether or not there is a daemon.
    ///
    /// # Errors
    /// [`OperatorError::Ipc`]
    pub fn new(node: &Node) -> Result<Self, OperatorError> {
        Ok(Self { control: node.client()?, node: node.clone() })
    }

    /// Does what is asked. Raising `interrupted` withdraws a plan before it starts.
    ///
    /// # Errors
    /// [`OperatorError`] with the reason.
    pub fn request(&self, action: Action, interrupted: &AtomicBool) -> Result<Accepted, OperatorError> {
        match action.kind() {
            Kind::Plan(kind) => self.plan_and_start(kind, interrupted),
            Kind::Control(command) => {
                let answer = self.control(command)?;
                Ok(Accepted {
                    success: true,
                    mode: answer.mode_text(),
                    plan_id: None,
                    t_f: None,
                    planning_s: None,
                })
            }
        }
    }

    /// How the daemon is.
    ///
    /// # Errors
    /// [`OperatorError`] if there is none.
    pub fn status(&self) -> Result<ControlResponse, OperatorError> {
        self.control(ControlCommand::Status)
    }

    fn control(&self, command: ControlCommand) -> Result<ControlResponse, OperatorError> {
        self.ask(command, &ControlRequest::new(command))
    }

    fn ask(
        &self,
        command: ControlCommand,
        request: &ControlRequest,
    ) -> Result<ControlResponse, OperatorError> {
        let answer = self.control.call(request, PATIENCE)?;
        if answer.accepted == 1 {
            Ok(answer)
        } else {
            let (reason, mode) = (answer.reason.to_string(), answer.mode_text());
            Err(OperatorError::Daemon { command, reason, mode })
        }
    }

    fn plan_and_start(&self, kind: PlannerKind, interrupted: &AtomicBool) -> Result<Accepted, OperatorError> {
        let planner = self.node.client::<PlannerRequest>()?;
        let request = PlannerRequest::from_now(kind);
        let plan = match planner.call_while(&request, PATIENCE, || !interrupted.load(Ordering::Acquire)) {
            Err(CallError::Interrupted { .. }) => return Err(OperatorError::Interrupted),
            answer => answer?,
        };
        if plan.plan_id == 0 {
            return Err(OperatorError::Planner(plan.reason.to_string()));
        }
        let begin = Instant::now();
        loop {
            let status = self.status()?;
            if interrupted.load(Ordering::Acquire) {
                return Err(OperatorError::Interrupted);
            }
            // It may begin when the moment that its first state was predicted for has come.
            if status.plan_id == plan.plan_id && status.t_ns >= plan.activation_ns {
                break;
            }
            if begin.elapsed() > PATIENCE {
                return Err(OperatorError::NotTaken(status.reason.to_string()));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let answer = self.ask(ControlCommand::Start, &ControlRequest::start(plan.plan_id))?;
        // Whoever interrupts a moment too late wants the arm to stand, too.
        if interrupted.load(Ordering::Acquire) {
            self.control(ControlCommand::Stop)?;
            return Err(OperatorError::Stopped);
        }
        Ok(Accepted {
            success: true,
            mode: answer.mode_text(),
            plan_id: Some(format!("{:016x}", plan.plan_id)),
            t_f: Some(plan.t_f),
            planning_s: Some(plan.time_total_us * 1e-6),
        })
    }
}

/// How long planning took, s: no replan takes less than a millisecond, so that one was there before it was asked for.
pub fn planning_text(seconds: f64) -> String {
    if seconds < 1e-3 { "kept ready".into() } else { format!("made in {:.0} ms", 1e3 * seconds) }
}
