//! Stuck encoders lead to Fault before a joint of the arm exceeds the daemon's speed limit, from several poses, with an
//! ideal plant and with one that has noise, friction and delay. The simulated plant provides the true angles.

use upswing_config::{Config, Fault, FaultKind};
use upswing_ipc::Mode;
use upswing_rig::montecarlo::RandomStarts;
use upswing_tests::matrix::FaultCase;
use upswingd::trip::TripCause;

/// Cycles of 50 ms, and the longest run.
const SOON: u64 = 400;
const LONGEST: u64 = 24_000;
/// Random starts besides that of the settings, and their seed.
const POSES: u64 = 2;
const SEED: u64 = 77;

/// How it ended.
struct Ending {
    /// Cycles until the Fault, if there was one, and its cause.
    noticed: Option<(u64, TripCause)>,
    /// Largest difference of a true angle of the arm from the one that is shown, rad.
    hidden: f64,
    /// Largest speed of the arm, share of the 100 % limits.
    speed: f64,
}

fn broken(config: &Config, before: &FaultCase, fault: Fault) -> Ending {
    let mut case = before.clone();
    case.break_now(fault);
    let mut ending = Ending { noticed: None, hidden: 0.0, speed: 0.0 };
    for cycle in 0..LONGEST {
        case.run(1);
        let plant = &case.system.plant;
        let (shown, _) = plant.measure().vectors(plant.order()).expect("the joints of the robot");
        ending.hidden = ending.hidden.max((plant.position() - shown).actuated().amax());
        let speed = plant.velocity().component_div(&config.robot.limits.qd_max);
        ending.speed = ending.speed.max(speed.actuated().amax());
        if case.mode().0 == Mode::Fault {
            ending.noticed = case.system.controller.trip().map(|trip| (cycle, trip.cause));
            break;
        }
    }
    ending
}

/// From each pose, with each plant.
fn each(mode: Mode, check: impl Fn(&Config, &FaultCase, &str)) {
    let config = Config::embedded().expect("settings");
    let starts = RandomStarts { config: &config, seed: SEED };
    for scenario in [None, Some("everyday")] {
        for start in 0..=POSES {
            let pose = (start > 0).then(|| starts.start(start).expect("a start").q_a());
            let before = FaultCase::idle_at(scenario, pose).in_mode(mode);
            check(&config, &before, &format!("{mode}, start {start}, {}", scenario.unwrap_or("ideal")));
        }
    }
}

/// Measurements that freeze as a whole.
fn all(mode: Mode) {
    each(mode, |config, before, what| {
        let end = broken(config, before, Fault::new(FaultKind::FreezeMeasurement, 0, 0));
        println!("{what}: {:?}, {:.5} rad hidden, speed {:.2}", end.noticed, end.hidden, end.speed);
        assert!(end.speed <= 1.0, "{what}: {:.2} of the speed limit", end.speed);
        // Where nothing is commanded, nothing tells, and nothing moves.
        assert!(end.hidden < 5e-3, "{what}: {:.4} rad are hidden", end.hidden);
        match end.noticed {
            Some((cycles, cause)) => {
                let causes = [TripCause::FrozenMeasurement, TripCause::StuckEncoder];
                assert!(causes.contains(&cause), "{what}: {cause:?}");
                assert!(mode == Mode::Hold || cycles <= SOON, "{what}: {cycles} cycles");
            }
            None => assert_eq!(mode, Mode::Hold, "{what}: not noticed"),
        }
    });
}

/// One encoder after the other. `hidden`: the largest hidden motion, rad.
fn single(mode: Mode, hidden: f64) {
    each(mode, |config, before, what| {
        let fastest = config.daemon.limits.velocity_fraction.trip;
        for joint in 0..config.model.sizes().joints() {
            let what = format!("{what}, joint {}", joint + 1);
            let end = broken(config, before, Fault { joint, ..Fault::new(FaultKind::EncoderStuck, 0, 0) });
            println!("{what}: {:?}, {:.4} rad hidden, speed {:.2}", end.noticed, end.hidden, end.speed);
            assert!(end.speed < fastest, "{what}: {:.2} of the speed limit", end.speed);
            assert!(end.hidden < hidden, "{what}: {:.4} rad are hidden", end.hidden);
            match end.noticed {
                Some((_, cause)) => assert_eq!(cause, TripCause::StuckEncoder, "{what}"),
                // Where the arm holds a pose, a joint may move for seconds by less than what is hidden.
                None => assert_eq!(mode, Mode::Hold, "{what}: not noticed"),
            }
        }
    });
}

#[test]
fn all_in_hold() {
    all(Mode::Hold);
}

#[test]
fn all_in_track() {
    all(Mode::Track);
}

#[test]
fn all_in_balance() {
    all(Mode::Balance);
}

#[test]
fn all_in_stop() {
    all(Mode::Stop);
}

#[test]
fn one_in_hold() {
    single(Mode::Hold, 0.15);
}

#[test]
fn one_in_track() {
    single(Mode::Track, 0.1);
}

#[test]
fn one_in_balance() {
    single(Mode::Balance, 0.1);
}

#[test]
fn one_in_stop() {
    // Joint 7 is light and has the most friction for its torque; how far it slides depends on its speed in the plan.
    single(Mode::Stop, 0.35);
}
