//! A manoeuvre without a database is solved by the full optimisation: the given values are met, from rest to rest, in the posture of the
//! settings.

use upswing_config::{Config, PendulumStart};
use upswing_model::{State, Workspace};
use upswing_planner::database::standing;
use upswing_planner::offline::target;
use upswing_planner::replan::{Effort, Method, Planner};

const START_DEG: [f64; 7] = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];

fn planner() -> Planner {
    let config = Config::embedded().expect("embedded settings");
    Planner::with_entries(config, 0, "nothing".into(), Vec::new()).expect("a planner")
}

/// Number of a manoeuvre of the settings.
fn number(planner: &Planner, name: &str) -> usize {
    planner.config().manoeuvres.iter().position(|m| m.name == name).expect("a manoeuvre")
}

/// Plans a manoeuvre and checks the end of its plan; returns the end.
fn ends_as_asked(planner: &Planner, name: &str, given: &[f64], start: &State) -> State {
    let (config, manoeuvre) = (planner.config(), number(planner, name));
    let effort = Effort::iterations(config.planner.replan.iterations);
    let replan = planner.replan_with(&mut planner.solver(), manoeuvre, given, start, &effort);
    let replan = replan.unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!((replan.method, replan.entry.is_none()), (Method::Optimisation, true), "{name}");
    let end = *replan.trajectory.end();
    assert!((replan.trajectory.start() - start).amax() < 1e-6, "{name}");
    assert!(end.qd().amax() < 1e-6, "{name} does not end at rest");
    let posture = config.model.posture(&end.q(), &mut Workspace::default());
    assert_eq!(posture, config.manoeuvres[manoeuvre].end, "{name}");
    if config.manoeuvres[manoeuvre].reverses.is_none() {
        for row in target(config, manoeuvre, given).expect("a target") {
            assert!(row.residual(&end).abs() < 1e-6, "{name}: {row:?}");
        }
    }
    end
}

#[test]
fn from_hanging() {
    let planner = planner();
    let q_a = START_DEG.map(f64::to_radians);
    let start = planner.config().start_state(&q_a, PendulumStart::Rest).expect("a start");
    ends_as_asked(&planner, "swing-up", &[], &start);
    let given = [20.0, -10.0, -90.0].map(f64::to_radians);
    let end = ends_as_asked(&planner, "move", &given, &start);
    let hanging = planner.config().model.rest_position(&end.q(), &mut Workspace::default());
    assert!((hanging.expect("a rest position") - end.q()).amax() < 1e-6);
}

#[test]
fn from_standing() {
    let planner = planner();
    let q_a = planner.config().model.actuated_from_shown(&START_DEG).expect("seven joints");
    // The flange is horizontal in this pose.
    let start = standing(planner.config(), number(&planner, "carry"), &q_a).expect("a start");
    let carried = ends_as_asked(&planner, "carry", &[15.0_f64.to_radians()], &start);
    // Without an entry that says where it began, the arm ends in the pose in which it begins.
    let down = ends_as_asked(&planner, "swing-down", &[], &carried);
    assert!((down.q_a() - carried.q_a()).amax() < 1e-6);
}
