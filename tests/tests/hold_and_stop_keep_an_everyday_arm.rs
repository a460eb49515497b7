//! Hold and Stop on a realistic plant (scenario `everyday`): friction, noisy encoders, drives with delay and lag, small
//! errors of masses and lengths.

use upswing_config::{Config, Push};
use upswing_ipc::{Mode, Telemetry};
use upswing_model::ActuatedVector;
use upswing_tests::matrix::FaultCase;
use upswingd::step::StepRequest;

const SECOND: u64 = 8_000;
/// Cycles between two stops: 100 ms.
const STEP: usize = 800;
/// Longest stop, cycles: 0.5 s. The fastest joint of a swing decelerates for 0.25 s, and has to rest for 0.05 s.
const LONGEST: u64 = 4_000;
/// In so many cycles at most the torque gets from that of the plan to that of the stop: 2 ms.
const BEGINNING: u64 = 16;

fn q(case: &FaultCase) -> ActuatedVector {
    case.system.plant.position().actuated()
}

fn qd(case: &FaultCase) -> ActuatedVector {
    case.system.plant.velocity().actuated()
}

fn everyday(mode: Mode) -> FaultCase {
    FaultCase::idle(Some("everyday")).in_mode(mode)
}

#[test]
fn hold_keeps_the_pose() {
    let mut case = everyday(Mode::Hold);
    let pose = q(&case);
    for _ in 0..4 * SECOND {
        case.run(1);
        assert_eq!(case.mode(), (Mode::Hold, false), "{:?}", case.system.controller.trip());
        let (off, speed) = ((q(&case) - pose).amax(), qd(&case).amax());
        // The noise of the encoders, 1e-5 rad, comes back through the feedback.
        assert!(off < 2e-4 && speed < 2e-3, "{off} rad off, {speed} rad/s");
    }
}

#[test]
fn hold_returns_after_a_push_of_the_rod() {
    let mut case = everyday(Mode::Hold);
    let pose = q(&case);
    let push = Push { from: case.system.plant.seq(), cycles: 80, impulse: [0.2, 0.1, 0.0] };
    case.system.plant.push(&push).expect("a push");
    let mut farthest = 0.0_f64;
    for _ in 0..7 * SECOND {
        case.run(1);
        assert_eq!(case.mode(), (Mode::Hold, false), "{:?}", case.system.controller.trip());
        farthest = farthest.max((q(&case) - pose).amax());
    }
    assert!((5e-3..0.03).contains(&farthest), "{farthest} rad");
    // Friction holds what the swinging rod still moves.
    let off = (q(&case) - pose).amax();
    assert!(off < 2e-3, "{off} rad off");
}

/// Stops in cycle `at` of a swing-up, and holds for a second.
fn stop(mut case: FaultCase, at: u64) {
    let limits = Config::embedded().expect("settings").robot.limits;
    let fastest = qd(&case).abs();
    case.records = Some(Vec::new());
    case.request(StepRequest::Stop);
    let mut cycles = 1;
    while case.mode().0 != Mode::Hold {
        assert_eq!(case.mode(), (Mode::Stop, false), "stop at {at}: {:?}", case.system.controller.trip());
        assert!(cycles < LONGEST, "stop at {at}: still moves: {:?}", qd(&case));
        case.run(1);
        cycles += 1;
        for (i, (q, qd)) in q(&case).iter().zip(qd(&case).iter()).enumerate() {
            assert!((limits.q_min[i]..=limits.q_max[i]).contains(q), "stop at {at}: joint {} at {q}", i + 1);
            // The torque of the plan fades in two milliseconds, and acts a little later.
            assert!(qd.abs() <= fastest[i] + 0.1, "stop at {at}: joint {} at {qd} rad/s", i + 1);
        }
        let telemetry = case.records.as_ref().and_then(|records| records.last()).expect("a cycle").telemetry;
        let limited = telemetry.flags & Telemetry::LIMITED != 0;
        assert!(cycles < BEGINNING || !limited, "stop at {at}: {:?}", telemetry.of_actuated(&telemetry.tau));
    }
    let pose = q(&case);
    for _ in 0..SECOND {
        case.run(1);
        assert_eq!(case.mode(), (Mode::Hold, false), "stop at {at}: {:?}", case.system.controller.trip());
        // The estimate of disturbances learns what friction makes of an arm that moves no more.
        let off = (q(&case) - pose).amax();
        assert!(off < 0.02, "stop at {at}: {off} rad away from where it came to rest");
    }
}

#[test]
fn a_stop_from_any_point_of_a_swing_up_and_from_balance_brings_the_arm_to_rest() {
    let mut case = everyday(Mode::Hold);
    assert!(case.start(), "the plan is accepted");
    for at in (0..case.plan_cycles + SECOND).step_by(STEP) {
        assert!(matches!(case.mode(), (Mode::Track | Mode::Balance, false)));
        stop(case.clone(), at);
        case.run(STEP as u64);
    }
    assert_eq!(case.mode().0, Mode::Balance);
}
