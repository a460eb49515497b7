//! Each shipped scenario ends as its purpose demands: most balanced, some with the daemon giving up safely. Torques stay
//! within their limits in all of them.

use Outcome::{Balanced, GivesUp, Safe};
use upswing::report::tilt;
use upswing_config::Config;
use upswing_ipc::Mode;
use upswing_tests::matrix::Case;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// Three seconds in Balance, and the rod within 2 deg of upright at the end.
    Balanced,
    /// Mode Fault, closed brakes.
    GivesUp,
    /// Either, or a stop: harder than what has to succeed.
    Safe,
}

const TABLE: [(&str, Outcome); 16] = [
    ("arm-friction", Balanced),
    ("coarse-encoders", Balanced),
    ("dead-encoder", GivesUp),
    ("everyday", Balanced),
    ("heavy-arm", Balanced),
    ("joint-stops", Balanced),
    ("late-brakes", Balanced),
    ("long-rod", Balanced),
    ("lost-packets", Balanced),
    ("payload", Balanced),
    ("push", Balanced),
    ("rotor-inertia", Safe),
    ("second-arm", Balanced),
    ("slow-drives", Balanced),
    ("torque-offset", Safe),
    ("worn-bearings", Balanced),
];

const THREE_SECONDS: u64 = 24_000;

#[test]
fn all_of_them() {
    let names: Vec<_> = TABLE.iter().map(|row| row.0).collect();
    assert_eq!(names, Config::scenario_names().collect::<Vec<_>>(), "the table has every scenario");
    let model = Config::embedded().expect("embedded settings").model;
    for (name, expected) in TABLE {
        let mut case = Case::idle(Some(name)).in_mode(Mode::Hold);
        let started = case.start();
        case.run(case.plan_cycles + THREE_SECONDS);
        let (mode, braked) = case.mode();
        let deg = tilt(&model, case.system.plant.position()).to_degrees();
        let text = format!("{name}: {mode}, brakes closed {braked}, rod at {deg:.2} deg");
        println!("{text}");
        match expected {
            Balanced => assert!(started && mode == Mode::Balance && deg < 2.0, "{text}"),
            GivesUp => assert_eq!((started, mode, braked), (true, Mode::Fault, true), "{text}"),
            Safe => assert!(mode != Mode::Fault || braked, "{text}"),
        }
    }
}
