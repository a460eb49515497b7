//! After a lost balance the arm stops and holds, the pendulum comes to rest, and the daemon swings up again by itself as
//! often as the settings allow; then it stays in Hold.

use std::time::{Duration, Instant};
use upswing::swing_up::plan_and_start;
use upswing_config::Config;
use upswing_ipc::{Clock, ControlCommand, Mode, PlannerKind};
use upswing_tests::System;

const START: [f64; 7] = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
/// Cycles between two looks.
const STEP: u64 = 80;
/// Longest wait for a mode, cycles: a minute of virtual time.
const LONGEST: usize = 60 * 8000;
/// Longest wait for the planner, which works in real time, and for the rest of the pendulum.
const PATIENCE: Duration = Duration::from_secs(180);

/// Settings with `attempts`, with bearings in which the pendulum comes to rest within seconds, and with a balance that
/// counts as lost as soon as it begins.
fn settings(attempts: u32) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    Config::export(dir.path()).expect("export");
    let edit = |file: &str, from: &str, to: &str| {
        let path = dir.path().join(file);
        let text = std::fs::read_to_string(&path).expect("exported file");
        assert_eq!(text.matches(from).count(), 1, "`{from}` in {file}");
        std::fs::write(path, text.replace(from, to)).expect("edited file");
    };
    edit("daemon.toml", "attempts = 0", &format!("attempts = {attempts}"));
    let tilt = "balance_tilt_deg = { warn = 10, trip = 25 }";
    edit("daemon.toml", tilt, "balance_tilt_deg = { warn = 0.0001, trip = 0.001 }");
    edit("daemon.toml", "rest_speed_rad_s = 0.05", "rest_speed_rad_s = 0.15");
    edit("plant.toml", "pendulum_viscous = [0.0005, 0.0005]", "pendulum_viscous = [0.008, 0.008]");
    dir
}

fn mode(system: &System) -> Option<Mode> {
    system.session.records.last().and_then(|record| record.mode().ok())
}

/// Lets time pass until the daemon has been in `goal`, and then is in another mode.
fn pass(system: &mut System, goal: Mode) {
    let begin = system.session.records.len();
    let was_there =
        |system: &System| system.session.records[begin..].iter().any(|record| record.mode() == Ok(goal));
    while !was_there(system) || mode(system) == Some(goal) {
        step(system);
        let passed = system.session.records.len() - begin;
        assert!(passed < LONGEST, "{goal} not passed, it is {:?}", mode(system));
    }
}

fn step(system: &mut System) {
    system.session.advance(STEP).unwrap_or_else(|e| panic!("{e}"));
}

/// The daemon's first swing-up, at the operator's request, and the stop after it.
fn fallen(attempts: u32) -> (System, tempfile::TempDir) {
    let dir = settings(attempts);
    let mut system = System::start_with(Clock::Lockstep, START, Some(dir.path()));
    let session = &mut system.session;
    let mut swing = || {
        session.advance(1)?;
        session.control(ControlCommand::Enable)?;
        session.advance(2000)?;
        plan_and_start(session, PlannerKind::SwingUp)
    };
    swing().unwrap_or_else(|e| panic!("{e}"));
    pass(&mut system, Mode::Stop);
    assert_eq!(mode(&system), Some(Mode::Hold));
    (system, dir)
}

#[test]
fn as_often_as_set_and_then_held() {
    for attempts in [0, 1] {
        let (mut system, _settings) = fallen(attempts);
        for _ in 0..attempts {
            let begin = Instant::now();
            while mode(&system) != Some(Mode::Track) {
                step(&mut system);
                assert!(begin.elapsed() < PATIENCE, "no swing-up");
            }
            pass(&mut system, Mode::Stop);
        }
        let before = system.session.records.len();
        system.session.advance(5 * 8000).unwrap_or_else(|e| panic!("{e}"));
        let after = &system.session.records[before..];
        assert!(after.len() >= 5 * 8000 && after.iter().all(|record| record.mode() == Ok(Mode::Hold)));
    }
}
