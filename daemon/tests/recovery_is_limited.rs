//! After a lost balance: no plan before the pendulum is at rest, at most the set number of attempts, and requests of the
//! operator end the recovery.

use proptest::prelude::*;
use std::sync::LazyLock;
use std::time::Duration;
use upswing_config::{Config, RecoverySettings};
use upswing_ipc::operator::PublishedPlan;
use upswing_ipc::{CycleVectors, Mode, RecordedStep, Telemetry};
use upswing_model::{ActuatedVector, Order, State};
use upswingd::recovery::{Recovery, RecoveryAction};
use upswingd::step::CycleRecord;
use upswingd::trip::{Trip, TripCause};

const SECOND: u64 = 1_000_000_000;

fn settings(attempts: u32) -> RecoverySettings {
    let (rest, patience) = (Duration::from_secs(2), Duration::from_secs(60));
    RecoverySettings { attempts, rest_speed: 0.05, rest, patience }
}

fn order() -> Order {
    static ORDER: LazyLock<Order> = LazyLock::new(|| *Config::embedded().unwrap().model.order());
    *ORDER
}

fn recovery(attempts: u32) -> Recovery {
    Recovery::new(settings(attempts), order())
}

fn record(mode: Mode, t_ns: u64, speed: f64, cause: Option<TripCause>) -> CycleRecord {
    let (x, none) = (State::zeros(order().sizes()), ActuatedVector::zeros(order().sizes()));
    let vectors = CycleVectors { x, x_d: x, u_d: none, u: none, tau: none, tau_measured: none };
    let mut telemetry = Telemetry { mode: mode.code(), t_ns, ..Telemetry::new(&order(), &vectors) };
    telemetry.qd[8] = speed;
    CycleRecord {
        telemetry,
        step: RecordedStep::default(),
        dropped: None,
        trip: cause.map(Trip::plain),
        unready: None,
        overruns: 0,
    }
}

/// Balances at 0 s and loses the rod at 1 s.
fn fallen(attempts: u32) -> Recovery {
    let mut recovery = recovery(attempts);
    assert_eq!(recovery.note(&record(Mode::Balance, 0, 0.0, None), 1), None);
    assert_eq!(recovery.note(&record(Mode::Stop, SECOND, 3.0, Some(TripCause::BalanceLost)), 1), None);
    recovery
}

fn hold(recovery: &mut Recovery, seconds: u64, speed: f64, loaded: u64) -> Option<RecoveryAction> {
    recovery.note(&record(Mode::Hold, seconds * SECOND, speed, Some(TripCause::BalanceLost)), loaded)
}

#[test]
fn it_waits_plans_and_starts() {
    let mut recovery = fallen(1);
    assert!(recovery.is_active());
    for (seconds, speed) in [(2, 1.0), (3, 0.04), (4, 0.06), (5, 0.04), (6, -0.04)] {
        assert_eq!(hold(&mut recovery, seconds, speed, 1), None, "{seconds} s");
    }
    assert_eq!(hold(&mut recovery, 7, 0.0, 1), Some(RecoveryAction::AskPlanner), "two seconds at rest");
    assert_eq!(hold(&mut recovery, 8, 0.0, 1), None, "asked once");
    recovery.planned(Some(PublishedPlan { id: 5, activation_ns: 10 * SECOND }));
    assert_eq!(hold(&mut recovery, 8, 0.0, 1), None, "the old plan is not started");
    assert_eq!(hold(&mut recovery, 9, 0.0, 5), None, "the moment of its start is still to come");
    assert_eq!(hold(&mut recovery, 10, 0.0, 5), Some(RecoveryAction::Start(5)));
    assert_eq!(hold(&mut recovery, 11, 0.0, 5), None, "started once");
    // The only attempt is used up.
    recovery.note(&record(Mode::Track, 12 * SECOND, 0.0, None), 5);
    recovery.note(&record(Mode::Balance, 14 * SECOND, 0.0, None), 5);
    recovery.note(&record(Mode::Stop, 15 * SECOND, 0.0, Some(TripCause::BalanceLost)), 5);
    assert!(!recovery.is_active());
}

#[test]
fn a_rod_that_the_arm_cannot_follow_is_a_loss() {
    let mut recovery = recovery(1);
    recovery.note(&record(Mode::Balance, 0, 0.0, None), 1);
    recovery.note(&record(Mode::Stop, SECOND, 3.0, Some(TripCause::BalanceSpeed)), 1);
    assert!(recovery.is_active());
}

#[test]
fn it_gives_up() {
    assert!(!fallen(0).is_active(), "not set");
    let mut restless = fallen(1);
    hold(&mut restless, 62, 1.0, 1);
    assert!(!restless.is_active(), "the pendulum does not come to rest");
    for answered in [false, true] {
        let mut slow = fallen(1);
        (2..=7).for_each(|seconds| {
            hold(&mut slow, seconds, 0.0, 1);
        });
        assert!(slow.is_active());
        if answered {
            slow.planned(Some(PublishedPlan { id: 5, activation_ns: 0 }));
        }
        hold(&mut slow, 70, 0.0, 1);
        assert!(!slow.is_active(), "no plan in time");
    }
    let mut refused = fallen(1);
    (2..=7).for_each(|seconds| {
        hold(&mut refused, seconds, 0.0, 1);
    });
    refused.planned(None);
    assert!(!refused.is_active(), "the planner refused");
    let mut operator = fallen(1);
    operator.yield_to_operator();
    assert_eq!((operator.is_active(), hold(&mut operator, 30, 0.0, 1)), (false, None));
    let mut fault = fallen(1);
    fault.note(&record(Mode::Fault, 2 * SECOND, 0.0, Some(TripCause::DriveFault)), 1);
    assert!(!fault.is_active());
}

/// The pendulum rests in Hold, with plan 1 loaded.
fn rest(recovery: &mut Recovery, seconds: std::ops::RangeInclusive<u64>) {
    for seconds in seconds {
        hold(recovery, seconds, 0.0, 1);
    }
}

/// In the middle of the second of two attempts' swing-ups, or before the first.
fn swinging_up(again: bool) -> (Recovery, u64) {
    if !again {
        return (recovery(2), SECOND);
    }
    let mut recovery = fallen(2);
    assert_eq!(
        [2, 3, 4].map(|s| hold(&mut recovery, s, 0.0, 1)),
        [None, None, Some(RecoveryAction::AskPlanner)]
    );
    recovery.planned(Some(PublishedPlan { id: 5, activation_ns: 0 }));
    assert_eq!(hold(&mut recovery, 5, 0.0, 5), Some(RecoveryAction::Start(5)));
    (recovery, 6 * SECOND)
}

#[test]
fn what_is_recovered_from() {
    use TripCause::{BalanceLost, BalanceSpeed, PendulumRange, TrackingError};
    for cause in TripCause::ALL.into_iter().map(Some).chain([None]) {
        for again in [false, true] {
            for before in Mode::ALL.iter().copied() {
                let (mut recovery, now) = swinging_up(again);
                recovery.note(&record(before, now, 3.0, None), 5);
                recovery.note(&record(Mode::Stop, now + 1, 3.0, cause), 5);
                let expected = match (cause, before) {
                    (Some(BalanceLost | BalanceSpeed), Mode::Track | Mode::Balance) => true,
                    (Some(PendulumRange | TrackingError), Mode::Balance) => true,
                    // What the operator started and did not become a balance is the operator's.
                    (Some(PendulumRange | TrackingError), Mode::Track) => again,
                    _ => false,
                };
                assert_eq!(recovery.is_active(), expected, "{cause:?} in {before}, again: {again}");
            }
        }
    }
}

#[test]
fn the_pendulum_rests_when_both_of_its_joints_do_in_hold() {
    for (joint, speed, rests) in [
        (7, 0.05, true),
        (7, 0.051, false),
        (7, -0.051, false),
        (8, 0.051, false),
        (8, -0.051, false),
        (8, f64::NAN, false),
        // The arm that is held flickers.
        (6, 1.0, true),
    ] {
        let mut recovery = fallen(1);
        let mut at = |mode, seconds| {
            let mut record = record(mode, seconds * SECOND, 0.0, Some(TripCause::BalanceLost));
            record.telemetry.qd[joint] = speed;
            recovery.note(&record, 1)
        };
        // While the arm still stops, it moves the pendulum.
        assert_eq!([at(Mode::Stop, 2), at(Mode::Stop, 6), at(Mode::Hold, 7), at(Mode::Hold, 8)], [None; 4]);
        let expected = rests.then_some(RecoveryAction::AskPlanner);
        assert_eq!(at(Mode::Hold, 9), expected, "joint {} at {speed} rad/s", joint + 1);
    }
}

#[test]
fn another_mode_ends_it_at_every_stage() {
    for mode in [Some(Mode::Idle), Some(Mode::Track), Some(Mode::Balance), Some(Mode::Fault), None] {
        for stage in 0..3 {
            let mut recovery = fallen(1);
            if stage > 0 {
                rest(&mut recovery, 2..=7);
            }
            if stage > 1 {
                recovery.planned(Some(PublishedPlan { id: 5, activation_ns: 9 * SECOND }));
            }
            assert!(recovery.is_active());
            let mut other = record(Mode::Hold, 8 * SECOND, 0.0, None);
            // One that does not exist is no reason to go on.
            other.telemetry.mode = mode.map_or(99, Mode::code);
            assert_eq!((recovery.note(&other, 5), recovery.is_active()), (None, false), "{mode:?}, {stage}");
        }
    }
}

#[test]
fn patience_ends_after_its_time_and_not_before() {
    let mut restless = fallen(1);
    hold(&mut restless, 61, 1.0, 1);
    assert!(restless.is_active());
    // Planning, and waiting for the plan to be loaded.
    for answered in [false, true] {
        let mut slow = fallen(1);
        rest(&mut slow, 2..=4);
        if answered {
            slow.planned(Some(PublishedPlan { id: 5, activation_ns: 0 }));
        }
        assert_eq!(hold(&mut slow, 64, 0.0, 1), None, "another plan is loaded");
        assert!(slow.is_active());
        hold(&mut slow, 65, 0.0, 1);
        assert!(!slow.is_active());
    }
}

#[test]
fn a_request_of_the_operator_gives_all_attempts_again() {
    let mut recovery = fallen(1);
    rest(&mut recovery, 2..=4);
    let mut lose = |asked: bool, now: u64| {
        if asked {
            recovery.yield_to_operator();
        }
        recovery.note(&record(Mode::Balance, now * SECOND, 0.0, None), 5);
        recovery.note(&record(Mode::Stop, now * SECOND + 1, 3.0, Some(TripCause::BalanceLost)), 5);
        recovery.is_active()
    };
    assert_eq!([lose(false, 10), lose(true, 20)], [false, true]);
}

#[test]
fn an_operators_stop_is_no_loss() {
    let mut recovery = recovery(1);
    recovery.note(&record(Mode::Balance, 0, 0.0, None), 1);
    recovery.note(&record(Mode::Stop, SECOND, 0.0, None), 1);
    assert!(!recovery.is_active());
}

#[test]
fn an_operators_stop_after_a_loss_is_no_second_one() {
    let mut recovery = fallen(1);
    hold(&mut recovery, 2, 1.0, 1);
    recovery.yield_to_operator();
    // The cause of the first stop stays in the records.
    recovery.note(&record(Mode::Stop, 3 * SECOND, 1.0, Some(TripCause::BalanceLost)), 1);
    assert!(!recovery.is_active());
}

#[derive(Clone, Debug)]
enum Input {
    Cycle(usize, u64, f64, Option<usize>, u64),
    Planned(Option<u64>),
    Operator,
}

fn inputs() -> impl Strategy<Value = Input> {
    let cause = prop::option::of(0..TripCause::ALL.len());
    prop_oneof![
        20 => (0..Mode::ALL.len(), 0..3 * SECOND, prop_oneof![Just(0.0), Just(1.0), Just(f64::NAN)], cause, 0_u64..4)
            .prop_map(|(mode, dt, speed, cause, loaded)| Input::Cycle(mode, dt, speed, cause, loaded)),
        10 => (0..SECOND).prop_map(|dt| Input::Cycle(1, dt, 0.0, Some(15), 2)),
        5 => prop::option::of(1_u64..4).prop_map(Input::Planned),
        1 => Just(Input::Operator),
    ]
}

proptest! {
    #[test]
    fn whatever_comes(attempts in 0_u32..4, inputs in prop::collection::vec(inputs(), 1..400)) {
        let mut recovery = recovery(attempts);
        let (mut asked, mut started, mut now) = (0, 0, 0_u64);
        for input in inputs {
            match input {
                Input::Operator => {
                    recovery.yield_to_operator();
                    (asked, started) = (0, 0);
                }
                Input::Planned(id) => recovery.planned(id.map(|id| PublishedPlan { id, activation_ns: 0 })),
                Input::Cycle(mode, dt, speed, cause, loaded) => {
                    now += dt;
                    let cause = cause.map(|i| TripCause::ALL[i]);
                    let action = recovery.note(&record(Mode::ALL[mode], now, speed, cause), loaded);
                    asked += u32::from(action == Some(RecoveryAction::AskPlanner));
                    started += u32::from(matches!(action, Some(RecoveryAction::Start(_))));
                    prop_assert!(action.is_none() || matches!(Mode::ALL[mode], Mode::Hold | Mode::Stop));
                    prop_assert!(action != Some(RecoveryAction::AskPlanner) || Mode::ALL[mode] == Mode::Hold);
                }
            }
            prop_assert!(started <= asked && asked <= attempts);
        }
    }
}
