//! The embedded settings load; files of the same contents load to the same values.

mod common;
use common::{edit, exported};
use upswing_config::{Config, PendulumStart, TorqueForm, VelocityEstimate};
use upswing_model::{ActuatedVector, Period};

#[test]
fn a_file_contains_only_the_keys_that_differ() {
    let dir = exported();
    std::fs::write(
        dir.path().join("daemon.toml"),
        "[hold]\nstiffness = { joint_3 = 50 }\n[limits]\nplan_age_s = { trip = 700 }\n",
    )
    .expect("write");
    std::fs::remove_file(dir.path().join("planner.toml")).expect("removed");
    let config = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}"));
    let embedded = Config::embedded().expect("embedded settings");
    assert_eq!(config.planner, embedded.planner);
    assert_eq!(config.daemon.hold.stiffness.to_vec(), [100.0, 100.0, 50.0, 100.0, 100.0, 100.0, 100.0]);
    assert_eq!(config.daemon.hold.damping, embedded.daemon.hold.damping);
    assert_eq!((config.daemon.limits.plan_age.warn, config.daemon.limits.plan_age.trip), (60.0, 700.0));
    // In full, with the values of the file and the comments of the defaults.
    let texts = config.texts().expect("texts");
    let (_, daemon) = texts.iter().find(|(name, _)| name == "daemon.toml").expect("the daemon");
    for line in [
        "stiffness = { joint_3 = 50, default = 100 }",
        "plan_age_s = { trip = 700, warn = 60 }",
        "# Age of a loaded plan above which its start is refused, s.",
        "damping = 20",
    ] {
        assert!(daemon.lines().any(|l| l == line), "no `{line}` in:\n{daemon}");
    }
}

#[test]
fn an_edit_takes_effect_in_si_units() {
    let dir = exported();
    edit(dir.path(), "planner.toml", "torque = \"exact\"\n# Largest residual", "torque = \"paper\"\n#");
    edit(dir.path(), "robot.toml", "velocity_fraction_unactuated = 0.5", "velocity_fraction_unactuated = 1");
    edit(dir.path(), "daemon.toml", "cpu = -1", "cpu = 3");
    edit(dir.path(), "plant.toml", "unactuated = \"rest\"", "unactuated = \"zero\"");
    let config = Config::from_dir(dir.path()).expect("edited settings");
    assert_eq!(config.planner.offline.torque, TorqueForm::Paper);
    assert_eq!(config.robot.planning.qd_max[7], 180_f64.to_radians());
    assert_eq!(config.robot.planning.qd_max[6], 135_f64.to_radians() * 0.5);
    assert_eq!(config.daemon.realtime.cpu, Some(3));
    assert_eq!(config.plant.start.pendulum, PendulumStart::Zero);
}

#[test]
fn the_papers_values() {
    let config = Config::embedded().expect("embedded settings");
    let deg = f64::to_radians;
    let robot = &config.robot;
    assert_eq!(robot.limits.q_max[8], deg(45.0));
    assert_eq!(robot.limits.q_min[0], deg(-170.0));
    assert_eq!(robot.planning.tau_max[2], 88.0);
    assert!((robot.planning.q_max[7] - deg(200.0)).abs() < 1e-12);
    assert!((robot.planning.q_min[7] + deg(200.0)).abs() < 1e-12);
    assert_eq!(robot.planning.q_max[6], robot.limits.q_max[6]);
    let bound = robot.coriolis_bound.expect("the paper's");
    assert_eq!((bound.lower[1], bound.upper[1]), (-7.0, 8.0));
    assert_eq!(config.daemon.cycle.period, Period::from_micros(125));
    assert_eq!(config.daemon.cycle.velocity_filter, 0.012);
    assert_eq!(config.daemon.cycle.velocity, VelocityEstimate::Filter);
    let zero = ActuatedVector::zeros(config.model.sizes());
    assert_eq!(config.robot.rotor_inertia, zero);
    assert_eq!((config.robot.friction.viscous, config.robot.friction.coulomb), (zero, zero));
    assert_eq!(config.daemon.realtime.cpu, None);
    assert!((config.plant.encoder.resolution[7] - 4.79e-5).abs() < 1e-7);
    assert_eq!(config.plant.start.q[3], deg(-95.0));

    let mut config = config;
    config.use_paper_grid().expect("the paper's grid is within the limits");
    let grid = &config.manoeuvres[0].grid;
    let axes = &grid.axes;
    assert_eq!(axes.iter().map(|axis| axis.joint).collect::<Vec<_>>(), [0, 1, 3, 5]);
    assert_eq!(grid.poses(), 256);
    let last = grid.pose(255);
    assert!((last[0] - deg(45.0)).abs() < 1e-12 && (last[5] - deg(60.0)).abs() < 1e-12);
    for (point, angle) in [-60.0, -25.0, 10.0, 45.0].into_iter().enumerate() {
        assert!((axes[0].position(point) - deg(angle)).abs() < 1e-12);
    }
}
