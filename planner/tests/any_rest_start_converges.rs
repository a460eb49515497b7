//! Random starts at rest in the paper's ranges converge to a trajectory with defect at most 1e-8 within all limits;
//! starts at q8 = q9 = 0 near the level flange do, too; for an infeasible start the limit is named.

use upswing_config::{Config, PendulumStart};
use upswing_model::{LimitKind, State};
use upswing_ocp::interior_point::{NlpSolution, NlpStatus};
use upswing_ocp::multistart::Search;
use upswing_planner::offline::{optimize, options, problem, target};

/// Number of random starts, a compromise between coverage and duration; 1000 were run when the test was written.
const STARTS: usize = 60;

fn solve(config: &Config, start: State) -> NlpSolution {
    optimize(
        &problem(config, target(config, 0, &[]).expect("a target"), start),
        Search::First,
        &[],
        &options(config),
    )
}

fn assert_solved(config: &Config, start: State) {
    let solution = solve(config, start);
    let q = start.q().map(f64::to_degrees);
    assert_eq!(solution.status, NlpStatus::Solved, "from {q:?}");
    let t = &solution.trajectory;
    assert!(t.defect(&config.model) <= 1e-8, "from {q:?}");
    let limits = &config.robot.planning;
    for x in t.x.iter() {
        for i in 0..q.len() {
            let (at, speed) = (x.q()[i], x.qd()[i].abs());
            assert!(at >= limits.q_min[i] - 1e-9 && at <= limits.q_max[i] + 1e-9, "q{} from {q:?}", i + 1);
            assert!(speed <= limits.qd_max[i] + 1e-9, "qd{} from {q:?}", i + 1);
        }
    }
}

#[test]
fn at_rest_over_the_papers_ranges() {
    let config = Config::embedded().expect("embedded settings");
    // xorshift64 (Marsaglia 2003): a fixed sequence of starts.
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    let mut between = |from: f64, to: f64| {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        (from + (to - from) * (seed >> 11) as f64 / (1_u64 << 53) as f64).to_radians()
    };
    let mut solved = 0;
    while solved < STARTS {
        let q = [
            between(-60.0, 45.0),
            between(-30.0, 30.0),
            0.0,
            between(-120.0, -60.0),
            0.0,
            between(-60.0, 60.0),
            0.0,
        ];
        if let Ok(start) = config.start_state(&q, PendulumStart::Rest) {
            assert_solved(&config, start);
            solved += 1;
        }
    }
}

/// Start state at rest with q8 = q9 = 0 and the flange at `pitch` deg; rad.
fn zero_start(config: &Config, pitch: f64) -> State {
    let q = [0.0, 0.0, 0.0, -90.0, 0.0, pitch - 90.0, 0.0].map(f64::to_radians);
    config.start_state(&q, PendulumStart::Zero).expect("within the limits")
}

#[test]
fn at_zero_near_the_level_flange() {
    let config = Config::embedded().expect("embedded settings");
    for pitch in [80.0, 85.0, 90.0, 95.0, 100.0] {
        assert_solved(&config, zero_start(&config, pitch));
    }
}

#[test]
fn a_rod_that_falls_too_fast_is_infeasible() {
    let config = Config::embedded().expect("embedded settings");
    // From pitch 30 deg the rod falls faster than joint 9 may move, whatever the arm does.
    match solve(&config, zero_start(&config, 30.0)).status {
        NlpStatus::Infeasible(limit) => {
            let last = config.model.sizes().joints() - 1;
            assert_eq!((limit.kind, limit.joint), (LimitKind::Velocity, last), "{limit}");
        }
        other => panic!("expected infeasible, got {other}"),
    }
}

#[test]
fn budgets_end_a_solve_with_what_it_has() {
    let config = Config::embedded().expect("embedded settings");
    let start = zero_start(&config, 90.0);
    let mut limited = options(&config);
    limited.max_iterations = 3;
    let solution = optimize(
        &problem(&config, target(&config, 0, &[]).expect("a target"), start),
        Search::First,
        &[],
        &limited,
    );
    assert_eq!(solution.status, NlpStatus::MaxIterations);
    assert!(solution.trajectory.x.iter().all(|x| x.iter().all(|v| v.is_finite())));
    let mut stopped = options(&config);
    stopped.cancelled = Some(&|| true);
    assert_eq!(
        optimize(
            &problem(&config, target(&config, 0, &[]).expect("a target"), start),
            Search::First,
            &[],
            &stopped
        )
        .status,
        NlpStatus::Interrupted
    );
    let mut brief = options(&config);
    brief.time_budget = Some(std::time::Duration::ZERO);
    assert_eq!(
        optimize(
            &problem(&config, target(&config, 0, &[]).expect("a target"), start),
            Search::First,
            &[],
            &brief
        )
        .status,
        NlpStatus::OutOfTime
    );
}
