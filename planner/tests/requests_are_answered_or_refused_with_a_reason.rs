//! Answers of the planner process to valid and invalid requests, without shared memory.

use std::cell::Cell;
use std::time::{Duration, Instant};
use upswing_config::{Config, PendulumStart};
use upswing_ipc::operator::NextAction;
use upswing_ipc::{
    Clock, CycleVectors, ManoeuvreRequest, Mode, PlannerRequest, PlannerResponse, PlannerStatus, Telemetry,
};
use upswing_model::{ActuatedVector, JointVector, State};
use upswing_planner::replan::Planner;
use upswing_planner::service::RequestHandler;
use upswing_trajectory::Plan;

fn planner() -> Planner {
    Planner::new(Config::embedded().expect("embedded settings")).expect("the shipped database fits")
}

fn rest(planner: &Planner) -> State {
    let q = [-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0].map(f64::to_radians);
    planner.config().start_state(&q, PendulumStart::Rest).expect("a start at rest")
}

/// The end of a swing-up: upright, at rest.
fn end(planner: &Planner) -> State {
    *planner.entry(0, 17).expect("an entry").trajectory.end()
}

/// A telemetry record of the shipped arm at state `x` (rad, rad/s), with clock `lockstep` or a clock that runs.
fn record(planner: &Planner, x: &State, mode: Mode, lockstep: bool) -> Telemetry {
    let zero = ActuatedVector::zeros(x.sizes());
    let x_d = State::new(&x.q(), &JointVector::zeros(x.sizes()));
    let vectors = CycleVectors { x: *x, x_d, u_d: zero, u: zero, tau: zero, tau_measured: zero };
    let clock = if lockstep { Clock::Lockstep } else { Clock::Paced }.code();
    Telemetry { mode: mode.code(), clock, ..Telemetry::new(planner.config().model.order(), &vectors) }
}

/// A manoeuvre without given values.
fn named(name: &str) -> ManoeuvreRequest {
    ManoeuvreRequest::new(name, &[]).expect("a name")
}

fn from_now(manoeuvre: &str) -> PlannerRequest {
    PlannerRequest::from_now(named(manoeuvre))
}

/// A request for a swing-up from rest.
fn from_rest(planner: &Planner) -> PlannerRequest {
    PlannerRequest::from_state(named("swing-up"), planner.config().model.order(), &rest(planner))
}

fn ask(handler: &mut RequestHandler<'_>, request: &PlannerRequest) -> (PlannerResponse, Option<Plan>) {
    handler.answer(request, &|| true)
}

#[track_caller]
fn refused(answer: (PlannerResponse, Option<Plan>), status: PlannerStatus, part: &str) {
    let reason = answer.0.reason.as_str().expect("text").to_owned();
    assert_eq!(answer.0.status(), Ok(status), "{reason}");
    assert!(reason.contains(part), "`{reason}` does not say `{part}`");
    assert!(answer.1.is_none() && answer.0.plan_id == 0);
}

#[test]
fn a_plan_is_ready_while_the_arm_holds() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let x = rest(&planner);
    handler.observe(record(&planner, &x, Mode::Hold, false), Instant::now());
    handler.prepare(&|| true);
    let (answer, plan) = ask(&mut handler, &from_now("swing-up"));
    assert_eq!(answer.reason.as_str(), Ok("ready before it was asked for"));
    let plan = plan.expect("a plan");
    assert_eq!(answer.plan_id, plan.id);
    assert!((plan.trajectory.x[0] - x).amax() < 1e-6);

    // The prepared plan serves a slightly different start, but not one farther away.
    for (shift, ready) in [(1e-4, true), (1e-2, false)] {
        let mut moved = x;
        moved[1] += shift;
        handler.observe(record(&planner, &moved, Mode::Hold, false), Instant::now());
        let (answer, plan) = ask(&mut handler, &from_now("swing-up"));
        assert_eq!(answer.reason.as_str().expect("text").starts_with("ready"), ready, "moved by {shift}");
        assert!((plan.expect("a plan").trajectory.x[0] - moved).amax() < 2e-4);
    }
}

#[test]
fn in_lockstep_a_plan_begins_with_the_state_of_the_record() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut x = rest(&planner);
    x.qd_u_mut()[0] = 0.3;
    for moving in [false, true] {
        if !moving {
            x.qd_u_mut()[0] = 0.0;
        }
        handler.observe(record(&planner, &x, Mode::Hold, true), Instant::now());
        handler.prepare(&|| true);
        let (answer, plan) = ask(&mut handler, &from_now("swing-up"));
        assert_eq!(answer.reason.as_str(), Ok(""), "nothing is prepared in lockstep");
        assert!((plan.expect("a plan").trajectory.x[0] - x).amax() < 1e-6);
    }
}

#[test]
fn a_moving_start_is_predicted_for_the_activation_of_its_plan() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut x = rest(&planner);
    x.qd_u_mut()[0] = 0.5;
    let now = Telemetry { t_ns: 3_000_000_000, ..record(&planner, &x, Mode::Hold, false) };
    // On a busy machine a plan may be late; the next one looks further ahead.
    let (answer, plan) = (0..100)
        .find_map(|_| {
            handler.observe(now, Instant::now());
            let (answer, plan) = ask(&mut handler, &from_now("swing-up"));
            plan.map(|plan| (answer, plan))
        })
        .expect("a plan");
    let activation = plan.activation_ns.expect("a moment");
    assert_eq!((answer.plan_id, answer.activation_ns), (plan.id, activation));
    let ahead = Duration::from_nanos(activation - now.t_ns);
    assert!(ahead >= planner.config().planner.replan.lead, "{ahead:?}");
    let start = plan.trajectory.x[0];
    // The pendulum has moved on by about its speed times the lead; the arm still holds.
    let swung = start.q_u()[0] - x.q_u()[0];
    let want = 0.5 * ahead.as_secs_f64();
    assert!(swung > 0.5 * want && swung < 1.5 * want, "swung by {swung} rad instead of about {want}");
    assert!((start.q_a() - x.q_a()).amax() < 1e-2);
}

#[test]
fn a_pendulum_that_turns_round_is_not_at_rest() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut x = rest(&planner);
    x.q_u_mut()[0] += 10_f64.to_radians();
    handler.observe(record(&planner, &x, Mode::Hold, false), Instant::now());
    // No plan is prepared for a state that does not last.
    handler.prepare(&|| true);
    let mut reason = String::new();
    let plan = (0..100).find_map(|_| {
        handler.observe(record(&planner, &x, Mode::Hold, false), Instant::now());
        let (answer, plan) = ask(&mut handler, &from_now("swing-up"));
        reason = answer.reason.to_string();
        plan
    });
    let plan = plan.expect(&reason);
    assert!(plan.activation_ns.is_some());
    let start = plan.trajectory.x[0];
    // The pendulum falls back during the lead.
    assert!(start.q_u()[0] < x.q_u()[0] - 1e-3, "{start:?}");
}

#[test]
fn a_swing_down_begins_upright_and_ends_hanging_at_rest() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut upright = end(&planner);
    upright[1] += 0.02;
    upright[5] -= 0.01;
    handler.observe(record(&planner, &upright, Mode::Balance, false), Instant::now());
    let (answer, plan) = ask(&mut handler, &from_now("swing-down"));
    assert_eq!(answer.status(), Ok(PlannerStatus::Solved), "{:?}", answer.reason.as_str());
    let trajectory = plan.expect("a plan").trajectory;
    assert!((trajectory.x[0] - upright).amax() < 1e-6);
    assert!(answer.defect <= 1e-6, "defect {:e}", answer.defect);
    assert!(answer.margin_q >= 0.0 && answer.margin_qd >= 0.0 && answer.margin_tau >= 0.0, "{answer:?}");
    let end = trajectory.end();
    assert!(end.qd().amax() < 1e-7, "not at rest");
    let q = end.q();
    let hanging = planner.config().model.rest_position(&q, &mut upswing_model::Workspace::default());
    assert!((hanging.expect("a rest pose") - q).amax() < 1e-6, "not hanging");
}

#[test]
fn from_another_mode_or_without_a_daemon() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    refused(ask(&mut handler, &from_now("swing-up")), PlannerStatus::NotReady, "is upswingd running");
    for mode in Mode::ALL.iter().copied() {
        for (manoeuvre, needed) in [("swing-up", Mode::Hold), ("swing-down", Mode::Balance)] {
            let x = if mode == Mode::Balance { end(&planner) } else { rest(&planner) };
            handler.observe(record(&planner, &x, mode, false), Instant::now());
            let answer = ask(&mut handler, &from_now(manoeuvre));
            let next = mode.next_action(|start| planner.config().first_manoeuvre(start));
            if mode == needed {
                assert!(answer.1.is_some(), "{manoeuvre} in {mode}: {:?}", answer.0.reason);
                assert_eq!(next, NextAction::Manoeuvre(Some(manoeuvre)));
            } else {
                refused(answer, PlannerStatus::NotReady, &format!("next: {next}"));
            }
        }
    }
}

#[test]
fn from_a_daemon_that_has_fallen_silent() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut moving = rest(&planner);
    moving.qd_u_mut()[0] = 0.5;
    let long_ago = Instant::now().checked_sub(Duration::from_secs(6)).expect("the clock runs for longer");
    let reason = "no telemetry from the daemon for some seconds";
    for (x, mode, manoeuvre) in
        [(moving, Mode::Hold, "swing-up"), (end(&planner), Mode::Balance, "swing-down")]
    {
        handler.observe(record(&planner, &x, mode, false), long_ago);
        refused(ask(&mut handler, &from_now(manoeuvre)), PlannerStatus::NotReady, reason);
    }
    // No plan is prepared from old telemetry either.
    handler.observe(record(&planner, &rest(&planner), Mode::Hold, false), long_ago);
    handler.prepare(&|| true);
    handler.observe(record(&planner, &rest(&planner), Mode::Hold, false), Instant::now());
    let (answer, _) = ask(&mut handler, &from_now("swing-up"));
    assert_eq!(answer.reason.as_str(), Ok(""));
    // In lockstep the clock stands still while a plan is made.
    handler.observe(record(&planner, &moving, Mode::Hold, true), long_ago);
    assert!(ask(&mut handler, &from_now("swing-up")).1.is_some());
}

#[test]
fn from_a_record_that_the_client_knows_of_before_the_planner() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let known = |seq| PlannerRequest { known_seq: seq, ..from_now("swing-up") };
    let held = |seq| Telemetry { seq, ..record(&planner, &rest(&planner), Mode::Hold, true) };
    handler.observe(held(1999), Instant::now());
    refused(
        ask(&mut handler, &known(2000)),
        PlannerStatus::NotReady,
        "expected record 2000 or a later one, got 1999",
    );
    assert!(ask(&mut handler, &known(1999)).1.is_some());
    handler.observe(held(2001), Instant::now());
    assert!(ask(&mut handler, &known(2000)).1.is_some());
}

#[test]
fn nonsense() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let good = from_rest(&planner);
    let with = |change: &dyn Fn(&mut PlannerRequest)| {
        let mut request = good;
        change(&mut request);
        request
    };
    refused(ask(&mut handler, &with(&|r| r.kind = 99)), PlannerStatus::BadRequest, "99");
    refused(ask(&mut handler, &with(&|r| r.iterations = 101)), PlannerStatus::BadRequest, "got 101");
    refused(
        ask(&mut handler, &with(&|r| r.q[3] = f64::NAN)),
        PlannerStatus::BadRequest,
        "position of joint `joint_4`",
    );
    refused(
        ask(&mut handler, &with(&|r| r.q[1] = 9.0)),
        PlannerStatus::StartOutsideLimits,
        "position of joint `joint_2`",
    );
    refused(
        ask(&mut handler, &with(&|r| r.qd[0] = 9.0)),
        PlannerStatus::StartOutsideLimits,
        "velocity of joint `joint_1`",
    );
    refused(ask(&mut handler, &with(&|r| r.joints = 3)), PlannerStatus::BadRequest, "3 joints");
    refused(ask(&mut handler, &with(&|r| r.actuated = u64::MAX)), PlannerStatus::BadRequest, "actuated");
    assert!(ask(&mut handler, &good).1.is_some());
}

#[test]
fn manoeuvres_and_values_that_the_system_does_not_know() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let mut refuse = |name: &str, given: &[f64], part: &str| {
        let manoeuvre = ManoeuvreRequest::new(name, given).expect("a name");
        let request = PlannerRequest { manoeuvre, ..from_rest(&planner) };
        refused(ask(&mut handler, &request), PlannerStatus::BadRequest, part);
    };
    refuse("fly", &[], "unknown manoeuvre `fly`: this system has `swing-up`, `swing-down`, `move`");
    refuse("swing-up", &[0.5], "expected values of the joints none, got 1");
    refuse("move", &[0.5], "expected values of the joints `joint_1`, `joint_2`, `joint_4`, got 1");
    refuse(
        "move",
        &[0.5, 9.0, 0.5],
        "target of joint `joint_2`: expected -120.000 to 120.000 deg, got 515.662 deg",
    );
    refuse("move", &[f64::INFINITY, 0.0, 0.5], "target of joint `joint_1`");
    let nameless = PlannerRequest { manoeuvre: ManoeuvreRequest::default(), ..from_rest(&planner) };
    refused(ask(&mut handler, &nameless), PlannerStatus::BadRequest, "unknown manoeuvre ``");
    let manoeuvre = ManoeuvreRequest { number: u64::MAX, ..named("move") };
    let boundless = PlannerRequest { manoeuvre, ..from_rest(&planner) };
    refused(ask(&mut handler, &boundless), PlannerStatus::BadRequest, "got 18446744073709551615");
}

#[test]
fn telemetry_of_another_chain() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let foreign = Telemetry { joints: 3, ..record(&planner, &rest(&planner), Mode::Hold, false) };
    handler.observe(foreign, Instant::now());
    handler.prepare(&|| true);
    let answer = ask(&mut handler, &from_now("swing-up"));
    refused(answer, PlannerStatus::NotReady, "telemetry of 3 joints");
}

#[test]
fn a_plan_is_called_solved_only_where_its_defect_is_within_the_setting() {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.replan.iterations = 1;
    let planner = Planner::new(config).expect("the shipped database fits");
    let mut handler = RequestHandler::new(&planner);
    let request = from_rest(&planner);
    let (answer, plan) = ask(&mut handler, &request);
    assert_eq!(answer.status(), Ok(PlannerStatus::OpenDefect));
    assert!(plan.is_some() && answer.defect > planner.config().planner.replan.defect);
    assert!(answer.reason.as_str().expect("text").starts_with("defect"), "{:?}", answer.reason.as_str());
    let (answer, _) = ask(&mut handler, &PlannerRequest { iterations: 10, ..request });
    assert_eq!(answer.status(), Ok(PlannerStatus::Solved));
}

#[test]
fn a_plan_that_nobody_waits_for_any_more_is_given_up() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let request = from_rest(&planner);
    let asked = Cell::new(0);
    let wanted = || {
        asked.set(asked.get() + 1);
        asked.get() < 4
    };
    refused(handler.answer(&request, &wanted), PlannerStatus::Infeasible, "cancelled before QP 1");
    // Planning stops at once, with one more check per neighbour at most.
    assert!(asked.get() <= 4 + planner.config().planner.replan.neighbours);
}

#[test]
fn a_budget_that_is_too_short() {
    let planner = planner();
    let mut handler = RequestHandler::new(&planner);
    let request = PlannerRequest { budget_ms: 1, iterations: 100, ..from_rest(&planner) };
    refused(ask(&mut handler, &request), PlannerStatus::Deadline, "time budget");
}
