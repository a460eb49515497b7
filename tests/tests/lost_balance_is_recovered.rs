//! After a rod is thrown over in Balance the arm stops and holds, the pendulum comes to rest, and the daemon swings up
//! again and balances, at most as often as set; then it stays in Hold.

use std::time::{Duration, Instant};
use upswing_ipc::{Clock, Mode, PlantKind, PlantRequest};
use upswing_tests::{START, System};

/// Cycles between two looks, and of a second.
const STEP: u64 = 80;
const SECOND: u64 = 8_000;
/// Longest wait for the planner, which works in real time, and for the rest of the pendulum.
const PATIENCE: Duration = Duration::from_secs(180);

/// Settings with one attempt, and with bearings in which the pendulum comes to rest within seconds.
fn settings() -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    upswing_planner::export(
        &upswing_config::Config::embedded().expect("embedded settings"),
        dir.path(),
        Default::default(),
    )
    .expect("export");
    let edit = |file: &str, from: &str, to: &str| {
        let path = dir.path().join(file);
        let text = std::fs::read_to_string(&path).expect("exported file");
        assert_eq!(text.matches(from).count(), 1, "`{from}` in {file}");
        std::fs::write(path, text.replace(from, to)).expect("edited file");
    };
    edit("daemon.toml", "attempts = 0", "attempts = 1");
    edit("plant.toml", "pendulum_1 = 0.0005, pendulum_2 = 0.0005", "pendulum_1 = 0.008, pendulum_2 = 0.008");
    dir
}

/// Throws the rod over, and lets time pass until the arm has stopped.
fn throw_over(system: &mut System) {
    let impulse = [0.06, -0.08, 0.0];
    must(system.session.plant(&PlantRequest { cycles: STEP, impulse, ..PlantRequest::new(PlantKind::Push) }));
    let stop = system.wait_until("a stop", |record| record.mode() != Ok(Mode::Balance));
    assert_eq!(stop.mode(), Ok(Mode::Stop), "{}", stop.mode_text());
    let after = system.wait_until("the end of the stop", |record| record.mode() != Ok(Mode::Stop));
    assert_eq!(after.mode(), Ok(Mode::Hold));
}

fn must<T, E: std::fmt::Display>(result: Result<T, E>) -> T {
    result.unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn as_often_as_set_and_then_held() {
    let dir = settings();
    let mut system = System::start_with(Clock::Lockstep, START, Some(dir.path()));
    system.bring_to(Mode::Balance);
    system.advance(SECOND);
    throw_over(&mut system);
    let begin = Instant::now();
    let mode = |system: &System| system.session.records.last().and_then(|record| record.mode().ok());
    while mode(&system) != Some(Mode::Track) {
        system.advance(STEP);
        assert_eq!(mode(&system).filter(|mode| !matches!(mode, Mode::Hold | Mode::Track)), None);
        assert!(begin.elapsed() < PATIENCE, "no swing-up");
    }
    system.wait_until("balance", |record| record.mode() == Ok(Mode::Balance));
    let before = system.session.records.len();
    system.advance(2 * SECOND);
    let after = &system.session.records[before..];
    assert!(after.len() as u64 >= 2 * SECOND, "two seconds of balance");
    assert!(after.iter().all(|record| record.mode() == Ok(Mode::Balance)));
    // The only attempt is used up.
    throw_over(&mut system);
    let before = system.session.records.len();
    system.advance(40 * SECOND);
    let after = &system.session.records[before..];
    assert!(after.len() as u64 >= 40 * SECOND && after.iter().all(|record| record.mode() == Ok(Mode::Hold)));
}
