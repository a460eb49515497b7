//! Once the memory of the structured back end fits the number of target rows, a solve allocates nothing.

use allocation_counter::measure;
use upswing_config::Config;
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus};
use upswing_planner::offline::{problem, qp_weights, target};
use upswing_planner::replan::Planner;

#[test]
fn after_the_first_one() {
    let planner = Planner::new(Config::embedded().expect("embedded settings")).expect("a database");
    let qp = |entry: usize| {
        let (reference, start) = (
            &planner.entry(0, entry).expect("an entry").trajectory,
            planner.entry(0, entry + 1).expect("an entry").trajectory.x[0],
        );
        let config = planner.config();
        let target = target(config, 0, &[]).expect("a target");
        let (problem, weights) = (problem(config, target, start), qp_weights(&config.planner.replan));
        Qp::new(&problem, reference, reference, &weights)
    };
    let (first, second) = (qp(40), qp(41));
    let reference = &planner.entry(0, 0).expect("an entry").trajectory;
    let mut solver = QpSolver::new(Backend::Structured, reference.sizes(), reference.intervals());
    let options = QpOptions::new(1e-9);
    let heap = measure(|| assert_eq!(solver.solve(&first, &options), QpStatus::Solved));
    assert!(heap.count_total > 0, "the counter counts");
    let heap = measure(|| {
        assert_eq!(solver.solve(&second, &options), QpStatus::Solved);
        assert_eq!(solver.solve_again(&second, &options), QpStatus::Solved);
    });
    assert_eq!(heap.count_total, 0);
}
