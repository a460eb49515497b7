//! A swing-up or swing-down from the state the system is in: enable, plan, start, balance or hold.

use crate::session::{Session, SessionError};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use upswing_ipc::{ControlCommand, Mode, PlannerKind, PlannerResponse};

/// Time in which the arm settles on its hold before the plan is made, s.
pub const SETTLE: f64 = 0.25;
/// Longest wait for a mode or a plan to take effect.
const PATIENCE: Duration = Duration::from_secs(30);

/// Swings up and balances for `seconds`; the session then holds all records. `period` in s. `progress` is told how
/// much has passed of how long, s.
///
/// # Errors
/// [`SessionError`], also if the daemon leaves the modes of a swing-up.
pub fn swing_up(
    session: &mut Session,
    period: f64,
    seconds: f64,
    interrupted: &AtomicBool,
    progress: &dyn Fn(f64, f64),
) -> Result<PlannerResponse, SessionError> {
    let cycles = |s: f64| (s / period).ceil() as u64;
    // A daemon that has measured nothing yet refuses to be enabled.
    session.advance(1)?;
    session.control(ControlCommand::Enable)?;
    session.advance(cycles(SETTLE))?;
    expect_mode(session, &[Mode::Hold])?;
    execute(session, PlannerKind::SwingUp, period, seconds, interrupted, progress)
}

/// Plans from the present state, starts the plan and lets its duration and `seconds` pass. `period` in s, `progress` as
/// for [`swing_up`].
///
/// # Errors
/// [`SessionError`], also if the daemon leaves the modes of a swing-up or swing-down.
pub fn execute(
    session: &mut Session,
    kind: PlannerKind,
    period: f64,
    seconds: f64,
    interrupted: &AtomicBool,
    progress: &dyn Fn(f64, f64),
) -> Result<PlannerResponse, SessionError> {
    let cycles = |s: f64| (s / period).ceil() as u64;
    let plan = plan_and_start(session, kind)?;
    // In portions, so that an interrupt or a fault ends the wait; a plant that runs by itself does not wait for them.
    let (begin, total) = (session.now()?, cycles(plan.t_f + seconds));
    let mut passed = 0;
    while passed < total {
        if interrupted.load(Ordering::Acquire) {
            return Err(SessionError::Interrupted);
        }
        session.advance_to(begin + total.min(passed + cycles(0.1)))?;
        expect_mode(session, &[Mode::Hold, Mode::Track, Mode::Balance])?;
        passed = total.min(session.now()?.saturating_sub(begin));
        progress(passed as f64 * period, total as f64 * period);
    }
    Ok(plan)
}

/// Plans from the present state and starts the plan.
///
/// # Errors
/// [`SessionError`] if planner or daemon refuse.
pub fn plan_and_start(session: &mut Session, kind: PlannerKind) -> Result<PlannerResponse, SessionError> {
    let plan = session.plan_from_now(kind)?;
    session.wait_for("the daemon to load the plan and its time to come", PATIENCE, |s| {
        let status = s.ask_control(ControlCommand::Status)?;
        Ok(status.plan_id == plan.plan_id && status.t_ns >= plan.activation_ns)
    })?;
    session.start_plan(plan.plan_id)?;
    Ok(plan)
}

fn expect_mode(session: &Session, modes: &[Mode]) -> Result<(), SessionError> {
    let Some(last) = session.records.last() else { return Ok(()) };
    match last.mode() {
        Ok(mode) if modes.contains(&mode) => Ok(()),
        _ => {
            let mode = last.mode_text();
            let cause = upswingd::fault_text(last.fault);
            let reason =
                format!("it is in mode {mode}{}", cause.map_or_else(String::new, |c| format!(": {c}")));
            Err(SessionError::Refused { role: "daemon", reason })
        }
    }
}
