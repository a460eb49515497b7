//! Where the structured QP solver makes no progress, Clarabel solves the QP: plan, answer and status of the
//! planner report it.

use upswing_config::{Config, PendulumStart};
use upswing_ipc::{ManoeuvreRequest, PlannerKind, PlannerRequest, PlannerStatus};
use upswing_model::State;
use upswing_ocp::qp::QpStatus;
use upswing_planner::replan::{Effort, Planner, Replan};
use upswing_planner::service::RequestHandler;

/// The weights (17) of the settings times `factor`: the same solution, but the structured solver compares the products of
/// slacks and multipliers with an absolute bound, which it does not reach if the weights are large.
fn planner(factor: f64) -> Planner {
    let mut config = Config::embedded().expect("embedded settings");
    let settings = &mut config.planner.replan;
    settings.weight_t_f *= factor;
    settings.weight_q *= factor;
    settings.weight_qd *= factor;
    settings.weight_u *= factor;
    Planner::new(config).expect("the shipped database fits")
}

/// A start state at rest near a database entry, rad.
fn start(planner: &Planner) -> State {
    let q = [44.0, 0.0, 0.0, -90.0, 0.0, 20.0, 0.0].map(f64::to_radians);
    planner.config().start_state(&q, PendulumStart::Rest).expect("a start at rest")
}

/// A plan from QPs, without the full optimisation.
fn plan(planner: &Planner) -> Replan {
    let effort = Effort { optimise: false, ..Effort::iterations(planner.config().planner.replan.iterations) };
    let replan = planner.replan_with(&mut planner.solver(), 0, &[], &start(planner), &effort);
    replan.unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_plan_with_weights_that_the_structured_solver_cannot_handle_is_the_same() {
    let (usual, scaled) = (plan(&planner(1.0)), plan(&planner(1e6)));
    assert_eq!(usual.statistics.second_opinions, []);
    let opinions = &scaled.statistics.second_opinions;
    assert!(!opinions.is_empty() && opinions.len() <= scaled.iterations, "{opinions:?}");
    let entry = scaled.entry.map(|entry| entry.index);
    assert!(opinions.iter().all(|o| o.clarabel == QpStatus::Solved && Some(o.entry) == entry));
    assert_eq!(usual.entry, scaled.entry);
    let states = usual.trajectory.x.iter().zip(scaled.trajectory.x.iter());
    let difference = states.map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
    assert!(difference < 1e-4, "states differ by {difference:e} rad or rad/s");
}

#[test]
fn the_answer_names_it_and_the_status_counts_it() {
    let planner = planner(1e6);
    let mut handler = RequestHandler::new(&planner);
    let status = PlannerRequest { kind: PlannerKind::Status.code(), ..PlannerRequest::default() };
    let mut ask = |request: &PlannerRequest| {
        let (answer, _) = handler.answer(request, &|| true);
        assert_eq!(answer.status(), Ok(PlannerStatus::Solved));
        answer.reason.as_str().expect("text").to_owned()
    };
    assert!(!ask(&status).contains("Clarabel"));
    let order = planner.config().model.order();
    let answer = ask(&PlannerRequest::from_state(
        ManoeuvreRequest::new("swing-up", &[]).expect("a name"),
        order,
        &start(&planner),
    ));
    assert!(answer.contains("QPs solved by Clarabel"), "{answer}");
    let status = ask(&status);
    assert!(status.contains("Clarabel was asked for a second opinion on"), "{status}");
}
