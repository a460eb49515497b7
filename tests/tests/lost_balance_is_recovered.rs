//! After a lost balance the arm stops and holds, the pendulum comes to rest, and the daemon swings up again by itself as
//! often as the settings allow; then it stays in Hold.

use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::{Clock, Mode};
use upswing_tests::{START, System};

/// Cycles between two looks.
const STEP: u64 = 80;
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

/// Lets time pass until the arm has stopped.
fn pass_stop(system: &mut System) {
    system.wait_until("a stop", |record| record.mode() == Ok(Mode::Stop));
    let after = system.wait_until("the end of the stop", |record| record.mode() != Ok(Mode::Stop));
    assert_eq!(after.mode(), Ok(Mode::Hold));
}

#[test]
fn as_often_as_set_and_then_held() {
    for attempts in [0, 1] {
        let dir = settings(attempts);
        let mut system = System::start_with(Clock::Lockstep, START, Some(dir.path()));
        system.bring_to(Mode::Track);
        pass_stop(&mut system);
        for _ in 0..attempts {
            let begin = Instant::now();
            while mode(&system) != Some(Mode::Track) {
                system.advance(STEP);
                assert!(begin.elapsed() < PATIENCE, "no swing-up");
            }
            pass_stop(&mut system);
        }
        let before = system.session.records.len();
        system.advance(5 * 8000);
        let after = &system.session.records[before..];
        assert!(after.len() >= 5 * 8000 && after.iter().all(|record| record.mode() == Ok(Mode::Hold)));
    }
}
