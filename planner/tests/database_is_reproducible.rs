//! A database build gives the same bytes every time, leaves out poses without a rest position inside the limits,
//! and is refused by other settings.

use std::sync::atomic::AtomicBool;
use upswing_config::{Config, GridAxis};
use upswing_planner::offline::{GridPoint, build, database, grid_poses, problem_fingerprint};
use upswing_planner::replan::Planner;
use upswing_trajectory::{Database, DatabaseError};

fn small_grid() -> Config {
    let mut config = Config::embedded().expect("embedded settings");
    let deg = |d: f64| d.to_radians();
    config.planner.grid.axes = vec![
        GridAxis { joint: 1, from: deg(-10.0), to: deg(10.0), points: 2 },
        GridAxis { joint: 3, from: deg(-100.0), to: deg(-10.0), points: 2 },
    ];
    config
}

#[test]
fn equal_settings_give_equal_bytes() {
    let config = small_grid();
    let go = AtomicBool::new(false);
    let build = || build(&config, &go, || ());
    let (first, second) = (build(), build());
    let rejected = first.iter().filter(|p| matches!(p, GridPoint::Rejected(_))).count();
    assert_eq!((grid_poses(&config.planner.grid).len(), rejected), (4, 2));
    let first = database(&config, first);
    assert_eq!(first.entries.len(), 2);
    assert_eq!(first.encode(), database(&config, second).encode());
}

#[test]
fn an_interrupted_build_skips_and_says_so() {
    let points = build(&small_grid(), &AtomicBool::new(true), || ());
    assert!(points.iter().all(|p| matches!(p, GridPoint::Skipped)));
}

#[test]
fn other_limits_are_refused_with_both_fingerprints() {
    let mut config = Config::embedded().expect("embedded settings");
    let shipped = Database::decode(&config.database.bytes).expect("the shipped database");
    config.robot.planning.qd_max[0] *= 0.9;
    let expected = problem_fingerprint(&config);
    let refusal = Planner::new(config).expect_err("made for other limits");
    assert_eq!(
        refusal,
        DatabaseError::Fingerprint { what: "set of limits and weights", expected, got: shipped.problem }
    );
}
