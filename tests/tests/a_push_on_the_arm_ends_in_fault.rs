//! An external torque on a joint of the arm, as in a push or a collision, leads to Fault in every mode with open brakes.
//! Light joints exceed their speed limit at once; in directions of large inertia the collision limit trips.

use upswing_config::{Fault, FaultKind};
use upswing_ipc::Mode;
use upswing_tests::matrix::{FaultCase, WATCHED};
use upswingd::trip::TripCause;

/// Cycles of 200 ms.
const SOON: u64 = 1_600;

/// What a constant torque on a joint of the arm, a share of its 100 % limit, leads to.
fn pushed(before: &FaultCase, joint: usize, share: f64, cycles: u64) -> (Mode, Option<TripCause>, u64) {
    let mut case = before.clone();
    let amount = share * case.config.robot.limits.tau_max[joint];
    case.break_now(Fault { joint, amount, ..Fault::new(FaultKind::ArmTorque, 0, cycles) });
    for cycle in 0..WATCHED {
        case.run(1);
        // A rod that the push throws over ends Balance in a stop; somebody who goes on pushing ends that, too.
        if case.mode().0 != before.mode().0 && case.mode().0 != Mode::Stop {
            return (case.mode().0, case.system.controller.trip().map(|trip| trip.cause), cycle);
        }
    }
    (case.mode().0, case.system.controller.trip().map(|trip| trip.cause), WATCHED)
}

#[test]
fn a_strong_push_in_any_mode() {
    for mode in [Mode::Hold, Mode::Track, Mode::Balance] {
        let before = FaultCase::idle(None).in_mode(mode);
        for joint in 0..before.config.model.sizes().actuated() {
            for share in [0.15, -0.15] {
                let (then, cause, cycles) = pushed(&before, joint, share, 0);
                println!("{mode}, joint {}, {share}: {then}, {cause:?} after {cycles}", joint + 1);
                assert_eq!(then, Mode::Fault, "{mode}, joint {}, {share}: {cause:?}", joint + 1);
                assert!(cycles <= SOON, "{mode}, joint {}, {share}: {cycles} cycles", joint + 1);
            }
        }
    }
}

#[test]
fn against_much_inertia_it_is_a_collision() {
    for mode in [Mode::Hold, Mode::Balance] {
        let before = FaultCase::idle(None).in_mode(mode);
        for share in [0.1, -0.1] {
            assert_eq!(pushed(&before, 1, share, 0).1, Some(TripCause::Collision), "{mode}, {share}");
        }
    }
}

#[test]
fn a_weak_or_short_push_is_borne() {
    let before = FaultCase::idle(None).in_mode(Mode::Hold);
    // A person leans on the arm; and a blow of 10 ms.
    for (joint, share, cycles) in [(1, 0.03, 0), (3, 0.03, 0), (1, 0.1, 80), (3, 0.1, 80)] {
        let (mode, cause, _) = pushed(&before, joint, share, cycles);
        assert_eq!((mode, cause), (Mode::Hold, None), "joint {}, {share}", joint + 1);
    }
}
