//! A push on the rod in Balance is tolerated or leads to Stop and Hold. In no direction, and up to a strength that throws
//! the rod over, does it lead to Fault or make a joint of the arm exceed the daemon's speed limit.

use std::f64::consts::TAU;
use upswing_config::{Config, Push};
use upswing_ipc::Mode;
use upswing_tests::matrix::FaultCase;
use upswingd::trip::TripCause;

/// Strengths of the pushes on the tip of the rod, N s: the last moves it at 2.4 m/s.
const STRENGTHS: [f64; 5] = [0.02, 0.03, 0.05, 0.1, 0.2];
const DIRECTIONS: u32 = 8;
/// How long a push lasts, and how long what follows is watched, cycles.
const PUSH: u64 = 80;
const WATCHED: u64 = 12_000;

#[test]
fn from_any_direction() {
    let config = Config::embedded().expect("settings");
    let (limits, fastest) = (&config.robot.limits, config.daemon.limits.velocity_fraction.trip);
    let before = FaultCase::idle(None).in_mode(Mode::Balance);
    for strength in STRENGTHS {
        let mut stops = 0;
        for direction in 0..DIRECTIONS {
            let (sin, cos) = (f64::from(direction) * TAU / f64::from(DIRECTIONS)).sin_cos();
            let impulse = [strength * cos, strength * sin, 0.0];
            let mut case = before.clone();
            let push = Push { from: case.system.plant.seq(), cycles: PUSH, impulse };
            case.system.plant.push(&push).expect("a push");
            for cycle in 0..WATCHED {
                case.run(1);
                let (q, qd) = (case.system.plant.position(), case.system.plant.velocity());
                for (i, share) in qd.abs().component_div(&limits.qd_max).actuated().iter().enumerate() {
                    assert!(
                        *share < fastest,
                        "{impulse:?} N s, cycle {cycle}: joint {} at {share:.2}",
                        i + 1
                    );
                }
                assert!(
                    q.unactuated()[1].abs().to_degrees() < 60.0,
                    "{impulse:?} N s, cycle {cycle}: through its stop"
                );
            }
            let (mode, trip) = (case.mode().0, case.system.controller.trip());
            match trip.map(|trip| trip.cause) {
                None => assert_eq!(mode, Mode::Balance, "{impulse:?} N s"),
                Some(TripCause::BalanceLost | TripCause::BalanceSpeed) => {
                    assert_eq!(mode, Mode::Hold, "{impulse:?} N s");
                    stops += 1;
                }
                Some(_) => panic!("{impulse:?} N s: {mode}, {trip:?}"),
            }
        }
        println!("{strength} N s: {stops} of {DIRECTIONS} lost");
        assert!(strength > 0.02 || stops == 0, "{stops} of the weakest pushes lost the rod");
        assert!(strength < 0.2 || stops == DIRECTIONS, "{stops} of the strongest pushes lost the rod");
    }
}
