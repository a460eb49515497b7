//! The planner finds a plan from every pose at rest from which the optimisation finds a swing-up, also far from the database
//! entries; the plan meets the daemon's criteria of acceptance and is at most 5 % longer than the optimum.

use rayon::prelude::*;
use upswing_config::{Config, PendulumStart};
use upswing_model::{ActuatedVector, State};
use upswing_ocp::interior_point::NlpStatus;
use upswing_ocp::multistart::Search;
use upswing_planner::offline::{optimize, options, problem, problem_with_margin, target};
use upswing_planner::replan::{Effort, Method, Planner};
use upswing_trajectory::{Certificate, Entry};

/// Largest ratio of the duration of a plan to that of the optimum.
const LONGEST: f64 = 1.05;
/// Number of random poses; more than 300 were run when the test was written.
const POSES: usize = 60;

fn planner() -> Planner {
    Planner::new(Config::embedded().expect("embedded settings")).expect("the shipped database fits")
}

fn rest(config: &Config, degrees: [f64; 7]) -> State {
    config.start_state(&degrees.map(f64::to_radians), PendulumStart::Rest).expect("a rest position")
}

/// Returns whether there is an optimum from `start` (rad, rad/s); asserts that there is a plan then.
fn plans_where_there_is_an_optimum(planner: &Planner, start: &State) -> bool {
    let config = planner.config();
    let optimum = optimize(
        &problem(config, target(config, 0, &[]).expect("a target"), *start),
        Search::Best,
        &[],
        &options(config),
    );
    if optimum.status != NlpStatus::Solved {
        return false;
    }
    let q = start.q_a().map(f64::to_degrees);
    let replan = planner.replan(start, config.planner.replan.iterations, None);
    let replan = replan.unwrap_or_else(|e| panic!("from {q:?}: {e}"));
    assert!(replan.defect <= config.planner.replan.defect, "from {q:?}: defect {:e}", replan.defect);
    assert!((replan.trajectory.x[0] - start).amax() <= 1e-7, "from {q:?}: starts elsewhere");
    let longer = replan.trajectory.t_f / optimum.trajectory.t_f;
    assert!(longer <= LONGEST, "from {q:?}: {:.3} s, {longer:.4} of the optimum", replan.trajectory.t_f);
    config
        .plan_criteria()
        .check(&config.model, &replan.plan(config))
        .unwrap_or_else(|e| panic!("from {q:?}: {e}"));
    true
}

#[test]
fn far_from_every_entry() {
    let planner = planner();
    for degrees in [
        [120.0, 0.0, 0.0, -90.0, 0.0, 0.0, 0.0],
        [0.0, -15.0, 60.0, -95.0, 60.0, 10.0, 60.0],
        [170.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0],
        [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 90.0],
        [0.0, -15.0, 0.0, -95.0, 90.0, 10.0, 0.0],
        // A long motion, which exceeds limits between its knots by more than the knot margin.
        [153.7, 8.0, 140.2, 22.5, 37.3, -31.2, -168.7],
        [149.6, 69.3, -167.5, -32.0, -29.3, -19.0, 114.8],
        // Near an entry whose duration is that of another local optimum.
        [-52.8, -26.5, 0.0, -102.1, 0.0, 27.4, 0.0],
        [-44.8, -25.0, 0.0, -88.0, 0.0, 55.5, 0.0],
        // The nearest entries are all of another local optimum.
        [-49.8, -6.8, 0.0, -107.8, 0.0, 3.5, 0.0],
        // Narrower limits at every knot, not only where one is exceeded, take 7 % longer.
        [-96.8, -75.0, -25.8, -32.9, -52.6, -88.8, -5.6],
    ] {
        let start = rest(planner.config(), degrees);
        assert!(plans_where_there_is_an_optimum(&planner, &start), "no optimum from {degrees:?}");
    }
}

#[test]
fn over_the_whole_range_of_every_joint() {
    let planner = planner();
    let config = planner.config();
    let limits = &config.robot.planning;
    // xorshift64 (Marsaglia 2003): a fixed sequence of poses.
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    let mut between = |from: f64, to: f64| {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        from + (to - from) * (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut starts = Vec::new();
    while starts.len() < POSES {
        // Two of three poses anywhere, the third in the range of the database.
        let mut q = ActuatedVector::zeros(config.model.sizes());
        if starts.len() % 3 == 0 {
            config.manoeuvres[0]
                .grid
                .axes
                .iter()
                .for_each(|axis| q[axis.joint] = between(axis.from, axis.to));
        } else {
            q = limits.q_min.actuated().zip_map(&limits.q_max.actuated(), &mut between);
        }
        starts.extend(config.start_state(&q, PendulumStart::Rest));
    }
    let with_optimum =
        starts.par_iter().filter(|start| plans_where_there_is_an_optimum(&planner, start)).count();
    assert!(with_optimum > POSES / 2, "only {with_optimum} of {POSES} poses have an optimum");
}

#[test]
fn near_an_entry_by_quadratic_programs() {
    let planner = planner();
    for degrees in [[-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0], [20.0, 10.0, 0.0, -70.0, 0.0, 0.0, 0.0]] {
        let start = rest(planner.config(), degrees);
        let replan = planner.replan(&start, 10, None).expect("a plan");
        assert_eq!(replan.method, Method::Quadratic, "from {degrees:?}");
    }
}

#[test]
fn one_qp_is_not_followed_by_an_optimisation() {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.replan.iterations = 1;
    let planner = Planner::new(config).expect("the shipped database fits");
    let far = rest(planner.config(), [120.0, 0.0, 0.0, -90.0, 0.0, 0.0, 0.0]);
    let refusal = planner.replan(&far, 1, None).expect_err("no entry is near");
    assert!(refusal.optimisation.is_none() && !refusal.failed.is_empty(), "{refusal}");
}

#[test]
fn with_a_target_on_its_limit() {
    let mut config = Config::embedded().expect("embedded settings");
    // The position limits of Table II as printed, as with position_margin_deg = [0, 0].
    let printed = config.robot.limits;
    (config.robot.planning.q_min, config.robot.planning.q_max) = (printed.q_min, printed.q_max);
    let origins = [[0.0, 0.0, 0.0, -90.0, 0.0, 0.0, 0.0], [25.0, 15.0, 0.0, -75.0, 0.0, 10.0, 0.0]];
    let entries: Vec<Entry> = origins
        .iter()
        .map(|degrees| {
            let target = target(&config, 0, &[]).expect("a target");
            let optimum = optimize(
                &problem_with_margin(&config, target, rest(&config, *degrees)),
                Search::Best,
                &[],
                &options(&config),
            );
            assert_eq!(optimum.status, NlpStatus::Solved, "from {degrees:?}");
            let input_weight = config.planner.offline.input_weight;
            Entry::new(&optimum.trajectory, |t| {
                Certificate::of(t, &config.model, &config.robot.planning, input_weight)
            })
        })
        .collect();
    let planner = Planner::with_entries(config, 0, "computed".into(), entries).expect("a planner");
    let mut solver = planner.solver();
    let quadratic = Effort { optimise: false, ..Effort::iterations(10) };
    for (degrees, shift) in origins.iter().flat_map(|d| [(d, 0.0), (d, 5.0), (d, -5.0)]) {
        let mut moved = *degrees;
        moved.iter_mut().step_by(2).for_each(|q| *q += shift);
        let start = rest(planner.config(), moved);
        let up = planner.replan_with(&mut solver, 0, &[], &start, &quadratic);
        let up = up.unwrap_or_else(|e| panic!("from {moved:?}: {e}"));
        assert!(up.defect <= planner.config().planner.replan.defect, "{:e}", up.defect);
        let far = Effort::iterations(10);
        planner.replan_with(&mut solver, 0, &[], &start, &far).expect("a plan");
        let end = *up.trajectory.end();
        let down = planner.replan_with(&mut solver, 1, &[], &end, &quadratic);
        down.unwrap_or_else(|e| panic!("down from the end of {moved:?}: {e}"));
    }
}
