//! Every fault of the plant in each mode in which the arm moves or could: what the daemon makes of it. Over all of it torques
//! stay within their limits, and when the daemon gives up in Fault the brakes hold.

mod common;

use Outcome::{Fault as Faults, GoesOn, Safe};
use common::ClosedLoop;
use upswing_config::{Fault, FaultKind};
use upswing_ipc::Mode;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// The same mode, brakes open.
    GoesOn,
    /// Mode Fault, closed brakes.
    Fault,
    /// It may go on or give up: what is not noticed at once, or by chance.
    Safe,
}

/// How long the fault lasts, cycles.
const SHORT: u64 = 8;
/// Longer than the watchdog of the drives.
const LONG: u64 = 40;
const FOREVER: u64 = 0;

/// Kind, cycles, joint (counted from 1), amount; outcomes half a second later in Hold, Track and Balance.
#[rustfmt::skip]
const TABLE: &[(FaultKind, u64, usize, f64, [Outcome; 3])] = &[
    (FaultKind::DropMeasurement,      SHORT,   1, 0.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::DropMeasurement,      LONG,    1, 0.0,   [Safe,   Safe,   Safe]),
    (FaultKind::DropMeasurement,      FOREVER, 1, 0.0,   [Safe,   Safe,   Safe]),
    (FaultKind::DelayMeasurement,     FOREVER, 1, 1.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::DelayMeasurement,     FOREVER, 1, 8.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::DuplicateMeasurement, FOREVER, 1, 0.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::ReorderMeasurement,   FOREVER, 1, 0.0,   [Faults, Faults, Faults]),
    (FaultKind::FreezeMeasurement,    SHORT,   1, 0.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::FreezeMeasurement,    FOREVER, 1, 0.0,   [Safe,   Safe,   Safe]),
    (FaultKind::StaleTime,            FOREVER, 1, 0.0,   [Safe,   Safe,   Safe]),
    (FaultKind::EncoderStuck,         SHORT,   4, 0.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::EncoderStuck,         FOREVER, 4, 0.0,   [Safe,   Faults, Safe]),
    (FaultKind::EncoderStuck,         FOREVER, 8, 0.0,   [GoesOn, Faults, Faults]),
    (FaultKind::EncoderJump,          FOREVER, 4, 0.001, [GoesOn, GoesOn, GoesOn]),
    (FaultKind::EncoderJump,          FOREVER, 4, 0.1,   [Faults, Faults, Faults]),
    (FaultKind::EncoderJump,          FOREVER, 8, -0.1,  [Faults, Faults, Faults]),
    (FaultKind::EncoderNan,           1,       4, 0.0,   [Faults, Faults, Faults]),
    (FaultKind::EncoderNan,           1,       9, 0.0,   [Faults, Faults, Faults]),
    (FaultKind::LoseCommand,          SHORT,   1, 0.0,   [GoesOn, GoesOn, GoesOn]),
    (FaultKind::LoseCommand,          LONG,    1, 0.0,   [Safe,   Safe,   Safe]),
    (FaultKind::LoseCommand,          FOREVER, 1, 0.0,   [Safe,   Safe,   Safe]),
];

const HALF_A_SECOND: u64 = 4_000;

/// The system in each mode, about to break.
fn modes() -> [ClosedLoop; 3] {
    let holding = ClosedLoop::holding(None);
    let mut tracking = holding.clone();
    assert!(tracking.start());
    let mut balancing = tracking.clone();
    tracking.run(tracking.plan_cycles / 2);
    balancing.run(balancing.plan_cycles + HALF_A_SECOND);
    [holding, tracking, balancing]
}

#[test]
fn in_hold_track_and_balance() {
    let before = modes();
    for &(kind, cycles, joint, amount, outcomes) in TABLE {
        for (system, expected) in before.iter().zip(outcomes) {
            let mode = system.controller.mode();
            let run = || {
                let mut system = system.clone();
                system.break_now(Fault { kind, from: 0, cycles, joint: joint - 1, amount });
                system.run(HALF_A_SECOND);
                (system.outcome(), *system.plant.position())
            };
            let (outcome, position) = run();
            let text =
                format!("{kind:?} for {cycles} cycles, joint {joint}, {amount}, in {mode}: {outcome:?}");
            assert_eq!(run(), (outcome, position), "{text}: the same again");
            match expected {
                GoesOn => assert_eq!(outcome, (mode, false), "{text}"),
                Faults => assert_eq!(outcome, (Mode::Fault, true), "{text}"),
                Safe => assert!(outcome.0 != Mode::Fault || outcome.1, "{text}"),
            }
        }
    }
}

#[test]
fn the_table_has_every_kind() {
    for kind in FaultKind::all() {
        assert!(TABLE.iter().any(|row| row.0 == *kind), "{kind:?} is missing");
    }
}
