//! For each cause of a trip there is an input that trips it, and the next better input does not.

mod common;

use common::{PERIOD_NS, all, at_rest, config, measurement, rest_plan, rest_pose, sizes, unit, upright_pose};
use nalgebra::{DMatrix, DVector};
use upswing_config::{Config, Level};
use upswing_ipc::{Clock, Measurement, Mode, Readiness, Telemetry};
use upswing_model::{ActuatedVector, JointVector, MOST_JOINTS, Workspace};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepOutput, StepRequest};
use upswingd::supervisor::RequestRefusal;
use upswingd::trip::{Trip, TripCause};

/// An enabled controller after its second measurement, and the pose it holds.
fn enabled() -> (Controller, JointVector) {
    enabled_at(rest_pose(&config()))
}

fn enabled_at(q: JointVector) -> (Controller, JointVector) {
    enabled_with(&config(), q)
}

fn enabled_with(config: &Config, q: JointVector) -> (Controller, JointVector) {
    let mut controller = Controller::new(config);
    controller.step(StepInput::new(measurement(1, &q), 0, Some(StepRequest::Enable)));
    controller.step(StepInput::new(measurement(2, &q), 0, None));
    assert_eq!(controller.mode(), Mode::Hold);
    (controller, q)
}

/// A measurement whose angles flicker by a step of the encoders, as those of a robot do that moves against its torques: else
/// they would count as stuck.
fn flickering(seq: u64, q: &JointVector) -> Measurement {
    measurement(seq, &(q + all(if seq.is_multiple_of(2) { 2e-5 } else { 0.0 })))
}

/// One in Balance.
fn balancing(config: &Config) -> (Controller, JointVector) {
    let (mut controller, q) = enabled_with(config, upright_pose());
    let plan = rest_plan(config, &at_rest(&q), 0.0005);
    controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
    assert_eq!(controller.mode(), Mode::Track);
    (5..=10).for_each(|seq| {
        controller.step(StepInput::new(measurement(seq, &q), 0, None));
    });
    assert_eq!(controller.mode(), Mode::Balance);
    (controller, q)
}

fn trip(controller: &Controller) -> Option<(Mode, TripCause, usize)> {
    controller.trip().map(|trip| (controller.mode(), trip.cause, trip.joint))
}

/// Whether the cycle exceeded the warning level of `cause`.
fn warns(output: &StepOutput, cause: TripCause) -> bool {
    output.record.telemetry.warnings & cause.bit() != 0
}

fn faults_on(spoil: impl Fn(&mut Measurement), cause: TripCause, joint: usize) -> StepOutput {
    let (mut controller, q) = enabled();
    let mut bad = measurement(3, &q);
    spoil(&mut bad);
    let output = controller.step(StepInput::new(bad, 0, None));
    assert_eq!(trip(&controller), Some((Mode::Fault, cause, joint)));
    assert_eq!((output.command.brake, output.command.tau), (1, [0.0; MOST_JOINTS]));
    assert_eq!(output.record.telemetry.fault, cause.code());
    // It stays, with its cause, until the reset.
    controller.step(StepInput::new(measurement(4, &q), 0, None));
    assert_eq!(trip(&controller), Some((Mode::Fault, cause, joint)));
    controller.step(StepInput::new(measurement(5, &q), 0, Some(StepRequest::Reset)));
    assert_eq!((controller.mode(), controller.trip()), (Mode::Idle, None));
    output
}

#[test]
fn not_finite() {
    faults_on(|m| m.q[4] = f64::NAN, TripCause::NotFinite, 4);
    faults_on(|m| m.q[8] = f64::INFINITY, TripCause::NotFinite, 8);
}

#[test]
fn an_angle_that_no_encoder_shows() {
    faults_on(|m| m.q[7] = 101.0, TripCause::NotFinite, 7);
}

#[test]
fn measurement_gap() {
    let (mut controller, q) = enabled();
    let output = controller.step(StepInput::new(measurement(2 + 21, &q), 0, None));
    assert_eq!((controller.mode(), warns(&output, TripCause::MeasurementGap)), (Mode::Hold, true));
    let output = controller.step(StepInput::new(measurement(23 + 1, &q), 0, None));
    assert!(!warns(&output, TripCause::MeasurementGap));
    controller.step(StepInput::new(measurement(24 + 22, &q), 0, None));
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::MeasurementGap, 0)));
    assert_eq!(controller.trip().map(|trip| (trip.value, trip.limit)), Some((21.0, 20.0)));
}

#[test]
fn measured_torque() {
    // 120 % of 40 N m.
    faults_on(|m| m.tau_measured[5] = -48.1, TripCause::TorqueLimit, 5);
    faults_on(|m| m.tau_measured[0] = f64::NAN, TripCause::TorqueLimit, 0);
    let ((mut controller, q), mut seq) = (enabled(), 2);
    for (tau, warned) in [(35.9, false), (36.1, true), (47.9, true)] {
        seq += 1;
        let mut next = measurement(seq, &q);
        next.tau_measured[6] = tau;
        let output = controller.step(StepInput::new(next, 0, None));
        assert_eq!(
            (controller.mode(), warns(&output, TripCause::TorqueLimit)),
            (Mode::Hold, warned),
            "{tau}"
        );
    }
}

#[test]
fn torque_rate() {
    let config = config();
    // 100 % per ms warns, 400 % per ms trips: 1/8 and 1/2 of 320 N m in one cycle.
    for (jump, expected) in
        [(0.1, (Mode::Track, false)), (0.3, (Mode::Track, true)), (0.6, (Mode::Fault, true))]
    {
        let (mut controller, q) = enabled();
        let x = at_rest(&q);
        let mut plan = rest_plan(&config, &x, 1.0);
        // The input that changes the torque of joint 1 alone: (24) is affine in u.
        let mut work = Workspace::default();
        let at_rest = config.model.torque(&x, &ActuatedVector::zeros(sizes()), &mut work);
        let n = sizes().actuated();
        let mass = DMatrix::from_fn(n, n, |i, j| (config.model.torque(&x, &unit(j), &mut work) - at_rest)[i]);
        let change = DVector::from_column_slice(&(unit(0) * (jump * config.robot.limits.tau_max[0])));
        let u = mass.lu().solve(&change).unwrap() * (0.01 / common::PERIOD);
        // u_d is linear between knots 10 ms apart.
        plan.trajectory.u[1].copy_from_slice(u.as_slice());
        controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
        controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
        let output = controller.step(StepInput::new(measurement(5, &q), 0, None));
        assert_eq!((controller.mode(), warns(&output, TripCause::TorqueRate)), expected, "{jump}");
        if expected.0 == Mode::Fault {
            assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::TorqueRate, 0)));
            assert_eq!((output.command.brake, output.command.tau), (1, [0.0; MOST_JOINTS]));
        }
    }
}

#[test]
fn late_cycles() {
    let config = config();
    let (mut controller, q) = enabled();
    let late = |seq, late_cycles| StepInput { late_cycles, ..StepInput::new(measurement(seq, &q), 0, None) };
    let output = controller.step(late(3, 1000));
    assert_eq!(controller.mode(), Mode::Hold, "Hold is what a lateness leads to anyway");
    assert!(warns(&output, TripCause::LateCycles));
    let plan = rest_plan(&config, &at_rest(&q), 1.0);
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Load(plan))));
    controller.step(StepInput::new(measurement(5, &q), 0, Some(StepRequest::Start(7))));
    for (seq, late_cycles, expected) in
        [(6, 1, (Mode::Track, false)), (7, 20, (Mode::Track, true)), (8, 21, (Mode::Stop, true))]
    {
        let output = controller.step(late(seq, late_cycles));
        assert_eq!((controller.mode(), warns(&output, TripCause::LateCycles)), expected, "{late_cycles}");
    }
    assert_eq!(trip(&controller), Some((Mode::Stop, TripCause::LateCycles, 0)));
}

#[test]
fn encoder_jump() {
    // Twice 85 deg/s for a cycle, and the steps of the encoder: 1.37 mrad.
    faults_on(|m| m.q[0] += 0.002, TripCause::EncoderJump, 0);
    faults_on(|m| m.q[7] -= 0.01, TripCause::EncoderJump, 7);
    let (mut controller, mut q) = enabled();
    q[0] += 0.0005;
    q[7] -= 0.004;
    controller.step(StepInput::new(measurement(3, &q), 0, None));
    assert_eq!(controller.mode(), Mode::Hold);
}

#[test]
fn a_jump_with_closed_brakes_is_no_fault() {
    let config = config();
    let mut q = rest_pose(&config);
    let mut controller = Controller::new(&config);
    controller.step(StepInput::new(measurement(1, &q), 0, None));
    q[0] = 1.0;
    let output = controller.step(StepInput::new(measurement(2, &q), 0, Some(StepRequest::Enable)));
    assert_eq!((output.answer, controller.mode()), (Some(Ok(())), Mode::Hold));
}

#[test]
fn position_limit() {
    // 170 + 5 deg.
    let config = moved_by_others();
    let (mut controller, mut q) = enabled_with(&config, rest_pose(&config));
    let mut seq = 2;
    let mut warned = None;
    while controller.mode() == Mode::Hold {
        q[2] += 1e-4;
        seq += 1;
        let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::PositionLimit).then_some(q[2].to_degrees()));
    }
    assert!(warned.is_some_and(|deg| (deg - 171.0).abs() < 0.01), "{warned:?}");
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::PositionLimit, 2)));
    assert!((q[2].to_degrees() - 175.0).abs() < 0.01, "{}", q[2].to_degrees());
}

/// The arm moves as no command makes it, and that alone is no reason to give up.
fn moved_by_others() -> Config {
    let mut config = config();
    config.daemon.limits.collision_torque.trip = 1e6;
    config.daemon.limits.hold_error.trip = 1e6;
    config
}

#[test]
fn distance_from_the_held_pose() {
    let mut config = moved_by_others();
    config.daemon.limits.hold_error = Level { warn: 0.1, trip: 0.3 };
    for joint in [1, 6] {
        let (mut controller, mut q) = enabled_with(&config, rest_pose(&config));
        let (mut seq, before, mut warned) = (2, q[joint], None);
        while controller.mode() == Mode::Hold {
            q[joint] += 1e-4;
            seq += 1;
            let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
            warned = warned.or(warns(&output, TripCause::TrackingError).then_some(q[joint] - before));
        }
        assert!(warned.is_some_and(|error| (error - 0.1).abs() < 1e-3), "{warned:?}");
        assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::TrackingError, joint)));
        assert!((q[joint] - before - 0.3).abs() < 1e-3, "{}", q[joint] - before);
    }
}

#[test]
fn distance_from_the_end_of_a_plan_in_balance() {
    let mut config = moved_by_others();
    config.daemon.limits.balance_speed.trip = 1e6;
    config.daemon.limits.torque_rate.trip = 1e9;
    let (mut controller, mut q) = balancing(&config);
    let (mut seq, mut warned) = (10, None);
    while controller.mode() == Mode::Balance {
        q[0] += 1e-4;
        seq += 1;
        let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::TrackingError).then_some(q[0]));
    }
    assert!(warned.is_some_and(|error| (error - 0.25).abs() < 1e-3), "{warned:?}");
    assert_eq!(trip(&controller), Some((Mode::Stop, TripCause::TrackingError, 0)));
    assert!((q[0] - 0.5).abs() < 1e-3, "{}", q[0]);
}

#[test]
fn collision() {
    // Joint 2 is pushed away: an acceleration of 10 rad/s^2 that was not commanded.
    let (mut controller, q) = enabled();
    let (mut seq, mut warned) = (2, None);
    while controller.mode() == Mode::Hold {
        seq += 1;
        let t = (seq - 2) as f64 * common::PERIOD;
        let mut moved = q;
        moved[1] += 5.0 * t * t;
        let output = controller.step(StepInput::new(flickering(seq, &moved), 0, None));
        warned = warned.or(warns(&output, TripCause::Collision).then_some(t));
    }
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::Collision, 1)));
    let Trip { value, limit, .. } = *controller.trip().unwrap();
    assert!((limit - 0.09 * 320.0).abs() < 1e-9 && value.abs() > limit, "{value} N m, limit {limit}");
    let t = (seq - 2) as f64 * common::PERIOD;
    assert!(warned.is_some_and(|warned| warned < t - 0.06), "warned at {warned:?} s, tripped at {t} s");
}

#[test]
fn frozen_measurement() {
    for (senses, expected) in [(Measurement::LOAD_SENSED, Some(TripCause::FrozenMeasurement)), (0, None)] {
        let q = rest_pose(&config());
        let mut controller = Controller::new(&config());
        let mut first = measurement(1, &q);
        first.status |= Measurement::BRAKES_CLOSED | senses;
        controller.step(StepInput::new(first, 0, Some(StepRequest::Enable)));
        controller.step(StepInput::new(measurement(2, &q), 0, None));
        // A step of an encoder away from the held pose: the command changes, nothing else does.
        let away = q + all(2e-5);
        for seq in 3..400 {
            controller.step(StepInput::new(measurement(seq, &away), 0, None));
        }
        assert_eq!(controller.trip().map(|trip| trip.cause), expected);
    }
}

#[test]
fn velocity_limit_of_the_arm_only() {
    let config = moved_by_others();
    let (mut controller, mut q) = enabled_with(&config, rest_pose(&config));
    // 1.1 times 75 deg/s is 1.44 rad/s; the pendulum may fall faster.
    for seq in 3..200 {
        q[7] += 20.0 * common::PERIOD;
        controller.step(StepInput::new(flickering(seq, &q), 0, None));
    }
    assert_eq!(controller.mode(), Mode::Hold);
    for seq in 200..1000 {
        q[3] += 1.0 * common::PERIOD;
        controller.step(StepInput::new(flickering(seq, &q), 0, None));
    }
    assert_eq!(controller.mode(), Mode::Hold);
    let mut warned = None;
    for seq in 1000..1500 {
        q[3] += 1.6 * common::PERIOD;
        let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::VelocityLimit).then_some(controller.mode()));
    }
    assert_eq!(warned, Some(Mode::Hold));
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::VelocityLimit, 3)));
}

#[test]
fn drive_fault_period_joints_and_clock() {
    faults_on(|m| m.status |= Measurement::DRIVE_FAULT, TripCause::DriveFault, 0);
    faults_on(|m| m.period_ns = 1_000_000, TripCause::PeriodMismatch, 0);
    faults_on(|m| m.joints = 8, TripCause::OtherChain, 0);
    faults_on(|m| m.actuated = 6, TripCause::OtherChain, 0);
    faults_on(|m| (m.joints, m.actuated) = (u64::MAX, u64::MAX), TripCause::OtherChain, 0);
    let (mut controller, q) = enabled();
    let mut bad = measurement(3, &q);
    bad.clock = 9;
    controller.step(StepInput::new(bad, 0, None));
    // A clock that changes is also a plant that restarted.
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::MeasurementRestarted, 0)));
    let answer = controller.step(StepInput::new(bad, 0, Some(StepRequest::Reset))).answer;
    assert_eq!(answer, Some(Ok(())));
    bad.seq = 4;
    let answer = controller.step(StepInput::new(bad, 0, Some(StepRequest::Enable))).answer;
    assert!(
        matches!(answer, Some(Err(RequestRefusal::Unfit(trip))) if trip.cause == TripCause::UnknownClock),
        "{answer:?}"
    );
}

#[test]
fn stale_measurement() {
    let config = config();
    let q = rest_pose(&config);
    let mut controller = Controller::new(&config);
    let mut last = measurement(1, &q);
    last.clock = Clock::Wall.code();
    let mut cycle = |now: u64, request| {
        let output = controller.step(StepInput::new(last, now * PERIOD_NS, request));
        (controller.mode(), output.record.telemetry.flags & Telemetry::STALE != 0, output.record.trip)
    };
    assert_eq!(cycle(1, Some(StepRequest::Enable)), (Mode::Hold, false, None));
    for age in 1..=20 {
        assert_eq!(cycle(1 + age, None), (Mode::Hold, true, None));
    }
    let (mode, _, stale) = cycle(22, None);
    assert_eq!(
        (mode, stale.map(|t| (t.cause, t.value))),
        (Mode::Fault, Some((TripCause::StaleMeasurement, 21.0)))
    );
    // Where time stands still nothing gets stale.
    let (mut controller, q) = enabled();
    for _ in 0..1000 {
        controller.step(StepInput::new(measurement(2, &q), 0, None));
    }
    assert_eq!(controller.mode(), Mode::Hold);
    controller.step(StepInput { lost_cycles: 8000, ..StepInput::new(measurement(2, &q), 0, None) });
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::StaleMeasurement, 0)));
}

#[test]
fn time_stamp_that_stands_still() {
    let (mut controller, q) = enabled();
    let stuck = measurement(2, &q).t_ns;
    let mut cycle = |seq, t_ns| {
        controller.step(StepInput::new(Measurement { t_ns, ..measurement(seq, &q) }, 0, None));
        trip(&controller)
    };
    for seq in 3..=22 {
        assert_eq!(cycle(seq, stuck), None);
    }
    // It went on in time; a stamp from far ahead does not make the next ones old.
    assert_eq!(cycle(23, u64::MAX), None);
    for seq in 24..=200 {
        assert_eq!(cycle(seq, seq * PERIOD_NS), None);
    }
    for seq in 201..=220 {
        assert_eq!(cycle(seq, 200 * PERIOD_NS), None);
    }
    assert_eq!(cycle(221, 200 * PERIOD_NS), Some((Mode::Fault, TripCause::StaleMeasurement, 0)));
}

#[test]
fn measurement_that_comes_late() {
    let q = rest_pose(&config());
    for (late, expected) in [(20, Mode::Hold), (21, Mode::Fault)] {
        let mut controller = Controller::new(&config());
        let mut cycle = |seq: u64, now: u64, request| {
            let measured = Measurement { clock: Clock::Wall.code(), ..measurement(seq, &q) };
            controller.step(StepInput::new(measured, now * PERIOD_NS, request));
            controller.mode()
        };
        assert_eq!(cycle(1, 1, Some(StepRequest::Enable)), Mode::Hold);
        assert_eq!(cycle(2, 2 + late, None), expected);
    }
}

#[test]
fn drives_stopped() {
    for spoil in [
        |m: &mut Measurement| m.status |= Measurement::BRAKES_CLOSED,
        |m: &mut Measurement| m.status &= !Measurement::DRIVES_READY,
    ] {
        let (mut controller, q) = enabled();
        let mut cycle = |seq, spoiled: bool| {
            let mut next = measurement(seq, &q);
            if spoiled {
                spoil(&mut next);
            }
            let output = controller.step(StepInput::new(next, 0, None));
            (controller.mode(), warns(&output, TripCause::DrivesStopped))
        };
        for seq in 3..803 {
            assert_eq!(cycle(seq, true), (Mode::Hold, seq > 82));
        }
        // They act again, and stop again.
        assert_eq!(cycle(803, false), (Mode::Hold, false));
        assert_eq!((804..1604).find(|seq| cycle(*seq, true).0 != Mode::Hold), None);
        assert_eq!(cycle(1604, true), (Mode::Fault, true));
        assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::DrivesStopped, 0)));
    }
    // With braked joints they need not act.
    let mut controller = Controller::new(&config());
    let q = rest_pose(&config());
    for seq in 1..2000 {
        let status = Measurement::BRAKES_CLOSED;
        let output = controller.step(StepInput::new(Measurement { status, ..measurement(seq, &q) }, 0, None));
        assert!(!warns(&output, TripCause::DrivesStopped));
    }
}

#[test]
fn restarted_measurement() {
    let (mut controller, q) = enabled();
    controller.step(StepInput::new(measurement(1, &q), 0, None));
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::MeasurementRestarted, 0)));
    let another = StepInput { restarted: true, ..StepInput::new(measurement(1, &q), 0, None) };
    let (mut controller, _) = enabled();
    controller.step(another.clone());
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::MeasurementRestarted, 0)));
    let mut controller = Controller::new(&config());
    controller.step(another);
    assert_eq!((controller.mode(), controller.trip()), (Mode::Idle, None), "Idle stays Idle");
}

#[test]
fn law_not_finite() {
    let config = config();
    let (mut controller, q) = enabled();
    let mut plan = rest_plan(&config, &at_rest(&q), 1.0);
    (0..=plan.gains.intervals()).for_each(|k| plan.gains.knot_mut(k).fill(f64::NAN));
    controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
    let output = controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::LawNotFinite, 0)));
    assert_eq!((output.command.brake, output.command.tau), (1, [0.0; MOST_JOINTS]));
}

#[test]
fn the_limiter_cuts_and_says_so() {
    let config = config();
    let (mut controller, q) = enabled();
    let mut plan = rest_plan(&config, &at_rest(&q), 1.0);
    plan.trajectory.u.iter_mut().for_each(|u| u[0] = 1e4);
    controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
    // The way there takes a ms.
    (5..13).for_each(|seq| drop(controller.step(StepInput::new(measurement(seq, &q), 0, None))));
    let output = controller.step(StepInput::new(measurement(13, &q), 0, None));
    assert_eq!(output.command.tau[0], config.robot.limits.tau_max[0]);
    assert_ne!(output.record.telemetry.flags & Telemetry::LIMITED, 0);
}

/// The torque of a mode begins with that of the mode before, and changes at the warning level until it is its own.
#[test]
fn no_mode_begins_with_a_step() {
    let config = config();
    let q = rest_pose(&config);
    // A gain that answers the start below with 25 % of the torque of joint 1.
    let mut work = Workspace::default();
    let none = ActuatedVector::zeros(sizes());
    config.model.hybrid_dynamics(&at_rest(&q), &none, &mut work);
    let tau_max = config.robot.limits.tau_max;
    let inertia = config.model.reduced_inertia_times(&unit(0), &mut work)[0];
    let deviation = 0.04;
    let mut plan = rest_plan(&config, &at_rest(&q), 1.0);
    let gain = -0.25 * tau_max[0] / inertia / deviation;
    (0..=plan.gains.intervals()).for_each(|k| plan.gains.knot_mut(k)[0] = gain);
    let mut away = q;
    away[0] += deviation;

    let mut controller = Controller::new(&config);
    let (mut seq, mut last) = (0, none);
    let mut cycles = |controller: &mut Controller, mut request: Option<StepRequest>, n: usize| {
        let mut outputs = Vec::new();
        for _ in 0..n {
            seq += 1;
            let output = controller.step(StepInput::new(measurement(seq, &away), 0, request.take()));
            assert!(output.answer.as_ref().is_none_or(Result::is_ok), "{:?}", output.answer);
            let tau = output.command.torque(sizes()).unwrap();
            for i in 0..tau.len() {
                let share = (tau[i] - last[i]).abs() / tau_max[i];
                assert!(share <= 0.125 + 1e-12, "cycle {seq}, joint {}: {share}", i + 1);
            }
            last = tau;
            outputs.push(output);
        }
        let limited: Vec<_> =
            outputs.iter().map(|o| o.record.telemetry.flags & Telemetry::LIMITED != 0).collect();
        (last, limited)
    };
    // The brakes held.
    let request = Some(StepRequest::Enable);
    let (held, _) = cycles(&mut controller, request, 20);
    let gravity = config.model.torque(&at_rest(&away), &none, &mut work);
    assert!((held - gravity).amax() < 1e-6, "{held:?}");
    cycles(&mut controller, Some(StepRequest::Load(plan)), 1);
    let (tracked, limited) = cycles(&mut controller, Some(StepRequest::Start(7)), 20);
    assert_eq!(controller.mode(), Mode::Track);
    assert!((tracked - gravity)[0] / tau_max[0] < -0.2, "{tracked:?}");
    // 12.5 % per cycle; what it takes is on its way in all of them but the last.
    let steps = (tracked - gravity).component_div(&tau_max).amax() / 0.125;
    assert!(steps > 2.0, "{steps}");
    let on_the_way = |limited: Vec<bool>| limited.iter().filter(|limited| **limited).count();
    assert_eq!(on_the_way(limited), steps.ceil() as usize - 1);
    let (stopped, limited) = cycles(&mut controller, Some(StepRequest::Stop), 20);
    assert_eq!(controller.mode(), Mode::Stop);
    // But for what the estimate of disturbances makes of an arm that does not move.
    assert!((stopped - gravity).amax() < 5.0, "{stopped:?}");
    assert!((2..=8).contains(&on_the_way(limited)));
}

/// Noise through gains that no drive can follow is not taken for a mode that begins.
#[test]
fn a_mode_begins_for_two_milliseconds_at_most() {
    let config = config();
    let (mut controller, mut q) = enabled();
    let mut plan = rest_plan(&config, &at_rest(&q), 1.0);
    (0..=plan.gains.intervals()).for_each(|k| plan.gains.knot_mut(k)[0] = -1e7);
    controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
    q[0] += 1e-4;
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
    let mut seq = 4;
    while controller.mode() == Mode::Track {
        seq += 1;
        q[0] += if seq % 2 == 0 { 2e-4 } else { -2e-4 };
        controller.step(StepInput::new(measurement(seq, &q), 0, None));
        assert!(seq < 30);
    }
    assert_eq!(trip(&controller), Some((Mode::Fault, TripCause::TorqueRate, 0)));
    // 2 / (1 / ms) are 16 cycles.
    assert_eq!(seq, 4 + 16);
}

#[test]
fn tracking_error() {
    let config = config();
    let (mut controller, mut q) = enabled();
    let plan = rest_plan(&config, &at_rest(&q), 10.0);
    controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
    let mut seq = 4;
    let mut warned = None;
    while controller.mode() == Mode::Track {
        seq += 1;
        q[8] += 1e-3;
        let output = controller.step(StepInput::new(measurement(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::TrackingError).then_some(q[8]));
    }
    assert!(warned.is_some_and(|error| (error - 0.25).abs() < 2e-3), "{warned:?}");
    assert_eq!(trip(&controller), Some((Mode::Stop, TripCause::TrackingError, 8)));
    assert!((controller.trip().unwrap().value - 0.5).abs() < 2e-3);
}

#[test]
fn balance_lost() {
    // The arm would have to move too fast before that.
    let mut config = config();
    config.daemon.limits.balance_speed = Level { warn: 1e3, trip: 1e4 };
    let (mut controller, mut q) = balancing(&config);
    let (mut seq, before) = (10, q[8]);
    let mut warned = None;
    while controller.mode() == Mode::Balance {
        seq += 1;
        q[8] += 1e-3;
        let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::BalanceLost).then_some((q[8] - before).to_degrees()));
    }
    assert!(warned.is_some_and(|deg| (deg - 10.0).abs() < 0.1), "{warned:?}");
    assert_eq!(
        trip(&controller).map(|(mode, cause, _)| (mode, cause)),
        Some((Mode::Stop, TripCause::BalanceLost))
    );
    assert!(((q[8] - before).to_degrees() - 25.0).abs() < 0.1, "{}", (q[8] - before).to_degrees());
}

#[test]
fn balance_speed() {
    let (mut controller, mut q) = balancing(&config());
    let (mut seq, before) = (10, q[8]);
    let mut warned = None;
    while controller.mode() == Mode::Balance {
        seq += 1;
        // 1 rad/s.
        q[8] += common::PERIOD;
        let output = controller.step(StepInput::new(flickering(seq, &q), 0, None));
        warned = warned.or(warns(&output, TripCause::BalanceSpeed).then_some(controller.mode()));
    }
    assert_eq!(warned, Some(Mode::Balance));
    let Some((Mode::Stop, TripCause::BalanceSpeed, joint)) = trip(&controller) else {
        panic!("{:?}", controller.trip());
    };
    let Trip { value, limit, .. } = *controller.trip().unwrap();
    assert_eq!(limit, config().robot.limits.qd_max[joint]);
    assert!(value.abs() > limit && value.abs() < 1.02 * limit, "{value} rad/s, limit {limit}");
    assert!((q[8] - before).to_degrees() < 5.0, "long before the rod has fallen");
}

#[test]
fn pendulum_range() {
    // A balance that is never lost, so that joint 8 comes to 180 + 20 + 5 deg.
    let mut config = config();
    config.daemon.limits.balance_distance.trip = 4.0;
    config.daemon.limits.balance_speed.trip = 1e4;
    let mut q = upright_pose();
    let mut controller = Controller::new(&config);
    let plan = rest_plan(&config, &at_rest(&q), 0.0005);
    let requests = [StepRequest::Enable, StepRequest::Load(plan), StepRequest::Start(7)];
    let mut seq = 0;
    for request in requests {
        seq += 1;
        controller.step(StepInput::new(flickering(seq, &q), 0, Some(request)));
    }
    while matches!(controller.mode(), Mode::Track | Mode::Balance) {
        seq += 1;
        q[7] += if controller.mode() == Mode::Balance { 1e-3 } else { 0.0 };
        controller.step(StepInput::new(flickering(seq, &q), 0, None));
    }
    assert_eq!(trip(&controller), Some((Mode::Stop, TripCause::PendulumRange, 7)));
    assert!((q[7].to_degrees() - 205.0).abs() < 0.1, "{}", q[7].to_degrees());
}

#[test]
fn no_measurement_and_unready_drives_refuse_enable() {
    let config = config();
    let mut controller = Controller::new(&config);
    let enable = || Some(StepRequest::Enable);
    let output = controller.step(StepInput::new(Measurement::default(), 0, enable()));
    let answer = output.answer;
    assert!(
        matches!(answer, Some(Err(RequestRefusal::Unfit(trip))) if trip.cause == TripCause::NoMeasurement),
        "{answer:?}"
    );
    // Refusal and status name what has to be done first, and then the request.
    let told = |refusal: RequestRefusal, readiness: Readiness, remedy: &str| {
        assert_eq!(refusal.remedy(), Some(remedy));
        assert_eq!(refusal.readiness(), readiness);
        let text = refusal.text(&config.model);
        assert!(text.ends_with(&format!("next: {remedy}, then upswing request enable")), "{text}");
    };
    told(output.record.unready.expect("a reason"), Readiness::NoMeasurement, "start a plant");
    let mut unready = measurement(1, &rest_pose(&config));
    unready.status = 0;
    let output = controller.step(StepInput::new(unready, 0, enable()));
    assert_eq!(output.answer, Some(Err(RequestRefusal::DrivesNotReady)));
    assert_eq!(controller.mode(), Mode::Idle);
    told(output.record.unready.expect("a reason"), Readiness::DrivesNotReady, "switch the drives on");
    let ready = controller.step(StepInput::new(measurement(2, &rest_pose(&config)), 0, None));
    assert_eq!(ready.record.unready, None);
    assert_eq!(
        controller.step(StepInput::new(measurement(3, &rest_pose(&config)), 0, enable())).answer,
        Some(Ok(()))
    );
}

#[test]
fn stuck_encoder() {
    let config = config();
    for stuck in [true, false] {
        let (mut controller, q) = enabled();
        let mut plan = rest_plan(&config, &at_rest(&q), 1.0);
        plan.trajectory.u.iter_mut().for_each(|u| u[0] = 10.0);
        controller.step(StepInput::new(measurement(3, &q), 0, Some(StepRequest::Load(plan))));
        controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Start(7))));
        for seq in 5..400 {
            let next = if stuck { measurement(seq, &q) } else { flickering(seq, &q) };
            controller.step(StepInput::new(next, 0, None));
        }
        let expected = stuck.then_some((Mode::Fault, TripCause::StuckEncoder, 0));
        assert_eq!(trip(&controller), expected);
        if stuck {
            let text = controller.trip().map(|trip| trip.text(&config.model)).unwrap_or_default();
            assert!(text.contains("joint `joint_1` has not changed for 0.0"), "{text}");
        }
    }
}

#[test]
fn a_robot_that_stands_has_no_stuck_encoder() {
    let (mut controller, q) = enabled();
    for seq in 3..80_000 {
        controller.step(StepInput::new(measurement(seq, &q), 0, None));
    }
    assert_eq!((controller.mode(), controller.trip()), (Mode::Hold, None));
}
