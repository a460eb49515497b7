//! A plan that does not fit is refused with the check that failed and its numbers.

mod common;

use common::{at_rest, config, rest_payload, rest_plan, rest_pose, upright_pose};
use upswing_config::{Config, PlanWhileTracking};
use upswing_ipc::{Measurement, Plan as Payload};
use upswing_model::{NQ, State, Workspace};
use upswingd::controller::{Controller, Order};
use upswingd::plan::{PlanRefusal, accept};
use upswingd::supervisor::{Refusal, Request};
use upswingd::trip::TripCause;

fn rest() -> (Config, State) {
    let config = config();
    let x = at_rest(&rest_pose(&config));
    (config, x)
}

/// What is said about a good plan after `spoil`, sealed again.
fn refusal(spoil: impl Fn(&mut Payload)) -> PlanRefusal {
    let (config, x) = rest();
    let mut payload = rest_payload(&config, &x, 1.0);
    spoil(&mut payload);
    payload.seal();
    let refusal = accept(&payload, &config).unwrap_err();
    assert!(refusal.to_string().len() < 200, "fits into an answer: {refusal}");
    refusal
}

#[test]
fn a_good_plan_keeps_its_numbers() {
    let (config, x) = rest();
    let mut payload = rest_payload(&config, &x, 1.5);
    payload.k[3][1][4] = 2.5;
    payload.seal();
    let plan = accept(&payload, &config).unwrap();
    assert_eq!((plan.id, plan.trajectory.t_f, plan.trajectory.x[50]), (7, 1.5, x));
    assert_eq!(plan.gains[3][(1, 4)], 2.5);
    assert_eq!(plan.final_gain[(2, 2)], -100.0);
}

#[test]
fn checksum() {
    let (config, x) = rest();
    let mut payload = rest_payload(&config, &x, 1.0);
    payload.u[50][2] = 0.5;
    let text = accept(&payload, &config).unwrap_err().to_string();
    assert!(text.contains("checksum") && text.contains(&format!("{:016x}", payload.checksum)), "{text}");
}

#[test]
fn fingerprint() {
    let (config, _) = rest();
    let expected = config.model.fingerprint();
    let got = refusal(|p| p.fingerprint = 0xabc);
    assert_eq!(got, PlanRefusal::Fingerprint { expected, got: 0xabc });
    assert!(got.to_string().contains("0000000000000abc"));
}

#[test]
fn id_and_duration() {
    assert_eq!(refusal(|p| p.id = 0), PlanRefusal::Id);
    assert_eq!(refusal(|p| p.t_f = 0.0), PlanRefusal::Duration { got: 0.0 });
    assert!(refusal(|p| p.t_f = -1.0).to_string().contains("-1 s"));
    assert!(refusal(|p| p.t_f = f64::INFINITY).to_string().contains("inf"));
    assert!(matches!(refusal(|p| p.t_f = f64::NAN), PlanRefusal::Duration { .. }));
}

#[test]
fn numbers_that_are_not_finite() {
    for (part, refusal) in [
        ("x at knot 3", refusal(|p| p.x[3][17] = f64::NAN)),
        ("u at knot 100", refusal(|p| p.u[100][6] = f64::INFINITY)),
        ("f at knot 0", refusal(|p| p.f[0][0] = f64::NAN)),
        ("K at knot 51", refusal(|p| p.k[51][6][17] = f64::NEG_INFINITY)),
        ("the final K", refusal(|p| p.k_final[0][0] = f64::NAN)),
    ] {
        assert!(refusal.to_string().contains(part), "{refusal}");
    }
}

#[test]
fn limits_at_a_knot() {
    let text = refusal(|p| p.x[4][1] = 2.5).to_string();
    assert!(text.contains("position of joint 2 at knot 4 is 2.5000") && text.contains("2.0954"), "{text}");
    let text = refusal(|p| p.x[5][NQ + 3] = -0.8).to_string();
    assert!(text.contains("velocity of joint 4 at knot 5 is -0.8000"), "{text}");
    let text = refusal(|p| p.u[0][0] = 1000.0).to_string();
    assert!(text.contains("torque of joint 1 at knot 0 is") && text.contains("168.0000"), "{text}");
}

#[test]
fn limits_between_knots() {
    // Both knots are within the limits; between them the spline (12) leaves them by half an interval times f.
    let (config, x) = rest();
    let mut payload = rest_payload(&config, &x, 60.0);
    let fast = config.robot.planning.qd_max[1];
    for (k, velocity) in [(4, 0.9 * fast), (5, -0.9 * fast)] {
        payload.x[k][1] = config.robot.planning.q_max[1] - 0.01;
        payload.x[k][NQ + 1] = velocity;
        let state = State::from(payload.x[k]);
        let f = config.model.f(&state, &nalgebra::SVector::zeros(), &mut Workspace::default());
        payload.f[k] = f.into();
    }
    payload.seal();
    let text = accept(&payload, &config).unwrap_err().to_string();
    assert!(text.contains("position of joint 2 at knot 4.") || text.contains("at knot 3."), "{text}");
}

#[test]
fn a_final_gain_that_lets_the_rod_fall() {
    let config = config();
    let x = at_rest(&upright_pose());
    let mut payload = rest_payload(&config, &x, 1.0);
    accept(&payload, &config).unwrap();
    // The arm is held, the rod is nobody's concern.
    payload.k_final = [[0.0; 18]; 7];
    for i in 0..7 {
        (payload.k_final[i][i], payload.k_final[i][NQ + i]) = (-100.0, -20.0);
    }
    payload.seal();
    let refusal = accept(&payload, &config).unwrap_err();
    assert!(
        matches!(refusal, PlanRefusal::Unstable { radius } if radius > 1.0 && radius < 1.01),
        "{refusal}"
    );
    // So strong that one period overshoots.
    for i in 0..7 {
        payload.k_final[i][NQ + i] = -2.1 / common::PERIOD;
    }
    payload.seal();
    let text = accept(&payload, &config).unwrap_err().to_string();
    assert!(text.contains("unstable: spectral radius 1."), "{text}");
}

#[test]
fn an_old_plan() {
    let (config, x) = rest();
    let mut controller = Controller::new(&config);
    let q = upswing_model::position(&x);
    let seconds = |s: f64| (s / common::PERIOD) as u64;
    controller.step(&common::measurement(1, &q), 0, Some(Order::Load(rest_plan(&config, &x, 1.0))));
    let mut at = |s: f64| {
        let m = common::measurement(seconds(s), &q);
        controller.step(&m, 0, Some(Order::Do(Request::Enable)));
        let m = common::measurement(seconds(s) + 1, &q);
        let output = controller.step(&m, 0, Some(Order::Do(Request::Start)));
        let warned = output.record.telemetry.warnings & TripCause::PlanAge.bit() != 0;
        controller.step(&m, 0, Some(Order::Do(Request::Stop)));
        (output.answer.unwrap(), warned)
    };
    // The levels are 60 s and 600 s.
    let (answer, warned) = at(601.0);
    assert!(matches!(answer, Err(Refusal::PlanExpired { limit: 600.0, .. })), "{answer:?}");
    assert!(warned);
}

#[test]
fn a_plan_ages_by_the_clock_of_the_plant_that_is_there() {
    let (config, x) = rest();
    let q = upswing_model::position(&x);
    let seconds = |s: f64| (s / common::PERIOD) as u64;
    let start_after = |loaded_at: u64, restarts: bool, s: f64| {
        let mut controller = Controller::new(&config);
        let plan = rest_plan(&config, &x, 1.0);
        if loaded_at == 0 {
            // Before there is a plant, in the 1000th second of the machine.
            controller.step(&Measurement::default(), 1_000_000_000_000, Some(Order::Load(plan)));
        } else {
            controller.step(&common::measurement(loaded_at, &q), 0, Some(Order::Load(plan)));
        }
        if restarts {
            controller.restart_measurement();
        }
        controller.step(&common::measurement(1, &q), 0, None);
        let now = seconds(s);
        controller.step(&common::measurement(now, &q), 0, Some(Order::Do(Request::Enable)));
        let output = controller.step(&common::measurement(now + 1, &q), 0, Some(Order::Do(Request::Start)));
        output.answer.unwrap()
    };
    for (loaded_at, restarts) in [(0, false), (seconds(5000.0), true), (seconds(5000.0), false)] {
        let answer = start_after(loaded_at, restarts, 601.0);
        assert!(matches!(answer, Err(Refusal::PlanExpired { .. })), "{loaded_at}, {restarts}: {answer:?}");
        assert_eq!(start_after(loaded_at, restarts, 50.0), Ok(()), "{loaded_at}, {restarts}");
    }
}

#[test]
fn no_time_passes_before_there_is_a_plant() {
    let (config, _) = rest();
    let mut controller = Controller::new(&config);
    let order = Some(Order::Do(Request::Enable));
    let output = controller.step(&Measurement::default(), 1_000_000_000_000, order);
    assert!(output.answer.is_some_and(|answer| answer.is_err()));
    assert_eq!((output.record.telemetry.seq, output.record.telemetry.t_ns), (0, 0));
}

#[test]
fn a_plan_that_arrives_while_one_is_tracked() {
    let (config, x) = rest();
    for (setting, refused) in [(PlanWhileTracking::Queue, false), (PlanWhileTracking::Refuse, true)] {
        let mut config = config.clone();
        config.daemon.plan_while_tracking = setting;
        let mut controller = Controller::new(&config);
        let mut arm = common::Arm::new(&config, x);
        let mut step = |order| controller.step(&arm.measure(), 0, Some(order));
        for order in
            [Order::Do(Request::Enable), Order::Load(rest_plan(&config, &x, 1.0)), Order::Do(Request::Start)]
        {
            assert_eq!(step(order).answer, Some(Ok(())));
        }
        let output = step(Order::Load(rest_plan(&config, &x, 1.0)));
        let expected = if refused { Err(Refusal::Tracking { running: 7 }) } else { Ok(()) };
        assert_eq!(output.answer, Some(expected));
        assert_eq!((output.garbage.is_some(), output.record.telemetry.plan_id), (refused, 7));
    }
}

#[test]
fn derivatives_of_another_model() {
    let text = refusal(|p| p.f[9][12] += 0.01).to_string();
    assert!(text.contains("f at knot 9, row 12"), "{text}");
}

#[test]
fn an_end_that_neither_stands_nor_hangs() {
    let (config, x) = rest();
    let mut moving = x;
    moving[NQ] = 0.02;
    let text = accept(&rest_payload(&config, &moving, 1.0), &config).unwrap_err().to_string();
    assert!(text.contains("ends at 0.0200 rad/s") && text.contains("at most 0.01 rad/s"), "{text}");
    let mut leaning = x;
    leaning[8] += 0.3;
    let text = accept(&rest_payload(&config, &leaning, 1.0), &config).unwrap_err().to_string();
    assert!(text.contains("2.8416 rad from upright and 0.3000 rad from hanging"), "{text}");
    // Both ways to end are accepted.
    for q in [rest_pose(&config), upright_pose()] {
        accept(&rest_payload(&config, &at_rest(&q), 1.0), &config).unwrap();
    }
}

#[test]
fn start_elsewhere() {
    let (config, x) = rest();
    let mut controller = Controller::new(&config);
    let mut arm = common::Arm::new(&config, x);
    let mut step = |order| controller.step(&arm.measure(), 0, Some(order)).answer.unwrap();
    step(Order::Do(Request::Enable)).unwrap();
    assert_eq!(step(Order::Do(Request::Start)), Err(Refusal::NoPlan));
    let mut elsewhere = x;
    elsewhere[2] += 0.1;
    step(Order::Load(rest_plan(&config, &elsewhere, 1.0))).unwrap();
    let refusal = step(Order::Do(Request::Start)).unwrap_err();
    let expected = Refusal::StartMismatch {
        joint: 2,
        velocity: false,
        measured: x[2],
        expected: elsewhere[2],
        tolerance: config.daemon.start.position,
    };
    assert_eq!(refusal, expected);
    assert!(
        refusal.to_string().contains("joint 3 is at 0.0000 rad, the plan starts at 0.1000 rad"),
        "{refusal}"
    );
    let mut moving = rest_plan(&config, &x, 1.0);
    moving.trajectory.x[0][NQ] = 0.3;
    step(Order::Load(moving)).unwrap();
    let text = step(Order::Do(Request::Start)).unwrap_err().to_string();
    assert!(text.contains("joint 1") && text.contains("0.3000 rad/s"), "{text}");
}

#[test]
fn a_plan_with_missing_knots_is_not_loaded() {
    let (config, x) = rest();
    let mut plan = rest_plan(&config, &x, 1.0);
    plan.gains.pop();
    let mut controller = Controller::new(&config);
    let output = controller.step(&common::measurement(1, &rest_pose(&config)), 0, Some(Order::Load(plan)));
    assert_eq!(output.answer, Some(Err(Refusal::IncompletePlan)));
    assert!(output.garbage.is_some());
}
