//! Replans from starts off the grid meet the nonlinear dynamics and keep every limit; one QP, the paper's mode,
//! leaves the defect of its linearisation; the answer names what was tried.

use std::time::Instant;
use upswing_config::{Config, PendulumStart, SUB_HORIZONS, TorqueForm};
use upswing_model::State;
use upswing_ocp::interior_point::NlpStatus;
use upswing_ocp::multistart::Search;
use upswing_planner::database::certify;
use upswing_planner::offline::{optimize, options, problem_with_margin, target};
use upswing_planner::replan::{Effort, Planner, PlanningFailure};
use upswing_trajectory::Entry;

fn planner() -> Planner {
    Planner::new(Config::embedded().expect("embedded settings")).expect("the shipped database fits")
}

/// A planner in the mode of the paper: one QP per plan.
fn planner_of_one_qp() -> Planner {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.replan.iterations = 1;
    Planner::new(config).expect("the shipped database fits")
}

fn start(planner: &Planner, degrees: [f64; 7]) -> State {
    let q = degrees.map(f64::to_radians);
    planner.config().start_state(&q, PendulumStart::Rest).expect("a start at rest")
}

/// Whether the pendulum is upright within `most` (rad) in the state `x`.
fn upright(x: &State, most: f64) -> bool {
    (x.q_u()[0] - std::f64::consts::PI).abs() <= most && x.q_u()[1].abs() <= most
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
        assert!(replan.margins.smallest() >= 0.0, "{degrees:?}: {:?}", replan.margins);
        assert!((replan.trajectory.x[0] - x).amax() <= 1e-7, "{degrees:?}: starts elsewhere");
        let end = replan.trajectory.end();
        assert!(upright(end, 1e-7), "{degrees:?}: not upright");
        assert!(end.qd().amax() <= 1e-7, "{degrees:?}: not at rest");
    }
}

#[test]
fn further_linearisations_close_the_defect() {
    let x = start(&planner(), STARTS[0]);
    let defect = |planner: Planner, n| planner.replan(&x, n, None).expect("a plan").defect;
    let (one, four) = (defect(planner_of_one_qp(), 1), defect(planner(), 4));
    assert!(one > 1e-3 && four < 1e-3 * one, "one QP leaves {one:e}, four leave {four:e}");
}

#[test]
fn one_qp_is_enough_only_where_the_settings_say_so() {
    let x = start(&planner(), STARTS[0]);
    let refusal = planner().replan(&x, 1, None).expect_err("a defect").to_string();
    assert!(refusal.contains("after 1 QPs: ") && refusal.contains("defect (6b)"), "{refusal}");
    planner_of_one_qp().replan(&x, 1, None).expect("the paper's mode");
    // The limit of the defect of one QP is larger, but still a limit.
    let mut config = planner_of_one_qp().config().clone();
    config.daemon.plans.defect_of_one_qp = 1e-3;
    let planner = Planner::new(config).expect("the shipped database fits");
    assert!(planner.replan(&x, 1, None).is_err());
}

#[test]
fn with_other_numbers_of_intervals() {
    for intervals in [60, 200] {
        let mut config = Config::embedded().expect("embedded settings");
        config.planner.offline.intervals = intervals;
        let start = |degrees: [f64; 7]| {
            config.start_state(&degrees.map(f64::to_radians), PendulumStart::Rest).expect("a start at rest")
        };
        let (x, near) = (start(STARTS[0]), start(STARTS[1]));
        let optimum = optimize(
            &problem_with_margin(&config, target(&config, 0, &[]).expect("a target"), near),
            Search::First,
            &[],
            &options(&config),
        );
        assert_eq!(optimum.status, NlpStatus::Solved, "{intervals} intervals");
        let entry = Entry::new(&optimum.trajectory, |t| certify(&config, t));
        let planner =
            Planner::with_entries(config.clone(), 0, "computed".into(), vec![entry]).expect("a planner");
        let effort = Effort { optimise: false, ..Effort::iterations(config.planner.replan.iterations) };
        let replan = |manoeuvre: usize, start: &State| {
            let replan = planner.replan_with(&mut planner.solver(), manoeuvre, &[], start, &effort);
            let replan = replan.unwrap_or_else(|e| panic!("{manoeuvre}, {intervals} intervals: {e}"));
            assert_eq!(replan.trajectory.intervals(), intervals);
            assert_eq!(replan.gains.intervals(), intervals);
            assert!(replan.defect <= 1e-6, "{intervals} intervals: defect {:e}", replan.defect);
            replan
        };
        let up = replan(0, &x);
        assert!(upright(up.trajectory.end(), 1e-7));
        replan(1, up.trajectory.end());
    }
}

#[test]
fn two_sub_horizons_meet_and_more_give_a_plan_or_a_reason() {
    for sub_horizons in SUB_HORIZONS {
        let mut config = Config::embedded().expect("embedded settings");
        let intervals = config.planner.offline.intervals;
        assert_eq!(intervals % sub_horizons, 0, "the settings offer what divides the horizon");
        config.planner.replan.sub_horizons = sub_horizons;
        let planner = Planner::new(config).expect("the shipped database fits");
        let x = start(&planner, STARTS[1]);
        match planner.replan(&x, 10, None) {
            Ok(replan) => {
                assert!(replan.defect <= 1e-6, "{sub_horizons} parts: defect {:e}", replan.defect);
                assert!(upright(replan.trajectory.end(), 1e-6), "{sub_horizons} parts: not upright");
            }
            // The first sub-horizon determines the duration; the last of many may not reach the target within it.
            Err(refusal) => assert!(sub_horizons > 2, "{sub_horizons} parts: {refusal}"),
        }
    }
}

#[test]
fn the_papers_torque_constraint_keeps_the_torques_too() {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.replan.torque = TorqueForm::Paper;
    let planner =
        Planner::new(config).expect("the mode of the database and that of a replan are independent");
    let replan = planner.replan(&start(&planner, STARTS[0]), 10, None).expect("a plan");
    assert!(replan.defect <= 1e-6 && replan.margins.tau.share > 0.0, "{:?}", replan.margins);
}

#[test]
fn a_pendulum_that_swings_at_the_start_is_caught() {
    let planner = planner();
    let mut x = start(&planner, STARTS[0]);
    for (q8, q9, qd8, qd9) in [(0.2, 0.1, -0.5, 0.3), (-0.3, -0.1, 0.8, 0.0), (0.1, 0.2, 0.0, -0.8)] {
        let rest = start(&planner, STARTS[0]);
        x.q_u_mut().copy_from_slice(&[rest.q_u()[0] + q8, rest.q_u()[1] + q9]);
        x.qd_u_mut().copy_from_slice(&[qd8, qd9]);
        let replan = planner.replan(&x, 10, None).expect("a plan");
        assert!(replan.defect <= 1e-6, "defect {:e}", replan.defect);
        assert!((replan.trajectory.x[0] - x).amax() <= 1e-7);
        assert!(replan.margins.smallest() >= 0.0, "{:?}", replan.margins);
    }
}

#[test]
fn an_entry_of_the_database_is_found_and_kept() {
    let planner = planner_of_one_qp();
    let entry = 40;
    let x = planner.entry(0, entry).expect("an entry").trajectory.x[0];
    let replan = planner.replan(&x, 1, None).expect("a plan");
    assert_eq!(replan.entry.map(|found| (found.index, found.distance)), Some((entry, 0.0)));
    let want = &planner.entry(0, entry).expect("an entry").trajectory;
    // The entry uses its full limits; the replan keeps the knot margin of 1.5 %.
    assert!((replan.trajectory.t_f / want.t_f - 1.0).abs() <= 0.04, "t_F {}", replan.trajectory.t_f);
}

#[test]
fn a_swing_down_ends_where_an_entry_began_on_a_limit_too() {
    let planner = planner();
    let (mut solver, q_min) = (planner.solver(), planner.config().robot.planning.q_min);
    let on_a_limit = |entry: &Entry| (entry.trajectory.x[0][3] - q_min[3]).abs() < 1e-9;
    let entries = (0..planner.entries(0)).map(|entry| planner.entry(0, entry).expect("an entry"));
    let entries: Vec<_> = entries.filter(on_a_limit).step_by(8).collect();
    assert!(entries.len() > 5, "only {} entries with joint 4 on its limit", entries.len());
    for entry in entries {
        let effort = Effort::iterations(planner.config().planner.replan.iterations);
        let mut start = *entry.trajectory.end();
        // Off the end of the swing-up, as after a push.
        start[0] += 0.01;
        let replan = planner.replan_with(&mut solver, 1, &[], &start, &effort);
        let replan = replan.unwrap_or_else(|e| panic!("{e}"));
        assert!(replan.defect <= planner.config().planner.replan.defect, "{:e}", replan.defect);
    }
}

#[test]
fn an_impossible_start_is_refused_with_the_reason_of_each_entry() {
    let planner = planner();
    let mut x = start(&planner, STARTS[0]);
    // At full speed towards a position limit the arm cannot stay within the limit.
    x[1] = planner.config().robot.planning.q_max[1];
    x.qd_mut()[1] = planner.config().robot.planning.qd_max[1];
    let quadratic = Effort { optimise: false, ..Effort::iterations(2) };
    let refusal = planner.replan_with(&mut planner.solver(), 0, &[], &x, &quadratic);
    let refusal = refusal.expect_err("no plan");
    assert_eq!(refusal.failed.len(), planner.config().planner.replan.neighbours);
    assert!(
        refusal
            .failed
            .iter()
            .all(|a| matches!(a.failure, PlanningFailure::Infeasible { conflict: Some(_), .. })),
        "{refusal}"
    );
    // The full optimisation finds no trajectory either.
    let refusal = planner.replan(&x, 2, None).expect_err("no plan");
    assert!(
        matches!(
            refusal.optimisation.as_deref(),
            Some(PlanningFailure::Optimisation(NlpStatus::Infeasible(_)))
        ),
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
