//! The requests of an operator to a running system, and the client that makes them.
//!
//! A manoeuvre takes the same course everywhere: [`Operator::plan`], wait until the daemon has loaded the plan and the plan is due
//! ([`PublishedPlan::is_due`]), start that plan by its id.

use crate::{
    CallError, Client, ControlKind, ControlRequest, ControlResponse, IpcError, ManoeuvreRequest, Mode,
    NoName, Node, PlannerRequest, PlannerResponse,
};
use serde::Serialize;
use std::cell::OnceCell;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use upswing_model::Posture;

/// Longest wait for a response, and for the daemon to load a plan.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause between two looks at the loaded plan.
const PAUSE: Duration = Duration::from_millis(1);

/// A request that an operator can make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OperatorRequest {
    /// Plan the manoeuvre from the present state, then start the plan.
    Manoeuvre(ManoeuvreRequest),
    /// Hold the present pose of the arm.
    Hold,
    /// Decelerate the arm, then hold.
    Stop,
    /// Open the brakes and hold.
    Enable,
    /// Leave a fault; the brakes stay closed.
    Reset,
}

impl OperatorRequest {
    /// The requests that every system takes; the others are the manoeuvres of its settings.
    pub const COMMANDS: [Self; 4] = [Self::Hold, Self::Stop, Self::Enable, Self::Reset];

    /// Name on the command line: `hold`, ..., or that of the manoeuvre.
    pub fn name(&self) -> &str {
        match self {
            Self::Manoeuvre(manoeuvre) => manoeuvre.name.as_str(),
            Self::Hold => "hold",
            Self::Stop => "stop",
            Self::Enable => "enable",
            Self::Reset => "reset",
        }
    }

    /// Purpose in one line.
    pub const fn purpose(self) -> &'static str {
        match self {
            Self::Manoeuvre(_) => "Plan from the current state, then start the plan",
            Self::Hold => "Hold the current pose",
            Self::Stop => "Decelerate, then hold",
            Self::Enable => "Open the brakes and hold",
            Self::Reset => "Leave the mode Fault; brakes stay closed",
        }
    }

    /// The request of this name: one of [`Self::COMMANDS`], else a manoeuvre without given values.
    ///
    /// # Errors
    /// [`NoName`] if a manoeuvre cannot have this name.
    pub fn from_name(name: &str) -> Result<Self, NoName> {
        match Self::COMMANDS.into_iter().find(|request| request.name() == name) {
            Some(command) => Ok(command),
            None => Ok(Self::Manoeuvre(ManoeuvreRequest::new(name, &[])?)),
        }
    }

    /// The command to the daemon, or the manoeuvre that has to be planned first.
    ///
    /// # Errors
    /// The manoeuvre.
    pub const fn command(&self) -> Result<ControlKind, &ManoeuvreRequest> {
        match self {
            Self::Manoeuvre(manoeuvre) => Err(manoeuvre),
            Self::Hold => Ok(ControlKind::Hold),
            Self::Stop => Ok(ControlKind::Stop),
            Self::Enable => Ok(ControlKind::Enable),
            Self::Reset => Ok(ControlKind::Reset),
        }
    }
}

impl fmt::Display for OperatorRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// What an operator does next; its text fits into a narrow column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextAction<'a> {
    /// Make this request.
    Make(OperatorRequest),
    /// Request this manoeuvre; `None`: one that starts in this mode.
    Manoeuvre(Option<&'a str>),
    /// Wait for the end of the motion, or make this request.
    WaitOr(OperatorRequest),
    /// Wait until the arm has decelerated and holds.
    WaitForRest,
}

impl fmt::Display for NextAction<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Make(request) => write!(f, "upswing request {request}"),
            Self::Manoeuvre(Some(name)) => write!(f, "upswing request {name}"),
            Self::Manoeuvre(None) => f.write_str("request a manoeuvre"),
            Self::WaitOr(request) => write!(f, "wait, or upswing request {request}"),
            Self::WaitForRest => f.write_str("wait until the robot rests"),
        }
    }
}

impl Mode {
    /// The mode in which manoeuvres from a posture start.
    pub const fn from_posture(start: Posture) -> Self {
        match start {
            Posture::Hanging => Self::Hold,
            Posture::Standing => Self::Balance,
        }
    }

    /// What an operator does next in this mode; in Idle, if measurement and drives are fit. `first`: name of the system's first
    /// manoeuvre from a posture, `None` if it has none or the settings are not at hand.
    pub fn next_action<'a>(self, first: impl Fn(Posture) -> Option<&'a str>) -> NextAction<'a> {
        match self {
            Self::Idle => NextAction::Make(OperatorRequest::Enable),
            Self::Hold => NextAction::Manoeuvre(first(Posture::Hanging)),
            Self::Track => NextAction::WaitOr(OperatorRequest::Stop),
            Self::Balance => NextAction::Manoeuvre(first(Posture::Standing)),
            Self::Stop => NextAction::WaitForRest,
            Self::Fault => NextAction::Make(OperatorRequest::Reset),
        }
    }
}

impl PlannerRequest {
    /// A request for a plan from the present state, to be published to the daemon.
    pub fn from_now(manoeuvre: ManoeuvreRequest) -> Self {
        Self { manoeuvre, from_now: 1, publish: 1, ..Self::default() }
    }
}

/// A plan that the planner has published to the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishedPlan {
    /// Id of the plan.
    pub id: u64,
    /// Earliest start, ns on the daemon's clock: the time for which the first state of the plan was predicted.
    pub activation_ns: u64,
}

impl PublishedPlan {
    /// Whether the plan can be started: plan `loaded` is loaded in the daemon, whose time is `t_ns`, ns.
    pub fn is_due(&self, loaded: u64, t_ns: u64) -> bool {
        self.id == loaded && self.activation_ns <= t_ns
    }
}

impl From<&PlannerResponse> for PublishedPlan {
    fn from(response: &PlannerResponse) -> Self {
        Self { id: response.plan_id, activation_ns: response.activation_ns }
    }
}

/// Sends a request for a plan, to be published to the daemon. The request is withdrawn once `wanted` returns false.
///
/// # Errors
/// [`OperatorError::Planner`] if the planner makes no plan, [`OperatorError::Call`] if it does not respond.
pub fn request_plan(
    planner: &Client<PlannerRequest>,
    request: &PlannerRequest,
    patience: Duration,
    wanted: impl FnMut() -> bool,
) -> Result<PlannerResponse, OperatorError> {
    let response = planner.call_while(request, patience, wanted)?;
    if response.plan_id == 0 {
        return Err(OperatorError::Planner(response.reason.to_string()));
    }
    Ok(response)
}

/// Why a request failed.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// The daemon refused the request.
    #[error("the daemon refused `{command}` in mode {mode}: {reason}")]
    Daemon {
        /// Name of the command.
        command: String,
        /// Reason of the refusal.
        reason: String,
        /// Mode of the daemon.
        mode: String,
    },
    /// The planner made no plan.
    #[error("the planner refused: {0}")]
    Planner(String),
    /// The daemon did not load the plan in time.
    #[error("the daemon did not take the plan: {0}")]
    NotTaken(String),
    /// Interrupted before the plan started.
    #[error("interrupted before the start of the plan; nothing moves")]
    Interrupted,
    /// Interrupted when the plan had just started.
    #[error("interrupted at the start of the plan; the arm stops")]
    Stopped,
    /// The name is none of a manoeuvre.
    #[error(transparent)]
    Name(#[from] NoName),
    /// No response.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Shared memory cannot be used.
    #[error(transparent)]
    Ipc(#[from] IpcError),
}

/// An accepted request.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AcceptedRequest {
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

impl fmt::Display for AcceptedRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "accepted; mode {}", self.mode)?;
        if let (Some(t_f), Some(planning)) = (self.t_f, self.planning_s) {
            write!(f, "; plan of {t_f:.3} s {}", planning_text(planning))?;
        }
        Ok(())
    }
}

/// The client of the daemon and, for manoeuvres, of the planner. It stays in the thread that opened it.
pub struct Operator {
    control: Client<ControlRequest>,
    /// Opened for the first plan: a stop must not depend on the planner's service.
    planner: OnceCell<Client<PlannerRequest>>,
    patience: Duration,
    node: Node,
}

impl Operator {
    /// Opens the client, whether or not a daemon is running.
    ///
    /// # Errors
    /// [`OperatorError::Ipc`]
    pub fn new(node: &Node) -> Result<Self, OperatorError> {
        Self::with_patience(node, PATIENCE)
    }

    /// As [`Self::new`], with another longest wait for a response.
    ///
    /// # Errors
    /// [`OperatorError::Ipc`]
    pub fn with_patience(node: &Node, patience: Duration) -> Result<Self, OperatorError> {
        Ok(Self { control: node.client()?, planner: OnceCell::new(), patience, node: node.clone() })
    }

    /// Whether a daemon is running.
    pub fn has_daemon(&self) -> bool {
        self.control.has_server()
    }

    /// Whether a planner is running.
    ///
    /// # Errors
    /// [`OperatorError::Ipc`]
    pub fn has_planner(&self) -> Result<bool, OperatorError> {
        Ok(self.planner()?.has_server())
    }

    /// Makes a request and waits until it has taken effect. Raising `interrupted` withdraws a manoeuvre before it starts.
    ///
    /// # Errors
    /// [`OperatorError`] with the reason.
    pub fn request(
        &self,
        request: OperatorRequest,
        interrupted: &AtomicBool,
    ) -> Result<AcceptedRequest, OperatorError> {
        let command = match request.command() {
            Ok(command) => command,
            Err(manoeuvre) => return self.execute(*manoeuvre, interrupted),
        };
        let mode = self.control(&ControlRequest::new(command), &mut || true)?.mode_text();
        Ok(AcceptedRequest { success: true, mode, plan_id: None, t_f: None, planning_s: None })
    }

    /// The state of the daemon.
    ///
    /// # Errors
    /// [`OperatorError`] if no daemon responds.
    pub fn status(&self) -> Result<ControlResponse, OperatorError> {
        self.control(&ControlRequest::new(ControlKind::Status), &mut || true)
    }

    /// Sends a request to the daemon, which must accept it. `wanted` is called again and again during the wait; once it returns
    /// false, the request is withdrawn.
    ///
    /// # Errors
    /// [`OperatorError::Daemon`] with the reason of a refusal, [`OperatorError::Call`] if no response comes.
    pub fn control(
        &self,
        request: &ControlRequest,
        wanted: &mut dyn FnMut() -> bool,
    ) -> Result<ControlResponse, OperatorError> {
        let response = self.control.call_while(request, self.patience, wanted)?;
        if response.accepted == 1 {
            return Ok(response);
        }
        Err(OperatorError::Daemon {
            command: request.kind().map_or_else(|unknown| unknown.to_string(), |command| command.to_string()),
            reason: response.reason.to_string(),
            mode: response.mode_text(),
        })
    }

    /// Asks the planner for a manoeuvre from the state in the newest record of the daemon, or a later one, to be published to the
    /// daemon. The request is withdrawn once `wanted` returns false.
    ///
    /// # Errors
    /// As [`request_plan`]; [`OperatorError::Call`] if the daemon does not respond.
    pub fn plan(
        &self,
        manoeuvre: ManoeuvreRequest,
        wanted: &mut dyn FnMut() -> bool,
    ) -> Result<PlannerResponse, OperatorError> {
        let known_seq = self.control(&ControlRequest::new(ControlKind::Status), wanted)?.seq;
        let request = PlannerRequest { known_seq, ..PlannerRequest::from_now(manoeuvre) };
        request_plan(self.planner()?, &request, self.patience, wanted)
    }

    fn planner(&self) -> Result<&Client<PlannerRequest>, OperatorError> {
        if let Some(planner) = self.planner.get() {
            return Ok(planner);
        }
        let planner = self.node.client()?;
        Ok(self.planner.get_or_init(|| planner))
    }

    fn execute(
        &self,
        manoeuvre: ManoeuvreRequest,
        interrupted: &AtomicBool,
    ) -> Result<AcceptedRequest, OperatorError> {
        let is_interrupted = || interrupted.load(Ordering::Acquire);
        let plan = match self.plan(manoeuvre, &mut || !is_interrupted()) {
            Err(OperatorError::Call(CallError::Interrupted { .. })) => {
                return Err(OperatorError::Interrupted);
            }
            plan => plan?,
        };
        let begin = Instant::now();
        loop {
            let status = self.status()?;
            if is_interrupted() {
                return Err(OperatorError::Interrupted);
            }
            if PublishedPlan::from(&plan).is_due(status.plan_id, status.t_ns) {
                break;
            }
            if begin.elapsed() > self.patience {
                return Err(OperatorError::NotTaken(status.reason.to_string()));
            }
            std::thread::sleep(PAUSE);
        }
        let response = self.control(&ControlRequest::start(plan.plan_id), &mut || true)?;
        // Whoever interrupts a moment too late wants the arm to stand, too.
        if is_interrupted() {
            self.control(&ControlRequest::new(ControlKind::Stop), &mut || true)?;
            return Err(OperatorError::Stopped);
        }
        Ok(AcceptedRequest {
            success: true,
            mode: response.mode_text(),
            plan_id: Some(format!("{:016x}", plan.plan_id)),
            t_f: Some(plan.t_f),
            planning_s: Some(plan.time_total_us * 1e-6),
        })
    }
}

/// The planning time, s, as text. No replan takes less than a millisecond: such a plan was ready before the request.
pub fn planning_text(seconds: f64) -> String {
    if seconds < 1e-3 { "kept ready".into() } else { format!("made in {:.0} ms", 1e3 * seconds) }
}
