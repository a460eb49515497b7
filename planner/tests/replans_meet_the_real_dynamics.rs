//! Replans from starts off the grid meet the nonlinear dynamics and keep every limit; one QP, the paper's mode,
//! leaves the defect of its linearisation; the answer names what was tried.

use std::time::Instant;
use upswing_config::{Config, PendulumStart};
use upswing_model::State;
use upswing_planner::replan::{Planner, Refusal};

fn planner() -> Planner {
    Planner::new(Config::embedded().expect("embedded settings")).expect("the shipped database fits")
}

fn start(planner: &Planner, degrees: [f64; 7]) -> State {
    let q = degrees.map(f64::to_radians);
    planner.config().start_state(&q, PendulumStart::Rest).expect("a start at rest")
}

const STARTS: [[f64; 7]; 3] = [
    [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0],
    [-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0],
    [20.0, 10.0, 0.0, -70.0, 0.0, 0.0, 0.0],
];

#[test]
fn with_the_default_number_of_linearisations() {
    let planner = planner();
    for degrees in STARTS {
        let x = start(&planner, degrees);
        let replan = planner.replan(&x, planner.config().planner.replan.iterations, None).expect("a plan");
        assert!(replan.defect <= 1e-6, "{degrees:?}: defect {:e}", replan.defect);
        assert!(replan.margins.smallest() >= -5e-3, "{degrees:?}: {:?}", replan.margins);
        assert!((replan.trajectory.x[0] - x).amax() <= 1e-7, "{degrees:?}: starts elsewhere");
        let end = replan.trajectory.x[100];
        assert!(
            (end[7] - std::f64::consts::PI).abs() <= 1e-7 && end[8].abs() <= 1e-7,
            "{degrees:?}: not upright"
        );
        assert!(end.fixed_rows::<9>(9).amax() <= 1e-7, "{degrees:?}: not at rest");
    }
}

#[test]
fn further_linearisations_close_the_defect() {
    let planner = planner();
    let x = start(&planner, STARTS[0]);
    let defect = |n| planner.replan(&x, n, None).expect("a plan").defect;
    let (one, four) = (defect(1), defect(4));
    assert!(one > 1e-3 && four < 1e-3 * one, "one QP leaves {one:e}, four leave {four:e}");
}

#[test]
fn an_entry_of_the_database_is_found_and_kept() {
    let planner = planner();
    let entry = 40;
    let x = planner.entries()[entry].trajectory.x[0];
    let replan = planner.replan(&x, 1, None).expect("a plan");
    let used = replan.attempts.last().expect("one attempt").entry;
    assert_eq!((used.index, used.distance), (entry, 0.0));
    let want = &planner.entries()[entry].trajectory;
    assert!((replan.trajectory.t_f - want.t_f).abs() < 1e-5);
}

#[test]
fn an_impossible_start_is_refused_with_the_reason_of_each_entry() {
    let planner = planner();
    let mut x = start(&planner, STARTS[0]);
    // At full speed towards its stop the arm cannot stay within it.
    x[1] = planner.config().robot.planning.q_max[1];
    x[10] = planner.config().robot.planning.qd_max[1];
    let refusal = planner.replan(&x, 2, None).expect_err("no plan");
    assert_eq!(refusal.attempts.len(), planner.config().planner.replan.neighbours);
    assert!(
        refusal
            .attempts
            .iter()
            .all(|a| matches!(a.refused, Some(Refusal::Infeasible { conflict: Some(_), .. }))),
        "{refusal}"
    );
}

#[test]
fn a_deadline_in_the_past_stops_before_the_first_qp() {
    let planner = planner();
    let x = start(&planner, STARTS[0]);
    let refusal = planner.replan(&x, 4, Some(Instant::now())).expect_err("no time");
    assert!(refusal.out_of_time());
}
