//! A plan begins at its activation time, and only the plan that `start` names.

mod common;

use common::{Arm, PERIOD, PERIOD_NS, at_rest, config, measurement, message, rest_pose, resting, swing};
use std::time::Instant;
use upswing_config::Config;
use upswing_ipc::{Clock, ManoeuvreRequest, Mode, PlannerRequest, Telemetry};
use upswing_model::JointVector;
use upswing_planner::replan::Planner;
use upswing_planner::service::RequestHandler;
use upswing_trajectory::Plan;
use upswingd::controller::Controller;
use upswingd::plan::accept;
use upswingd::step::{StepInput, StepRequest};
use upswingd::supervisor::RequestRefusal;
use upswingd::trip::TripCause;

/// In Hold at `q`, cycle 3.
fn holding(config: &Config, q: &JointVector) -> Controller {
    let mut controller = Controller::new(config);
    for seq in 1..=3 {
        let request = (seq == 2).then_some(StepRequest::Enable);
        controller.step(StepInput::new(measurement(seq, q), 0, request));
    }
    assert_eq!(controller.mode(), Mode::Hold);
    controller
}

/// Stays at `q` for a second from `activation_ns` on.
fn rest_plan(config: &Config, q: &JointVector, activation_ns: u64) -> Box<Plan> {
    let activation_ns = Some(activation_ns).filter(|ns| *ns != 0);
    accept(&message(&Plan { activation_ns, ..resting(config, &at_rest(q), 1.0) }), config).unwrap()
}

#[test]
fn a_start_names_its_plan() {
    let config = config();
    let q = rest_pose(&config);
    let mut controller = holding(&config, &q);
    controller.step(StepInput::new(
        measurement(4, &q),
        0,
        Some(StepRequest::Load(rest_plan(&config, &q, 0))),
    ));
    for (seq, id) in [(5, 0), (6, 8), (7, u64::MAX)] {
        let output = controller.step(StepInput::new(measurement(seq, &q), 0, Some(StepRequest::Start(id))));
        assert_eq!(output.answer, Some(Err(RequestRefusal::OtherPlan { asked: id, loaded: 7 })));
        assert_eq!(controller.mode(), Mode::Hold);
    }
    let output = controller.step(StepInput::new(measurement(8, &q), 0, Some(StepRequest::Start(7))));
    assert_eq!((output.answer, controller.mode()), (Some(Ok(())), Mode::Track));
}

#[test]
fn time_of_a_plan_runs_from_its_activation_and_otherwise_from_its_start() {
    let config = config();
    let q = rest_pose(&config);
    let load = |activation_ns| {
        let mut controller = holding(&config, &q);
        controller.step(StepInput::new(
            measurement(4, &q),
            0,
            Some(StepRequest::Load(rest_plan(&config, &q, activation_ns))),
        ));
        controller
    };
    let start = |controller: &mut Controller, seq| {
        let output = controller.step(StepInput::new(measurement(seq, &q), 0, Some(StepRequest::Start(7))));
        (output.answer.unwrap(), output.record.telemetry)
    };
    // Whenever it is started.
    let (answer, telemetry) = start(&mut load(0), 20);
    assert_eq!((answer, telemetry.t_plan), (Ok(()), 0.0));
    // Too early, to the cycle, and late.
    let activation = 20 * PERIOD_NS;
    let mut controller = load(activation);
    let (answer, telemetry) = start(&mut controller, 19);
    assert_eq!(answer, Err(RequestRefusal::BeforeActivation { wait: PERIOD_NS as f64 * 1e-9 }));
    assert_eq!(telemetry.mode(), Ok(Mode::Hold));
    for (late, seq) in [(0_u64, 20), (16, 36)] {
        let (answer, telemetry) = start(&mut controller.clone(), seq);
        assert_eq!(answer, Ok(()));
        assert!((telemetry.t_plan - late as f64 * PERIOD).abs() < 1e-12, "{}", telemetry.t_plan);
    }
    // A moment that no clock reaches.
    let (answer, _) = start(&mut load(u64::MAX), 20);
    assert!(matches!(answer, Err(RequestRefusal::BeforeActivation { .. })));
}

#[test]
fn a_late_start_has_to_be_where_the_plan_is_by_then() {
    let config = config();
    let q = rest_pose(&config);
    let (up, _) = swing(&config, &q);
    let id = up.id;
    let seconds = |t: f64| (t / PERIOD) as u64;
    let mut controller = holding(&config, &q);
    let plan = Box::new(Plan { activation_ns: Some(4 * PERIOD_NS), ..*up });
    controller.step(StepInput::new(measurement(4, &q), 0, Some(StepRequest::Load(plan.clone()))));
    // Two cycles later the robot is as good as there; half a second later the plan has moved on.
    let mut soon = controller.clone();
    soon.step(StepInput::new(measurement(6, &q), 0, Some(StepRequest::Start(id)))).answer.unwrap().unwrap();
    for seq in 5..4 + seconds(0.5) {
        controller.step(StepInput::new(measurement(seq, &q), 0, None));
    }
    let m = measurement(4 + seconds(0.5), &q);
    let answer = controller.step(StepInput::new(m, 0, Some(StepRequest::Start(id)))).answer.unwrap();
    let Err(RequestRefusal::StartMismatch { joint, velocity, expected, t_plan, .. }) = answer else {
        panic!("{answer:?}")
    };
    assert!((t_plan - 0.5).abs() < 1e-9);
    let x = plan.reference(0.5).x;
    assert_eq!(expected, if velocity { x.qd()[joint] } else { x.q()[joint] });
    assert_eq!(controller.mode(), Mode::Hold);
}

/// A plan from a swinging pendulum, on a clock that runs on while it is made: the state at its activation is the predicted
/// one, and it ends in balance.
#[test]
fn a_predicted_start_is_met_and_ends_balanced() {
    let config = config();
    let q = rest_pose(&config);
    let planner = Planner::new(config.clone()).unwrap();
    let mut x = at_rest(&q);
    x[7] += 0.15;
    let mut arm = Arm::new(&config, x);
    let mut controller = Controller::new(&config);
    let mut cycle = |request: Option<StepRequest>| -> (Telemetry, Option<Result<(), RequestRefusal>>) {
        let measurement = arm.measure();
        let output = controller.step(StepInput::new(measurement, 0, request));
        arm.advance(&output.command);
        // Phase times tell the planner that no lock-step holds time for it.
        (Telemetry { clock: Clock::Paced.code(), ..output.record.telemetry }, output.answer)
    };
    cycle(None);
    cycle(Some(StepRequest::Enable));
    let mut newest = Telemetry::default();
    for _ in 0..2500 {
        newest = cycle(None).0;
    }
    assert!(newest.qd[7].abs() > 0.1, "the pendulum swings: {} rad/s", newest.qd[7]);

    let mut handler = RequestHandler::new(&planner);
    // On a busy machine a plan may be late; the next one looks further ahead.
    let plan = (0..100).find_map(|_| {
        handler.observe(newest, Instant::now());
        handler.answer(&PlannerRequest::from_now(ManoeuvreRequest::new("swing-up", &[]).unwrap()), &|| true).1
    });
    let plan = accept(&message(&plan.expect("a plan")), &config).unwrap();
    let (id, t_f, x_0) = (plan.id, plan.trajectory.t_f, plan.trajectory.x[0]);
    let activation = plan.activation_ns.expect("a moving start has its moment");
    assert!(activation > newest.t_ns);
    let (mut request, mut early) = (Some(StepRequest::Load(plan)), false);
    while newest.t_ns + PERIOD_NS < activation {
        let (telemetry, answer) = cycle(request.take());
        newest = telemetry;
        if !early {
            assert_eq!(answer, Some(Ok(())), "loaded");
            early = true;
            let (telemetry, answer) = cycle(Some(StepRequest::Start(id)));
            newest = telemetry;
            assert!(matches!(answer, Some(Err(RequestRefusal::BeforeActivation { .. }))), "{answer:?}");
        }
    }
    let (telemetry, answer) = cycle(Some(StepRequest::Start(id)));
    assert_eq!(answer, Some(Ok(())));
    assert!(telemetry.t_plan < PERIOD, "t = {} s", telemetry.t_plan);
    for i in 0..x_0.q().len() {
        let off = (telemetry.q[i] - x_0.q()[i], telemetry.qd[i] - x_0.qd()[i]);
        // The velocity filter lags behind an accelerating pendulum.
        let tolerance = &config.daemon.start;
        assert!(
            off.0.abs() < 0.1 * tolerance.position[i] && off.1.abs() < 0.25 * tolerance.velocity[i],
            "joint {}: {off:?} rad, rad/s",
            i + 1
        );
    }
    for _ in 0..((t_f + 0.5) / PERIOD) as u64 {
        newest = cycle(None).0;
    }
    assert_eq!(newest.mode(), Ok(Mode::Balance));
}

#[test]
fn a_plan_that_cannot_start_where_the_robot_is_gives_no_warning_of_its_age() {
    let config = config();
    let q = rest_pose(&config);
    let mut elsewhere = q;
    elsewhere[0] += 0.2;
    // Beyond the level of 60 s.
    let seq = (61.0 / PERIOD) as u64;
    let aged = |q_plan: &JointVector| {
        let mut controller = Controller::new(&config);
        controller.step(StepInput::new(
            measurement(1, &q),
            0,
            Some(StepRequest::Load(rest_plan(&config, q_plan, 0))),
        ));
        controller.step(StepInput::new(measurement(seq, &q), 0, Some(StepRequest::Enable)));
        let telemetry = controller.step(StepInput::new(measurement(seq + 1, &q), 0, None)).record.telemetry;
        assert_eq!(telemetry.mode(), Ok(Mode::Hold));
        telemetry.warnings & TripCause::PlanAge.bit() != 0
    };
    assert!(aged(&q));
    assert!(!aged(&elsewhere));
}
