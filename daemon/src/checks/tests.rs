//! Tests of each check: for each joint, on both sides of its warning and trip levels.

use super::*;
use std::ops::Range;
use std::sync::LazyLock;
use upswing_ipc::Clock;
use upswing_model::Sizes;

/// Settings with different limits for all joints.
fn config() -> Config {
    let mut config = Config::embedded().expect("settings");
    let sizes = config.model.sizes();
    let (planning, limits) = (&mut config.robot.planning, &mut config.robot.limits);
    planning.q_min = JointVector::from_fn(sizes, |i| -1.0 - 0.1 * i as f64);
    planning.q_max = JointVector::from_fn(sizes, |i| 1.5 + 0.1 * i as f64);
    planning.qd_max = JointVector::repeat(sizes, 0.5);
    limits.qd_max = JointVector::from_fn(sizes, |i| 1.0 + 0.1 * i as f64);
    planning.tau_max = ActuatedVector::repeat(sizes, 1.0);
    limits.tau_max = ActuatedVector::from_fn(sizes, |i| 10.0 + i as f64);
    config
}

/// Numbers of joints of the arm, and the indices of q_A, q_U and q.
fn sizes() -> Sizes {
    CHECKS.q_min.sizes()
}

fn arm() -> Range<usize> {
    0..sizes().actuated()
}

fn pendulum() -> Range<usize> {
    sizes().actuated()..sizes().joints()
}

fn all() -> Range<usize> {
    0..sizes().joints()
}

/// Checks with the settings of [`config`].
static CHECKS: LazyLock<Checks> = LazyLock::new(|| Checks::new(&config()));

/// Returns a measurement of a healthy robot.
fn healthy() -> Measurement {
    Measurement {
        seq: 1,
        t_ns: 125_000,
        status: Measurement::DRIVES_READY,
        clock: Clock::Paced.code(),
        period_ns: 125_000,
        ..Measurement::default()
    }
}

/// Returns `value` for one joint and `others` for all other joints.
fn but(joint: usize, value: f64, others: f64) -> JointVector {
    JointVector::from_fn(sizes(), |i| if i == joint { value } else { others })
}

/// Runs `check` on `values`; returns its trip, and whether it warns.
fn result(
    cause: TripCause,
    check: &dyn Fn(&mut Checks, &JointVector) -> Option<Trip>,
    values: &JointVector,
) -> (Option<Trip>, bool) {
    let mut checks = CHECKS.clone();
    // A warning of another limit, which the check must keep.
    checks.warnings.insert(TripCause::UnknownClock);
    let trip = check(&mut checks, values);
    assert_eq!(
        checks.warnings.bits() & !cause.bit(),
        TripCause::UnknownClock.bit(),
        "{cause:?} keeps the warnings of others and sets its own only"
    );
    (trip, checks.warnings.contains(cause))
}

/// Checks warnings and trips beyond the levels of each of `joints` in both directions, and of no other joint. The first joint
/// beyond its level trips; a NaN trips.
fn is_a_level(
    cause: TripCause,
    joints: Range<usize>,
    level: impl Fn(usize) -> Level,
    check: impl Fn(&mut Checks, &JointVector) -> Option<Trip>,
) {
    let result = |values: &JointVector| result(cause, &check, values);
    for joint in all() {
        if !joints.contains(&joint) {
            for value in [1e9, -1e9, f64::NAN, f64::INFINITY] {
                assert_eq!(result(&but(joint, value, 0.0)), (None, false), "{cause:?}, joint {joint}");
            }
            continue;
        }
        let Level { warn, trip } = level(joint);
        for sign in [-1.0, 1.0] {
            let at = |value: f64| result(&but(joint, sign * value, 0.0));
            assert_eq!(at(warn - 1e-9), (None, false), "{cause:?}, joint {joint}");
            assert_eq!(at(warn + 1e-9), (None, true), "{cause:?}, joint {joint}");
            assert_eq!(at(trip - 1e-9), (None, true), "{cause:?}, joint {joint}");
            for value in [trip + 1e-9, 1e300, f64::INFINITY] {
                let (got, warns) = at(value);
                let got = got.unwrap_or_else(|| panic!("{cause:?}, joint {joint}: no trip at {value}"));
                assert_eq!((got.cause, got.joint, got.value), (cause, joint, sign * value));
                assert!((got.limit - trip).abs() < 1e-12 && warns, "{cause:?}, joint {joint}: {}", got.limit);
            }
        }
        let (got, warns) = result(&but(joint, f64::NAN, 0.0));
        assert!(got.is_some_and(|trip| trip.joint == joint) && warns, "{cause:?}, joint {joint}: NaN");
        // One finite value among NaNs does not prevent a trip.
        let (got, _) = result(&but(joint, 0.0, f64::NAN));
        let first = joints.clone().find(|other| *other != joint);
        assert_eq!(got.map(|trip| trip.joint), first, "{cause:?}, joint {joint}: NaN elsewhere");
    }
    let (got, _) = result(&JointVector::repeat(sizes(), 1e9));
    assert_eq!(got.map(|trip| trip.joint), Some(joints.start), "{cause:?}");
}

/// Checks warnings and trips beyond the levels of a count.
fn is_a_count(cause: TripCause, level: Level, check: impl Fn(&mut Checks, u64) -> Option<Trip>) {
    let (warn, most) = (level.warn as u64, level.trip as u64);
    for (n, trips, warns) in [
        (0, false, false),
        (warn, false, false),
        (warn + 1, false, true),
        (most, false, true),
        (most + 1, true, true),
        (u64::MAX, true, true),
    ] {
        let mut checks = CHECKS.clone();
        let trip = check(&mut checks, n);
        assert_eq!(checks.warnings.bits(), if warns { cause.bit() } else { 0 }, "{cause:?}: {n}");
        let expected = trips.then_some(Trip { cause, joint: 0, value: n as f64, limit: level.trip });
        assert_eq!(trip, expected, "{cause:?}: {n}");
    }
}

fn at_rest(q: &JointVector) -> State {
    State::new(q, &JointVector::zeros(q.sizes()))
}

fn moving(q: &JointVector) -> State {
    State::new(q, &JointVector::repeat(q.sizes(), 9.0))
}

/// Checks warnings and trips beyond the range of each of `joints`.
fn is_a_range(
    cause: TripCause,
    joints: Range<usize>,
    config: &Config,
    check: impl Fn(&mut Checks, &State) -> Option<Trip>,
) {
    let Level { warn, trip } = config.daemon.limits.position_margin;
    let planning = &config.robot.planning;
    let check = |checks: &mut Checks, q: &JointVector| check(checks, &at_rest(q));
    for joint in all() {
        let at = |value| result(cause, &check, &but(joint, value, 0.0));
        if !joints.contains(&joint) {
            for value in [1e9, -1e9, f64::NAN] {
                assert_eq!(at(value), (None, false), "{cause:?}, joint {joint}");
            }
            continue;
        }
        for (bound, out) in [(planning.q_min[joint], -1.0), (planning.q_max[joint], 1.0)] {
            assert_eq!(at(bound + out * (warn - 1e-9)), (None, false), "{cause:?}, joint {joint}, {out}");
            assert_eq!(at(bound + out * (warn + 1e-9)), (None, true), "{cause:?}, joint {joint}, {out}");
            assert_eq!(at(bound + out * (trip - 1e-9)), (None, true), "{cause:?}, joint {joint}, {out}");
            for value in [bound + out * (trip + 1e-9), out * 1e300, out * f64::INFINITY] {
                let (got, warns) = at(value);
                let got = got.unwrap_or_else(|| panic!("{cause:?}, joint {joint}: no trip at {value}"));
                assert_eq!((got.cause, got.joint, got.value), (cause, joint, value));
                let limit = bound + out * trip;
                assert!(
                    (got.limit - limit).abs() < 1e-12 && warns,
                    "{cause:?}, joint {joint}: {}",
                    got.limit
                );
            }
        }
        let (got, warns) = at(f64::NAN);
        assert!(got.is_some_and(|trip| trip.joint == joint) && warns, "{cause:?}, joint {joint}: NaN");
    }
    let (got, _) = result(cause, &check, &JointVector::repeat(sizes(), -1e9));
    assert_eq!(got.map(|trip| trip.joint), Some(joints.start), "{cause:?}");
}

#[test]
fn counts() {
    let config = config();
    let levels = config.daemon.limits;
    is_a_count(TripCause::StaleMeasurement, levels.measurement_age, |checks, n| checks.age(n));
    is_a_count(TripCause::DrivesStopped, levels.drives_stopped, |checks, n| checks.drives(n));
    is_a_count(TripCause::MeasurementGap, levels.measurement_gap, |checks, n| checks.gap(n));
    is_a_count(TripCause::LateCycles, levels.late_cycles, |checks, n| checks.late(n));
    let lost = CHECKS.lost(8000);
    let limit = levels.measurement_age.trip;
    assert_eq!(lost, Trip { cause: TripCause::StaleMeasurement, joint: 0, value: 8000.0, limit });
}

#[test]
fn the_age_of_a_plan() {
    let config = config();
    let mut checks = CHECKS.clone();
    let Level { warn, trip } = config.daemon.limits.plan_age;
    for (age, refused, warns) in [
        (0.0, false, false),
        (warn, false, false),
        (warn + 0.1, false, true),
        (trip, false, true),
        (trip + 0.1, true, true),
    ] {
        checks.begin_cycle();
        let got = checks.plan_age(age);
        let expected = if refused { Err(RequestRefusal::PlanExpired { age, limit: trip }) } else { Ok(()) };
        assert_eq!((got, checks.warnings.contains(TripCause::PlanAge)), (expected, warns), "{age} s");
        assert_eq!(checks.is_plan_old(age), warns, "{age} s");
    }
    assert!(checks.plan_age(f64::NAN).is_err());
}

#[test]
fn levels_of_the_joints() {
    let config = config();
    let levels = config.daemon.limits;
    let (qd_max, tau_max) = (config.robot.limits.qd_max, config.robot.limits.tau_max);
    let share = |level: Level, full: f64| Level { warn: level.warn * full, trip: level.trip * full };

    is_a_level(
        TripCause::VelocityLimit,
        arm(),
        |i| share(levels.velocity_fraction, qd_max[i]),
        |checks, qd| checks.arm(&JointVector::zeros(sizes()), qd),
    );
    is_a_level(
        TripCause::TorqueLimit,
        arm(),
        |i| share(levels.torque_fraction, tau_max[i]),
        |checks, tau| checks.measurement(&healthy(), &tau.actuated(), None),
    );
    // Torque changes in a cycle of 125 us.
    is_a_level(
        TripCause::TorqueRate,
        arm(),
        |i| share(levels.torque_rate, tau_max[i]),
        |checks, rate| {
            let change = rate.actuated() * 125e-6;
            checks.torque_rate(&ActuatedVector::zeros(sizes()), &change).map(|trip| Trip {
                // Up to the rounding errors of multiplication and division.
                value: if (trip.value / rate[trip.joint] - 1.0).abs() < 1e-12 {
                    rate[trip.joint]
                } else {
                    trip.value
                },
                ..trip
            })
        },
    );
    let zero = State::zeros(sizes());
    is_a_level(
        TripCause::TrackingError,
        all(),
        |_| levels.tracking_error,
        |checks, q| checks.tracking(&moving(q), &zero),
    );
    for cycles in [1, 3, 100] {
        is_a_level(
            TripCause::EncoderJump,
            all(),
            |i| {
                let fastest = if arm().contains(&i) { 2.0 * qd_max[i] } else { 30.0 };
                let moved = fastest * cycles as f64 * 125e-6;
                let Level { warn, trip } = levels.encoder_jump;
                Level { warn: moved + warn, trip: moved + trip }
            },
            |checks, q| checks.jump(&JointVector::zeros(sizes()), q, cycles),
        );
    }
}

#[test]
fn differences_are_taken_the_right_way_round() {
    let mut checks = CHECKS.clone();
    let [q, last] = [2.0, -1.0].map(|v| JointVector::repeat(sizes(), v));
    let trip = checks.jump(&last, &q, 1).expect("3 rad");
    assert_eq!(trip.value, 3.0);
    let [x, x_d] = [q, last].map(|q| at_rest(&q));
    assert_eq!(checks.tracking(&x, &x_d).map(|trip| trip.value), Some(3.0));
    let [tau, before] = [2.0, -1.0].map(|v| ActuatedVector::repeat(sizes(), v));
    let rate = checks.torque_rate(&before, &(tau * 100.0)).expect("a step").value;
    assert!((rate * 125e-6 - 201.0).abs() < 1e-9, "{rate}");
}

#[test]
fn positions() {
    let config = config();
    let mut checks = CHECKS.clone();
    is_a_range(TripCause::PositionLimit, arm(), &config, |checks, x| checks.arm(&x.q(), &x.qd()));
    is_a_range(TripCause::PendulumRange, pendulum(), &config, |checks, x| checks.pendulum(x));
    // A position limit takes precedence over a velocity limit.
    let x = State::repeat(sizes(), 1e9);
    assert_eq!(checks.arm(&x.q(), &x.qd()).map(|trip| trip.cause), Some(TripCause::PositionLimit));
    assert_eq!(checks.warnings.bits(), TripCause::PositionLimit.bit() | TripCause::VelocityLimit.bit());
}

#[test]
fn the_distance_of_the_pendulum() {
    let config = config();
    let Level { warn, trip } = config.daemon.limits.balance_distance;
    let x_d = State::from_fn(sizes(), |i| 0.1 * i as f64);
    let at = |distance: f64| {
        let mut checks = CHECKS.clone();
        // Wherever the arm is, and however fast.
        let mut x = State::repeat(sizes(), 9.0);
        x.q_u_mut().copy_from_slice(&[x_d.q_u()[0] + 0.6 * distance, x_d.q_u()[1] - 0.8 * distance]);
        let lost = checks.balance(&x, &x_d);
        assert!(lost.is_none_or(|t| t.cause == TripCause::BalanceLost && t.limit == trip));
        (lost.is_some(), checks.warnings.bits() == TripCause::BalanceLost.bit())
    };
    assert_eq!(at(warn - 1e-9), (false, false));
    assert_eq!(at(warn + 1e-9), (false, true));
    assert_eq!(at(trip - 1e-9), (false, true));
    assert_eq!(at(trip + 1e-9), (true, true));
    assert_eq!(at(f64::NAN), (true, true));
}

#[test]
fn the_speed_that_a_balance_asks_for() {
    let config = config();
    let mut checks = CHECKS.clone();
    let Level { warn, trip } = config.daemon.limits.balance_speed;
    let level = |i: usize| Level { warn: warn * (1.0 + 0.1 * i as f64), trip: trip * (1.0 + 0.1 * i as f64) };
    let none = ActuatedVector::zeros(sizes());
    is_a_level(TripCause::BalanceSpeed, arm(), level, |checks, v| checks.balance_speed(&v.actuated(), &none));
    // The speed is predicted over T_1 = 12 ms and 8 ms.
    for (u, trips) in [(49.9, false), (50.1, true), (f64::NAN, true)] {
        let input = but(0, trip * u, 0.0).actuated();
        assert_eq!(checks.balance_speed(&none, &input).is_some(), trips, "{u} rad/s^2");
    }
    let [v, u] = [3.0, -150.0].map(|v| ActuatedVector::repeat(sizes(), v));
    assert_eq!(checks.balance_speed(&v, &u), None, "one against the other");
}

#[test]
fn distances_of_the_arm_and_unexplained_torques() {
    let config = config();
    let (levels, zero) = (&config.daemon.limits, State::zeros(sizes()));
    is_a_level(
        TripCause::TrackingError,
        arm(),
        |_| levels.hold_error,
        |checks, q| checks.hold(&moving(q), &zero),
    );
    is_a_level(
        TripCause::TrackingError,
        arm(),
        |_| levels.balance_error,
        |checks, q| checks.balance_error(&moving(q), &zero),
    );
    let Level { warn, trip } = levels.collision_torque;
    let level = |i: usize| Level { warn: warn * (10.0 + i as f64), trip: trip * (10.0 + i as f64) };
    is_a_level(TripCause::Collision, arm(), level, |checks, tau| checks.unexplained(&tau.actuated()));
}

#[test]
fn measurements_that_cannot_be_used() {
    let cause = |spoil: &dyn Fn(&mut Measurement)| {
        let mut measurement = healthy();
        spoil(&mut measurement);
        CHECKS.clone().measurement(&measurement, &ActuatedVector::zeros(sizes()), None)
    };
    assert_eq!(cause(&|_| ()), None);
    for clock in [Clock::Wall, Clock::Paced, Clock::Lockstep] {
        assert_eq!(cause(&|m| m.clock = clock.code()), None);
    }
    let trip = cause(&|m| m.clock = 77).expect("no such clock");
    assert_eq!((trip.cause, trip.joint, trip.value), (TripCause::UnknownClock, 0, 77.0));
    for period in [124_999, 125_001, 0] {
        let trip = cause(&|m| m.period_ns = period).expect("another period");
        let expected =
            Trip { cause: TripCause::PeriodMismatch, joint: 0, value: period as f64, limit: 125_000.0 };
        assert_eq!(trip, expected);
    }
    let trip = cause(&|m| m.status |= Measurement::DRIVE_FAULT).expect("a fault");
    assert_eq!(trip, Trip::plain(TripCause::DriveFault));
    assert_eq!(cause(&|m| m.status = Measurement::BRAKES_CLOSED), None, "that is no fault by itself");
    for joint in all() {
        let at = |value| CHECKS.finite(&but(joint, value, 0.1));
        for value in [f64::NAN, f64::INFINITY, -f64::INFINITY, 100.1, -100.1] {
            let trip = at(value).expect("no position");
            assert_eq!((trip.cause, trip.joint, trip.limit), (TripCause::NotFinite, joint, 100.0));
            assert!(trip.value == value || value.is_nan());
            let given = CHECKS.clone().measurement(&healthy(), &ActuatedVector::zeros(sizes()), Some(trip));
            assert_eq!(given.map(|trip| (trip.cause, trip.joint)), Some((TripCause::NotFinite, joint)));
        }
        assert_eq!([at(99.9), at(-99.9)], [None; 2]);
    }
    let expected = sizes();
    for (joints, actuated, value, limit) in [(8, 7, 8.0, 9.0), (9, 6, 6.0, 7.0), (0, 0, 0.0, 9.0)] {
        let trip = CHECKS.other_chain(&OtherChain { payload: "measurement", joints, actuated, expected });
        assert_eq!(trip, Trip { cause: TripCause::OtherChain, joint: 0, value, limit });
    }
}

#[test]
fn the_start_of_a_plan() {
    let config = config();
    let checks = Checks::new(&config);
    let x_0 = State::from_fn(sizes(), |i| 0.01 * i as f64);
    assert_eq!(checks.start(&x_0, &x_0, 0.25), Ok(()));
    let joints = sizes().joints();
    let tolerances = State::new(&config.daemon.start.position, &config.daemon.start.velocity);
    for row in 0..x_0.len() {
        let tolerance = tolerances[row];
        for sign in [-1.0, 1.0] {
            let at = |by: f64| {
                let mut x = x_0;
                x[row] += sign * by;
                (checks.start(&x, &x_0, 0.25), x[row])
            };
            assert_eq!(at(tolerance - 1e-9).0, Ok(()), "row {row}");
            let (refusal, measured) = at(tolerance + 1e-9);
            let (joint, velocity, expected) = (row % joints, row >= joints, x_0[row]);
            let want = RequestRefusal::StartMismatch {
                joint,
                velocity,
                measured,
                expected,
                t_plan: 0.25,
                tolerance,
            };
            assert_eq!(refusal, Err(want), "row {row}");
        }
        let mut x = x_0;
        x[row] = f64::NAN;
        assert!(checks.start(&x, &x_0, 0.25).is_err(), "row {row}");
        assert!(checks.start(&x_0, &x, 0.25).is_err(), "row {row}");
    }
}

#[test]
fn the_torque_of_a_mode_that_begins() {
    let config = config();
    let checks = Checks::new(&config);
    // The rate of 1 / ms allows 1/8 of the limit in 125 us, thus 16 steps from -limit to limit.
    let step = checks.torque_step();
    assert!((step - config.robot.limits.tau_max * 0.125).amax() < 1e-12, "{step:?}");
    assert_eq!(checks.torque_steps(), 16);
}
