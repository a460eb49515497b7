//! SIGTERM to the daemon, in any mode and also if it comes twice: the arm comes to rest, then the brakes close, then the
//! process ends with success.

use std::time::Duration;
use upswing::session::{Role, SessionError};
use upswing::swing_up::plan_and_start;
use upswing_ipc::{Clock, ControlCommand, Mode, PlannerKind};
use upswing_tests::System;

const START: [f64; 7] = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
const PATIENCE: Duration = Duration::from_secs(60);

/// Goes to Hold and, where asked for, to Track and Balance.
fn bring_to(mode: Mode) -> Result<System, SessionError> {
    let mut system = System::start(Clock::Paced, START);
    let session = &mut system.session;
    session.advance(1)?;
    if mode != Mode::Idle {
        session.control(ControlCommand::Enable)?;
        session.advance(2000)?;
    }
    if matches!(mode, Mode::Track | Mode::Balance) {
        plan_and_start(session, PlannerKind::SwingUp)?;
    }
    session.wait_for("the mode", PATIENCE, |s| Ok(s.records.last().is_some_and(|r| r.mode() == Ok(mode))))?;
    if mode == Mode::Track {
        // In full swing.
        session.advance(8000)?;
    }
    Ok(system)
}

fn ends_from(mode: Mode) {
    let mut system = bring_to(mode).unwrap_or_else(|e| panic!("{e}"));
    let session = &mut system.session;
    let pid = libc::pid_t::try_from(session.pid(Role::Daemon).expect("a daemon")).expect("an id");
    let before = session.records.len().saturating_sub(1);
    // `end_in_place` sends another one at once.
    // SAFETY: plain system call; the session has not waited for its child.
    assert_eq!(unsafe { libc::kill(pid, libc::SIGTERM) }, 0);
    session.end_in_place().unwrap_or_else(|e| panic!("{e}"));
    let modes: Vec<Mode> = session.records[before..].iter().filter_map(|r| r.mode().ok()).collect();
    if mode == Mode::Idle {
        assert!(modes.iter().all(|m| *m == Mode::Idle), "brakes open in Idle");
        return;
    }
    let stop = modes.iter().position(|m| *m == Mode::Stop).expect("it stops first");
    let idle = modes.iter().position(|m| *m == Mode::Idle).expect("it ends with closed brakes");
    assert!(stop < idle && modes[..stop].iter().all(|m| *m == mode), "{mode} -> other modes -> stop");
    let last = &session.records[before + idle - 1];
    let speed = last.qd[..7].iter().map(|v| v.abs()).fold(0.0, f64::max);
    assert!(speed < 0.1, "brakes close at {speed} rad/s");
}

#[test]
fn from_idle() {
    ends_from(Mode::Idle);
}

#[test]
fn from_hold() {
    ends_from(Mode::Hold);
}

#[test]
fn from_track() {
    ends_from(Mode::Track);
}

#[test]
fn from_balance() {
    ends_from(Mode::Balance);
}
