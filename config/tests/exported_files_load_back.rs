//! The embedded settings load; files of the same contents load to the same values.

mod common;
use common::{edit, exported};
use upswing_config::{Config, PendulumStart, TorqueForm, VelocityEstimate};
use upswing_model::{ActuatedVector, Period};

#[test]
fn the_same_settings() {
    let embedded = Config::embedded().expect("embedded settings");
    let dir = exported();
    let loaded = Config::load(Some(dir.path())).expect("exported settings");
    assert_eq!(loaded.urdf, embedded.urdf);
    assert_eq!(loaded.model.fingerprint(), embedded.model.fingerprint());
    assert_eq!(loaded.robot, embedded.robot);
    assert_eq!(loaded.planner, embedded.planner);
    assert_eq!(loaded.daemon, embedded.daemon);
    assert_eq!(loaded.plant, embedded.plant);
    assert_eq!(loaded.plant_model.fingerprint(), embedded.plant_model.fingerprint());
    assert_eq!(loaded.grid, embedded.grid);
    std::fs::write(dir.path().join("other"), b"in the folder").expect("write");
    let (of_folder, of_program) = (
        loaded.optional_file("other", Some(b"embedded")).expect("readable").expect("a file"),
        embedded.optional_file("other", Some(b"embedded")).expect("readable").expect("embedded"),
    );
    for config in [&loaded, &embedded] {
        assert_eq!(config.optional_file("none", None).expect("no error"), None);
    }
    assert!(of_folder.0.ends_with("other") && of_folder.1 == b"in the folder".as_slice());
    assert!(of_program.0 == "embedded other" && of_program.1 == b"embedded".as_slice());
}

#[test]
fn an_edit_takes_effect_in_si_units() {
    let dir = exported();
    edit(dir.path(), "planner.toml", "torque = \"exact\"\n# Largest residual", "torque = \"paper\"\n#");
    edit(dir.path(), "robot.toml", "velocity_fraction_unactuated = 0.5", "velocity_fraction_unactuated = 1");
    edit(dir.path(), "daemon.toml", "cpu = -1", "cpu = 3");
    edit(dir.path(), "plant.toml", "pendulum = \"rest\"", "pendulum = \"zero\"");
    let config = Config::from_dir(dir.path()).expect("edited settings");
    assert_eq!(config.planner.offline.torque, TorqueForm::Paper);
    assert_eq!(config.robot.planning.qd_max[7], 180_f64.to_radians());
    assert_eq!(config.robot.planning.qd_max[6], 135_f64.to_radians() * 0.5);
    assert_eq!(config.daemon.realtime.cpu, Some(3));
    assert_eq!(config.plant.start.pendulum, PendulumStart::Zero);
}

#[test]
fn the_papers_values() {
    let config = Config::load(None).expect("embedded settings");
    let deg = f64::to_radians;
    let robot = &config.robot;
    assert_eq!(robot.limits.q_max[8], deg(45.0));
    assert_eq!(robot.limits.q_min[0], deg(-170.0));
    assert_eq!(robot.planning.tau_max[2], 88.0);
    assert!((robot.planning.q_max[7] - deg(200.0)).abs() < 1e-12);
    assert!((robot.planning.q_min[7] + deg(200.0)).abs() < 1e-12);
    assert_eq!(robot.planning.q_max[6], robot.limits.q_max[6]);
    assert_eq!((robot.target.pitch, robot.target.q8), (deg(90.0), deg(180.0)));
    assert_eq!((robot.coriolis_bound.lower[1], robot.coriolis_bound.upper[1]), (-7.0, 8.0));
    assert_eq!(config.daemon.cycle.period, Period::from_micros(125));
    assert_eq!(config.daemon.cycle.velocity_filter, 0.012);
    assert_eq!(config.daemon.cycle.velocity, VelocityEstimate::Filter);
    let zero = ActuatedVector::zeros(config.model.sizes());
    assert_eq!(config.robot.rotor_inertia, zero);
    assert_eq!((config.robot.friction.viscous, config.robot.friction.coulomb), (zero, zero));
    assert_eq!(config.daemon.realtime.cpu, None);
    assert!((config.plant.encoder.pendulum_resolution - 4.79e-5).abs() < 1e-7);
    assert_eq!(config.plant.start.q[3], deg(-95.0));

    let mut config = config;
    config.use_paper_grid().expect("the paper's grid is within the limits");
    let axes = &config.grid.axes;
    assert_eq!(axes.iter().map(|axis| axis.joint).collect::<Vec<_>>(), [0, 1, 3, 5]);
    assert_eq!(config.grid.poses(), 256);
    let last = config.grid.pose(255);
    assert!((last[0] - deg(45.0)).abs() < 1e-12 && (last[5] - deg(60.0)).abs() < 1e-12);
    for (point, angle) in [-60.0, -25.0, 10.0, 45.0].into_iter().enumerate() {
        assert!((axes[0].position(point) - deg(angle)).abs() < 1e-12);
    }
}
