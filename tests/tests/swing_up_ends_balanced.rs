//! Three separate processes swing up and balance from starts at rest over the paper's ranges: in the last second the rod
//! stays within 2 deg of upright, and position and torque limits are never exceeded.

use upswing_ipc::Clock;
use upswing_tests::System;

/// Balance time, s.
const SECONDS: f64 = 3.0;

fn check(clock: Clock, start_deg: &[f64]) {
    let mut system = System::start(clock, start_deg);
    let report = system.swing_up(SECONDS);
    assert!(report.success, "{start_deg:?}: {report}");
    system.session.end().unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn from_the_papers_experiment() {
    check(Clock::Lockstep, &[0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
}

#[test]
fn from_the_papers_simulation() {
    check(Clock::Lockstep, &[-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
}

#[test]
fn from_a_low_flange() {
    check(Clock::Lockstep, &[45.0, 30.0, 0.0, -60.0, 0.0, 20.0, 0.0]);
}

#[test]
fn from_a_folded_arm() {
    check(Clock::Lockstep, &[-60.0, -30.0, 0.0, -120.0, 0.0, -20.0, 0.0]);
}

#[test]
fn from_a_high_flange() {
    check(Clock::Lockstep, &[10.0, -30.0, 0.0, -100.0, 0.0, 60.0, 0.0]);
}

#[test]
fn at_real_time_pace() {
    check(Clock::Paced, &[0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
}
