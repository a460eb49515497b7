//! A value the system cannot work with is refused with the key, what is possible and what was found.

mod common;
use common::refused;
use upswing_config::Config;

const POSITIVE: &str = "expected a finite number above 0";
const NOT_NEGATIVE: &str = "expected a finite number, 0 or above";
const SHARE: &str = "expected a share in (0, 1]";

#[test]
fn robot() {
    for (from, to, parts) in [
        ("q_deg = [170", "q_deg = [-170", &["limits.q_deg", POSITIVE, "got -170 for joint 1"]),
        (
            "qd_deg_s = [85, 85, 100",
            "qd_deg_s = [85, 85, nan",
            &["limits.qd_deg_s", POSITIVE, "got NaN for joint 3"],
        ),
        ("40, 40]", "40, inf]", &["limits.tau_nm", POSITIVE, "got inf for joint 7"]),
        (
            "fraction_actuated = 0.5",
            "fraction_actuated = 0",
            &["usage.velocity_fraction_actuated", SHARE, "got 0"],
        ),
        (
            "fraction_unactuated = 0.5",
            "fraction_unactuated = 1.5",
            &["usage.velocity_fraction_unactuated", SHARE, "got 1.5"],
        ),
        ("torque_fraction = 0.5", "torque_fraction = -0.5", &["usage.torque_fraction", SHARE, "got -0.5"]),
        (
            "margin_deg = [20, 0]",
            "margin_deg = [20, -1]",
            &["usage.position_margin_deg", NOT_NEGATIVE, "got -1 for joint 9"],
        ),
        (
            "inertia_kg_m2 = [0, 0",
            "inertia_kg_m2 = [0, -1",
            &["drives.rotor_inertia_kg_m2", NOT_NEGATIVE, "got -1 for joint 2"],
        ),
        (
            "friction_viscous = [0, 0",
            "friction_viscous = [0, -1",
            &["drives.friction_viscous", NOT_NEGATIVE, "got -1 for joint 2"],
        ),
        (
            "friction_coulomb = [0",
            "friction_coulomb = [nan",
            &["drives.friction_coulomb", NOT_NEGATIVE, "got NaN for joint 1"],
        ),
        (
            "friction_smoothing_rad_s = 0.05",
            "friction_smoothing_rad_s = 0",
            &["drives.friction_smoothing_rad_s", POSITIVE, "got 0"],
        ),
        ("upper_nm = [6", "upper_nm = [-6", &["coriolis_bound.upper_nm", POSITIVE, "got -6 for joint 1"]),
        ("lower_nm = [-6", "lower_nm = [6", &["coriolis_bound.lower_nm", "below 0", "got 6 for joint 1"]),
        (
            "lower_nm = [-6",
            "lower_nm = [-160",
            &["coriolis_bound.lower_nm", "less than the 160", "got -160 for joint 1"],
        ),
        (
            "upper_nm = [6",
            "upper_nm = [160",
            &["coriolis_bound.upper_nm", "less than the 160", "got 160 for joint 1"],
        ),
        ("pitch_deg = 90", "pitch_deg = inf", &["target.pitch_deg", "from -360 to 360 deg", "got inf"]),
        ("q8_deg = 180", "q8_deg = 201", &["target.q8_deg", "from -200 to 200 deg", "got 201"]),
        (
            "pitch_deg = 90",
            "pitch_deg = 60",
            &[
                "target.pitch_deg",
                "an equilibrium",
                "got 60.00 with q8_deg 180.00",
                "joint 9 of robot.urdf at rest",
            ],
        ),
        (
            "q8_deg = 180",
            "q8_deg = 170",
            &["an equilibrium", "q8_deg 170.00", "joint 8 of robot.urdf at rest"],
        ),
    ] as [(&str, &str, &[&str]); 19]
    {
        refused("robot.toml", from, to, parts);
    }
}

#[test]
fn limits_that_differ_from_the_urdf() {
    for (from, to, parts) in [
        (
            "q_deg = [170, 120",
            "q_deg = [170, 119",
            &["limits.q_deg", "the 120 of joint 2 in robot.urdf", "got 119"],
        ),
        ("qd_deg_s = [85", "qd_deg_s = [98", &["limits.qd_deg_s", "the 85 of joint 1", "got 98"]),
        (
            "110, 40, 40]",
            "110, 40, 41]",
            &["limits.tau_nm", "the 40 of joint 7", "got 41", "change both files"],
        ),
    ] as [(&str, &str, &[&str]); 3]
    {
        refused("robot.toml", from, to, parts);
    }
}

#[test]
fn planner() {
    for (from, to, parts) in [
        ("input_weight = 0.01", "input_weight = 0", &["offline.input_weight", POSITIVE, "got 0"]),
        ("t_f_max_s = 8.0", "t_f_max_s = 0.2", &["offline.t_f_max_s", "more than the 0.3", "got 0.2"]),
        ("t_f_max_s = 8.0", "t_f_max_s = 61", &["offline.t_f_max_s", "at most 60 s", "got 61"]),
        ("knot_margin = 0.015", "knot_margin = 1", &["replan.knot_margin", "[0, 1)", "got 1"]),
        ("tolerance = 1e-9", "tolerance = 1", &["offline.tolerance", "between 0 and 1", "got 1"]),
        ("max_iterations = 3000", "max_iterations = 0", &["offline.max_iterations", "from 1 to", "got 0"]),
        ("\niterations = 10", "\niterations = -4", &["replan.iterations", "from 1 to", "got -4"]),
        ("sub_horizons = 1", "sub_horizons = 3", &["replan.sub_horizons", "one of", "got 3"]),
        ("weight_t_f = 300", "weight_t_f = -1.0", &["replan.weight_t_f", POSITIVE, "got -1"]),
        ("weight_u = [0.01", "weight_u = [0", &["replan.weight_u", POSITIVE, "got 0 for joint 1"]),
        ("neighbours = 3", "neighbours = 0", &["replan.neighbours", "from 1 to", "got 0"]),
        ("metric = [1", "metric = [-1", &["replan.metric", POSITIVE, "got -1 for joint 1"]),
        ("q_angles = 100", "q_angles = nan", &["lqr.q_angles", POSITIVE, "got NaN"]),
        ("\nr = 0.01", "\nr = 0", &["lqr.r", POSITIVE, "got 0"]),
    ] as [(&str, &str, &[&str]); 14]
    {
        refused("planner.toml", from, to, parts);
    }
}

#[test]
fn grid() {
    for (from, to, parts) in [
        ("joint = 4,", "joint = 8,", &["joints.joint", "from 1 to 7", "got 8"]),
        ("joint = 4,", "joint = 2,", &["joints.joint", "at most once", "got joint 2 twice"]),
        (
            "from_deg = -120",
            "from_deg = -121",
            &["joints.from_deg", "from -120 to 120 deg", "got -121 for joint 4"],
        ),
        ("to_deg = 45", "to_deg = -60", &["joints.to_deg", "more than the -60", "got -60"]),
        ("to_deg = 45, points = 4", "to_deg = 45, points = 1", &["joints.points", "from 2 to", "got 1"]),
        (
            "to_deg = 45, points = 4",
            "to_deg = 45, points = 15626",
            &["joints", "at most 1000000", "start poses"],
        ),
        ("max_rest_angle_deg = 45", "max_rest_angle_deg = 0", &["max_rest_angle_deg", POSITIVE, "got 0"]),
    ] as [(&str, &str, &[&str]); 7]
    {
        refused("grid.toml", from, to, parts);
    }
}

#[test]
fn daemon() {
    for (from, to, parts) in [
        ("period_us = 125", "period_us = 0", &["cycle.period_us", "from 1 to", "got 0"]),
        (
            "filter_ms = 12",
            "filter_ms = 0.1",
            &["cycle.velocity_filter_ms", "more than the 0.125", "got 0.1"],
        ),
        ("stiffness = [100", "stiffness = [0", &["hold.stiffness", POSITIVE, "got 0 for joint 1"]),
        ("damping = [20", "damping = [-20", &["hold.damping", POSITIVE, "got -20 for joint 1"]),
        ("rad_s2 = [6", "rad_s2 = [inf", &["stop.deceleration_rad_s2", POSITIVE, "got inf for joint 1"]),
        (
            "age_cycles = { warn = 4,",
            "age_cycles = { warn = 0.5,",
            &["limits.measurement_age_cycles.warn", "a whole number from 1 to", "got 0.5"],
        ),
        (
            "measurement_gap = { warn = 2, trip = 20 }",
            "measurement_gap = { warn = 20, trip = 20 }",
            &["limits.measurement_gap.trip", "more than the 20 of warn", "got 20"],
        ),
        ("warn = 0.0005", "warn = 0", &["limits.encoder_jump_rad.warn", POSITIVE, "got 0"]),
        (
            "margin_deg = { warn = 1, trip = 5",
            "margin_deg = { warn = 1, trip = -5",
            &["limits.position_margin_deg.trip", NOT_NEGATIVE, "got -5"],
        ),
        (
            "velocity_fraction = { warn = 0.8, trip = 1.1",
            "velocity_fraction = { warn = 0.4, trip = 0.5",
            &["limits.velocity_fraction.trip", "more than the 0.5", "got 0.5"],
        ),
        ("trip = 1.2 }", "trip = nan }", &["limits.torque_fraction.trip", POSITIVE, "got NaN"]),
        ("per_ms = { warn = 1,", "per_ms = { warn = inf,", &["limits.torque_rate_per_ms.warn", "got inf"]),
        (
            "tracking_error_rad = { warn = 0.25",
            "tracking_error_rad = { warn = -1",
            &["limits.tracking_error_rad.warn", POSITIVE],
        ),
        (
            "tilt_deg = { warn = 10, trip = 25",
            "tilt_deg = { warn = 10, trip = 90",
            &["limits.balance_tilt_deg.trip", "between 0 and 90 deg", "got 90"],
        ),
        ("late_cycles = { warn = 1", "late_cycles = { warn = 0", &["limits.late_cycles.warn", "got 0"]),
        ("trip = 600", "trip = 6", &["limits.plan_age_s.trip", "more than the 60 of warn", "got 6"]),
        ("attempts = 0", "attempts = -1", &["recovery.attempts", "from 0 to", "got -1"]),
        ("rest_speed_rad_s = 0.05", "rest_speed_rad_s = 0", &["recovery.rest_speed_rad_s", POSITIVE]),
        ("rest_s = 2", "rest_s = 0", &["recovery.rest_s", "at most 86400 s", "got 0"]),
        ("patience_s = 300", "patience_s = 1e6", &["recovery.patience_s", "at most 86400 s", "got 1000000"]),
        ("keep = 10", "keep = 0", &["recorder.keep", "from 1 to", "got 0"]),
        ("tolerance_rad = 0.05", "tolerance_rad = 0", &["start.tolerance_rad", POSITIVE, "got 0"]),
        ("tolerance_rad_s = 0.2", "tolerance_rad_s = -1", &["start.tolerance_rad_s", POSITIVE, "got -1"]),
        ("priority = 80", "priority = 100", &["realtime.priority", "from 1 to 99", "got 100"]),
        ("cpu = -1", "cpu = -2", &["realtime.cpu", "from -1 to", "got -2"]),
    ] as [(&str, &str, &[&str]); 25]
    {
        refused("daemon.toml", from, to, parts);
    }
}

#[test]
fn plant() {
    for (from, to, parts) in [
        ("substeps = 1", "substeps = 0", &["integrator.substeps", "from 1 to", "got 0"]),
        ("resolution_rad = 2e-5", "resolution_rad = 0", &["encoder.arm_resolution_rad", POSITIVE, "got 0"]),
        ("bits = 17", "bits = 33", &["encoder.pendulum_bits", "from 1 to 32", "got 33"]),
        ("watchdog_cycles = 20", "watchdog_cycles = 0", &["drive.watchdog_cycles", "from 1 to", "got 0"]),
        ("constant_ms = 10", "constant_ms = 0", &["drive.brake_time_constant_ms", POSITIVE, "got 0"]),
        (
            "viscous = [0.0005",
            "viscous = [-1",
            &["friction.pendulum_viscous", NOT_NEGATIVE, "got -1 for joint 8"],
        ),
        (
            "arm_coulomb = [0.31909",
            "arm_coulomb = [nan",
            &["friction.arm_coulomb", NOT_NEGATIVE, "got NaN for joint 1"],
        ),
        ("compensation = 1.0", "compensation = 1.1", &["friction.arm_compensation", "[0, 1]", "got 1.1"]),
        ("rad_s = 0.01", "rad_s = 0", &["friction.coulomb_smoothing_rad_s", POSITIVE, "got 0"]),
        (
            "q_deg = [0, -15, 0, -95",
            "q_deg = [0, -15, 0, -125",
            &["start.q_deg", "-120 to 120 deg", "got -125 for joint 4"],
        ),
    ] as [(&str, &str, &[&str]); 10]
    {
        refused("plant.toml", from, to, parts);
    }
}

#[test]
fn robot_description() {
    refused(
        "robot.urdf",
        "<robot name",
        "<robots name",
        &["not a readable URDF", "'robots'", "at or after link `rod`"],
    );
    refused(
        "robot.urdf",
        "<mass value=\"3.94781\"/>",
        "<mass value=\"-1\"/>",
        &["link `link_1`", "mass of 0 or above", "got `-1` kg"],
    );
    let limit = "lower=\"-2.9670597283903604\" upper=\"2.9670597283903604\" velocity=\"1.4835298641951802\"";
    refused(
        "robot.urdf",
        limit,
        &limit.replacen("-2.9670597283903604", "-1.5707963267948966", 1),
        &["joint `joint_1`", "symmetric about 0", "got -90 to 170 deg", "not supported yet"],
    );
}

#[test]
fn a_pendulum_without_limits_has_those_of_its_settings() {
    let dir = common::exported();
    let path = dir.path().join("robot.urdf");
    let text = std::fs::read_to_string(&path).expect("the robot");
    let (arm, pendulum) = text.split_at(text.find("<joint name=\"pendulum_1\"").expect("the joint"));
    let limit =
        &pendulum[pendulum.find("<limit").expect("a limit")..pendulum.find("</joint>").expect("its end")];
    let free = pendulum.replacen(limit, "", 1).replacen("revolute", "continuous", 1);
    std::fs::write(&path, format!("{arm}{free}")).expect("written");
    let config = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}"));
    let original = Config::embedded().expect("the settings");
    assert_eq!(config.robot, original.robot);
    assert_eq!(config.model.fingerprint(), original.model.fingerprint());
}
