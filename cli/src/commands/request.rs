//! `upswing request`: what an operator asks of a running system.

use super::{CommonArgs, failed};
use serde::Serialize;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use upswing_config::process::{Failure, shutdown_flag};
use upswing_ipc::{ControlCommand, ControlRequest, ControlResponse, Node, PlannerKind, PlannerRequest};

/// How long to wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// Asks the running system to do something.
///
/// Example: upswing request enable && upswing request swing-up
#[derive(Clone, Debug, clap::Args)]
pub struct RequestArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// What to do
    #[arg(value_enum)]
    pub what: What,
}

/// What can be requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
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

#[derive(Serialize)]
struct Answer {
    success: bool,
    mode: String,
    plan_id: Option<String>,
    t_f: Option<f64>,
    planning_s: Option<f64>,
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "accepted; mode {}", self.mode)?;
        if let (Some(t_f), Some(planning)) = (self.t_f, self.planning_s) {
            write!(f, "; plan of {t_f:.3} s made in {:.0} ms", 1e3 * planning)?;
        }
        Ok(())
    }
}

/// Sends the request.
///
/// # Errors
/// [`Failure::Failed`] with the reason if it is refused or nobody answers.
pub fn run(args: &RequestArgs) -> Result<(), Failure> {
    let node = args.common.connect()?;
    let control = |command| control(&node, command);
    let answer = match args.what {
        What::SwingUp => return plan_and_start(PlannerKind::SwingUp, &node, &args.common),
        What::SwingDown => return plan_and_start(PlannerKind::SwingDown, &node, &args.common),
        What::Hold => control(ControlCommand::Hold)?,
        What::Stop => control(ControlCommand::Stop)?,
        What::Enable => control(ControlCommand::Enable)?,
        What::Reset => control(ControlCommand::Reset)?,
    };
    args.common.print(&Answer {
        success: true,
        mode: mode(&answer),
        plan_id: None,
        t_f: None,
        planning_s: None,
    })
}

fn plan_and_start(kind: PlannerKind, node: &Node, common: &CommonArgs) -> Result<(), Failure> {
    // Ctrl-C withdraws the request: the planner stops, and nothing moves.
    let interrupted = shutdown_flag()?;
    let planner = node.planner_client().map_err(failed)?;
    let request = PlannerRequest { kind: kind.code(), from_now: 1, publish: 1, ..PlannerRequest::default() };
    let plan = planner.call_unless(&request, PATIENCE, &interrupted).map_err(failed)?;
    if plan.plan_id == 0 {
        return Err(failed(format!(
            "the planner refused: {}",
            plan.reason.as_str().unwrap_or("no reason given")
        )));
    }
    let begin = Instant::now();
    loop {
        let status = control(node, ControlCommand::Status)?;
        if status.plan_id == plan.plan_id {
            break;
        }
        if interrupted.load(Ordering::Acquire) {
            return Err(failed("interrupted before the start of the plan; nothing moves"));
        }
        if begin.elapsed() > PATIENCE {
            return Err(failed(format!("the daemon did not take the plan: {}", reason(&status))));
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let answer = control(node, ControlCommand::Start)?;
    common.print(&Answer {
        success: true,
        mode: mode(&answer),
        plan_id: Some(format!("{:016x}", plan.plan_id)),
        t_f: Some(plan.t_f),
        planning_s: Some(plan.time_total_us * 1e-6),
    })
}

/// Sends a command to the daemon.
///
/// # Errors
/// [`Failure::Failed`] if there is no daemon or it refuses.
pub fn control(node: &Node, command: ControlCommand) -> Result<ControlResponse, Failure> {
    let client = node.control_client().map_err(failed)?;
    let answer = client.call(&ControlRequest::new(command), PATIENCE).map_err(failed)?;
    if answer.accepted == 1 {
        Ok(answer)
    } else {
        Err(failed(format!("the daemon refused `{command}`: {}", reason(&answer))))
    }
}

/// The mode as text.
pub fn mode(answer: &ControlResponse) -> String {
    answer.mode().map_or_else(|e| e.to_string(), |m| m.to_string())
}

/// The reason or remark of an answer.
pub fn reason(answer: &ControlResponse) -> String {
    answer.reason.as_str().map_or_else(|e| e.to_string(), str::to_owned)
}
