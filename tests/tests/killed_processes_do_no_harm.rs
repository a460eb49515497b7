//! A killed plant or planner does not take the daemon down; a killed daemon makes the plant close its brakes.

use std::time::Duration;
use upswing::session::{Role, SessionError};
use upswing_ipc::{Clock, ControlCommand, Mode};
use upswing_tests::System;

const START: [f64; 7] = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
/// Shared machines stall; what is waited for happens within a second or two.
const PATIENCE: Duration = Duration::from_secs(20);

fn holding() -> System {
    let mut system = System::start(Clock::Paced, START);
    let session = &mut system.session;
    // A daemon that has just met the plant may not have its first measurement yet.
    session
        .wait_for("the brakes to open", PATIENCE, |s| {
            let _ = s.ask_control(ControlCommand::Enable)?;
            Ok(s.plant_status()?.brakes_closed == 0)
        })
        .unwrap_or_else(|e| panic!("{e}"));
    system
}

fn mode(system: &mut System) -> Result<Mode, SessionError> {
    Ok(system.session.ask_control(ControlCommand::Status)?.mode().expect("a known mode"))
}

#[test]
fn without_its_daemon_the_plant_closes_the_brakes() {
    let mut system = holding();
    system.session.kill(Role::Daemon);
    system
        .session
        .wait_for("the brakes to close", PATIENCE, |s| Ok(s.plant_status()?.brakes_closed == 1))
        .unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn without_its_plant_the_daemon_goes_to_fault_and_lives() {
    let mut system = holding();
    assert_eq!(mode(&mut system).expect("an answer"), Mode::Hold);
    system.session.kill(Role::Plant);
    system
        .session
        .wait_for("a fault", PATIENCE, |s| {
            Ok(s.ask_control(ControlCommand::Status)?.mode() == Ok(Mode::Fault))
        })
        .unwrap_or_else(|e| panic!("{e}"));
    let enabled = system.session.ask_control(ControlCommand::Enable).expect("an answer");
    assert_eq!(enabled.accepted, 0, "a fault is left by reset only");
}

#[test]
fn without_its_planner_the_daemon_keeps_holding() {
    let mut system = holding();
    system.session.kill(Role::Planner);
    let before = system.session.records.len().saturating_sub(1);
    system.session.advance(2000).unwrap_or_else(|e| panic!("{e}"));
    let cycles: Vec<_> = system.session.records[before..].windows(2).map(|w| w[1].seq - w[0].seq).collect();
    assert!(cycles.iter().all(|step| *step == 1), "telemetry has gaps: {cycles:?}");
    assert_eq!(mode(&mut system).expect("an answer"), Mode::Hold);
}
