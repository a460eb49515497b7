//! After SIGTERM in any mode, also if it is sent twice, the daemon brings the arm to rest, closes the brakes, and exits
//! with success.

use upswing_ipc::{Clock, Mode};
use upswing_rig::session::Role;
use upswing_tests::{START, System};

fn ends_from(mode: Mode) {
    let mut system = System::start(Clock::Paced, START);
    system.bring_to(mode);
    let session = &mut system.session;
    let before = session.records.len().saturating_sub(1);
    // `end` sends another one at once.
    session.signal(Role::Daemon, libc::SIGTERM);
    session.end().unwrap_or_else(|e| panic!("{e}"));
    let modes: Vec<Mode> = session.records[before..].iter().filter_map(|r| r.mode().ok()).collect();
    if matches!(mode, Mode::Idle | Mode::Fault) {
        assert!(modes.iter().all(|m| *m == mode), "brakes open in {mode}");
        return;
    }
    // A plan, or a stop, may have ended before the signal came.
    let ended = match mode {
        Mode::Track => Mode::Balance,
        Mode::Stop => Mode::Hold,
        mode => mode,
    };
    let first = modes.iter().position(|m| ![mode, ended].contains(m) || *m == Mode::Stop);
    let stop = first.expect("it stops first");
    let idle = modes.iter().position(|m| *m == Mode::Idle).expect("it ends with closed brakes");
    assert!(stop < idle && modes[stop] == Mode::Stop, "{mode} -> {} -> stop", modes[stop]);
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

#[test]
fn from_stop() {
    ends_from(Mode::Stop);
}

#[test]
fn from_fault() {
    ends_from(Mode::Fault);
}
