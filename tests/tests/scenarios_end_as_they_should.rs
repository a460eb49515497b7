//! Each shipped scenario has its expected outcome: most end balanced, some in Fault with a known cause. Torques stay within
//! their limits in all of them.

use upswing_config::Config;
use upswing_ipc::Mode;
use upswing_record::evaluation::tilt;
use upswing_tests::matrix::FaultCase;

/// Four seconds in Balance, and the rod within 2 deg of upright throughout the last one.
const BALANCED: &str = "balanced";

/// The outcome of each scenario, in the words of `docs/faults.md`.
const TABLE: [(&str, &str); 16] = [
    ("arm-friction", BALANCED),
    ("coarse-encoders", BALANCED),
    ("dead-encoder", "Fault: NotFinite"),
    ("everyday", BALANCED),
    ("heavy-arm", BALANCED),
    ("joint-stops", BALANCED),
    ("late-brakes", BALANCED),
    ("long-rod", BALANCED),
    ("lost-packets", BALANCED),
    ("payload", BALANCED),
    ("push", BALANCED),
    ("rotor-inertia", "Fault: Collision"),
    ("second-arm", BALANCED),
    ("slow-drives", BALANCED),
    ("torque-offset", BALANCED),
    ("worn-bearings", BALANCED),
];

const SECOND: u64 = 8_000;

#[test]
fn all_of_them() {
    let names: Vec<_> = TABLE.iter().map(|row| row.0).collect();
    let config = Config::embedded().expect("embedded settings");
    let Config { model, .. } = &config;
    assert_eq!(names, config.system().scenarios(), "the table has every scenario");
    let mut wrong = Vec::new();
    for (name, expected) in TABLE {
        let mut case = FaultCase::idle(Some(name)).in_mode(Mode::Hold);
        let started = case.start();
        case.run(case.plan_cycles + 3 * SECOND);
        let mut largest: f64 = 0.0;
        for _ in 0..SECOND {
            case.run(1);
            largest = largest.max(tilt(model, case.system.plant.position()).to_degrees());
        }
        let balanced = case.mode() == (Mode::Balance, false) && largest < 2.0;
        let outcome = if started && balanced { BALANCED.to_owned() } else { case.outcome() };
        println!("{name}: {outcome}, rod within {largest:.2} deg in the last second");
        if outcome != expected {
            wrong.push(format!("{name}: {outcome}, expected {expected}; rod within {largest:.2} deg"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
