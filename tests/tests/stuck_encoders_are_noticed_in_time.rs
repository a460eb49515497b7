//! An encoder that is stuck, or all of them, ends in Fault before a joint of the arm moves faster than its 100 % speed: in each
//! mode that moves, and in Hold as soon as anything is to be noticed.

use upswing_config::{Config, Fault, FaultKind};
use upswing_ipc::Mode;
use upswing_model::{NQ, NU};
use upswing_tests::matrix::Case;
use upswingd::trip::TripCause;

/// Cycles of 50 ms, and the longest run.
const SOON: u64 = 400;
const LONGEST: u64 = 24_000;

/// Breaks it; the cycles until the mode was given up, if it was.
fn noticed(before: &Case, fault: Fault) -> Option<u64> {
    let limits = Config::embedded().expect("settings").robot.limits;
    let mut case = before.clone();
    case.break_now(fault);
    for cycle in 0..LONGEST {
        case.run(1);
        if case.mode().0 == Mode::Fault {
            let trip = case.system.controller.trip().expect("a cause");
            assert_eq!(trip.cause, TripCause::StuckEncoder, "{fault:?}: {trip}");
            return Some(cycle);
        }
        for i in 0..NU {
            let speed = case.system.plant.velocity()[i];
            assert!(speed.abs() <= limits.qd_max[i], "{fault:?}, cycle {cycle}: joint {} at {speed}", i + 1);
        }
    }
    None
}

#[test]
fn in_track_balance_and_stop() {
    for mode in [Mode::Track, Mode::Balance, Mode::Stop] {
        let before = Case::idle(None).in_mode(mode);
        for joint in 0..NQ {
            let cycles = noticed(&before, Fault { joint, ..Fault::new(FaultKind::EncoderStuck, 0, 0) });
            assert!(cycles.is_some(), "joint {} in {mode}", joint + 1);
        }
        let all = noticed(&before, Fault::new(FaultKind::FreezeMeasurement, 0, 0)).expect("noticed");
        // In Balance the arm hardly moves at first.
        assert!(all <= if mode == Mode::Balance { 2 * SOON } else { SOON }, "{all} cycles in {mode}");
    }
}

#[test]
fn of_each_joint_in_hold() {
    let before = Case::idle(None).in_mode(Mode::Hold);
    for joint in 0..NQ {
        noticed(&before, Fault { joint, ..Fault::new(FaultKind::EncoderStuck, 0, 0) });
    }
}
