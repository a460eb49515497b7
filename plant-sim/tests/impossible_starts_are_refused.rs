//! An invalid start is refused with one line that names joint, value and limit, and with exit code 2.

mod common;

use common::settings;
use std::process::{Command as Process, Output};
use upswing_config::PendulumStart;
use upswing_ipc::TempDomain;
use upswing_model::StartError;
use upswing_plant::{Plant, StateError};

#[test]
fn a_plant_starts_at_rest_or_at_zero() {
    let mut config = settings();
    let at_rest = Plant::new(&config).unwrap();
    // The pitch q2 - q4 + q6 of the shipped start pose is 90 deg: both are the same equilibrium.
    assert!(at_rest.position().unactuated().amax() < 1e-9);
    config.plant.start.q[5] += 0.2;
    let tilted = Plant::new(&config).unwrap();
    assert!((tilted.position()[8] - 0.2).abs() < 1e-9, "q9 = pitch - 90 deg");
    config.plant.start.pendulum = PendulumStart::Zero;
    assert_eq!(Plant::new(&config).unwrap().position()[8], 0.0);
}

#[test]
fn a_pose_whose_pendulum_rests_beyond_its_limit_is_refused() {
    let mut config = settings();
    config.plant.start.q.fill(0.0);
    let refused = Plant::new(&config).unwrap_err();
    assert!(
        matches!(refused, StateError::Position(StartError::RestOutsideLimits { ref joint, .. }) if joint == "pendulum_2"),
        "{refused}"
    );
    config.plant.start.q[2] = f64::NAN;
    assert!(matches!(
        Plant::new(&config).unwrap_err(),
        StateError::Position(StartError::NotFinite { joint, .. }) if joint == "joint_3"
    ));
}

fn run(options: &[&str]) -> Output {
    let domain = TempDomain::new("start").unwrap();
    Process::new(env!("CARGO_BIN_EXE_upswing-plant"))
        .args(options)
        .args(if options.contains(&"--domain") { vec![] } else { vec!["--domain", domain.name()] })
        .output()
        .unwrap()
}

#[test]
fn the_process_says_what_is_wrong_and_exits_with_2() {
    for (options, expected) in [
        (
            &["--start", "0,0,0,-130,0,0,0"][..],
            "position of joint `joint_4`: expected -120.000 to 120.000 deg, got -130.000 deg",
        ),
        (&["--start", "NaN,0,0,-90,0,0,0"], "position of joint `joint_1`: expected a number, got NaN"),
        (&["--start", "-10,0,0,-90,0,0,inf"], "position of joint `joint_7`: expected a number, got inf"),
        (
            &["--start", "0,-15,0"],
            "--start: expected 7 positions of the actuated joints, separated by commas (joint_1 in deg,joint_2 in deg,",
        ),
        (&["--start=0,0,0,0,0,0,0,0"], "joint_7 in deg); got 8"),
        (
            &["--start", "0,0,0,0,0,0,0"],
            "rest position of joint `pendulum_2` is -90.0 deg, outside its range of -45.0 to 45.0 deg",
        ),
        (&["--domain", "No Domain"], "domain name `No Domain`"),
        (&["--system", "/does/not/exist"], "/does/not/exist"),
    ] {
        let output = run(options);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{options:?}: {message}");
        assert_eq!(message.lines().count(), 1, "{options:?}: {message}");
        assert!(message.starts_with("error: ") && message.contains(expected), "{options:?}: {message}");
    }
}

#[test]
fn options_that_are_none_exit_with_2() {
    for options in
        [&["--start", "0,x,0,0,0,0,0"][..], &["--clock", "sundial"], &["--start-pendulum", "up"], &["--warp"]]
    {
        assert_eq!(run(options).status.code(), Some(2), "{options:?}");
    }
}
