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
        (
            "joint_1 = [-170, 170]",
            "joint_1 = [170, -170]",
            &["limits.q_deg.joint_1", "expected [lowest, highest], got [170, -170]"],
        ),
        (
            "joint_1 = [-170, 170]",
            "joint_1 = [-inf, 170]",
            &["limits.q_deg.joint_1", "a position from -100000 to 100000, got -inf"],
        ),
        (
            "joint_1 = [-170, 170]",
            "joint_1 = [0, 0]",
            &["limits.q_deg.joint_1", "expected [lowest, highest]"],
        ),
        ("joint_3 = 100", "joint_3 = nan", &["limits.qd_deg_s.joint_3", POSITIVE, "got NaN"]),
        ("joint_7 = 40 }", "joint_7 = inf }", &["limits.tau_nm.joint_7", POSITIVE, "got inf"]),
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
            "pendulum_2 = 0,",
            "pendulum_2 = -1,",
            &["usage.position_margin_deg.pendulum_2", "a margin from 0 to 100000", "got -1"],
        ),
        (
            "inertia_kg_m2 = 0",
            "inertia_kg_m2 = -1",
            &["drives.rotor_inertia_kg_m2: ", NOT_NEGATIVE, "got -1"],
        ),
        (
            "friction_viscous = 0\nfriction_coulomb",
            "friction_viscous = { default = 0, joint_2 = -1 }\nfriction_coulomb",
            &["drives.friction_viscous.joint_2", NOT_NEGATIVE, "got -1"],
        ),
        (
            "friction_coulomb = 0",
            "friction_coulomb = { default = nan, joint_2 = 0 }",
            &["drives.friction_coulomb.default", NOT_NEGATIVE, "got NaN"],
        ),
        (
            "friction_smoothing_rad_s = 0.05",
            "friction_smoothing_rad_s = 0",
            &["drives.friction_smoothing_rad_s", POSITIVE, "got 0"],
        ),
        ("joint_1 = 6,", "joint_1 = -6,", &["coriolis_bound.upper_nm.joint_1", POSITIVE, "got -6"]),
        ("joint_1 = -6,", "joint_1 = 6.5,", &["coriolis_bound.lower_nm.joint_1", "below 0", "got 6.5"]),
        (
            "joint_1 = -6,",
            "joint_1 = -160,",
            &["coriolis_bound.lower_nm", "less than the 160", "got -160 for joint `joint_1`"],
        ),
        (
            "joint_1 = 6,",
            "joint_1 = 160,",
            &["coriolis_bound.upper_nm", "less than the 160", "got 160 for joint `joint_1`"],
        ),
    ] as [(&str, &str, &[&str]); 17]
    {
        refused("robot.toml", from, to, parts);
    }
}

#[test]
fn limits_that_differ_from_the_urdf() {
    for (from, to, parts) in [
        (
            "joint_2 = [-120, 120]",
            "joint_2 = [-120, 119]",
            &["limits.q_deg", "the 120 of joint `joint_2` in robot.urdf", "got 119"],
        ),
        (
            "joint_2 = [-120, 120]",
            "joint_2 = [-121, 120]",
            &["limits.q_deg", "the -120 of joint `joint_2` in robot.urdf", "got -121"],
        ),
        ("{ joint_1 = 85", "{ joint_1 = 98", &["limits.qd_deg_s", "the 85 of joint `joint_1`", "got 98"]),
        (
            "joint_7 = 40 }",
            "joint_7 = 41 }",
            &["limits.tau_nm", "the 40 of joint `joint_7`", "got 41", "change both files"],
        ),
    ] as [(&str, &str, &[&str]); 4]
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
        ("intervals = 100", "intervals = 19", &["offline.intervals", "from 20 to 1000", "got 19"]),
        ("sub_horizons = 1", "sub_horizons = 3", &["replan.sub_horizons", "one of", "got 3"]),
        ("weight_t_f = 300", "weight_t_f = -1.0", &["replan.weight_t_f", POSITIVE, "got -1"]),
        ("weight_u = 0.01", "weight_u = 0", &["replan.weight_u: ", POSITIVE, "got 0"]),
        ("neighbours = 3", "neighbours = 0", &["replan.neighbours", "from 1 to", "got 0"]),
        (
            "metric = 1",
            "metric = { default = 1, joint_1 = -1 }",
            &["replan.metric.joint_1", POSITIVE, "got -1"],
        ),
        ("q_angles = 100", "q_angles = nan", &["lqr.q_angles", POSITIVE, "got NaN"]),
        ("\nr = 0.01", "\nr = 0", &["lqr.r", POSITIVE, "got 0"]),
    ] as [(&str, &str, &[&str]); 15]
    {
        refused("planner.toml", from, to, parts);
    }
}

#[test]
fn grid() {
    let three = "joint = \"joint_4\", from_deg = -120, to_deg = -60, points = 5";
    let first =
        "joint = \"joint_1\", from_deg = -60, to_deg = 45, points = 4 },\n    { joint = \"joint_2\", from";
    for (from, to, parts) in [
        (three, "value_deg = 1", &["manoeuvre.grid: expected `joint`, one of joint_1, joint_2"]),
        (
            three,
            "joint = \"pendulum_1\", value_deg = 0",
            &["manoeuvre.grid.joint", "joint_1, joint_2", "joint_7, got `pendulum_1`"],
        ),
        (three, "joint = 4", &["manoeuvre.grid.joint", "invalid type: integer `4`, expected a string"]),
        (
            three,
            "joint = \"joint_2\", value_deg = 0",
            &["manoeuvre.grid", "at most once", "got joint `joint_2` twice"],
        ),
        (
            three,
            "joint = \"joint_4\", from_m = -1, to_deg = 0, points = 2",
            &["manoeuvre.grid.from_m: expected from_deg for joint `joint_4`"],
        ),
        (
            three,
            "joint = \"joint_4\", value_deg = 0, points = 2",
            &["manoeuvre.grid: expected value_deg, or from_deg, to_deg and points, for joint `joint_4`"],
        ),
        (
            three,
            "joint = \"joint_4\", from_deg = -121, to_deg = 0, points = 2",
            &["manoeuvre.grid.from_deg", "from -120 to 120 deg", "got -121 for joint `joint_4`"],
        ),
        (
            first,
            "joint = \"joint_1\", from_deg = 45, to_deg = 45, points = 4 },\n    { joint = \"joint_2\", from",
            &["manoeuvre.grid.to_deg", "more than the 45 of from_deg, got 45"],
        ),
        (
            first,
            "joint = \"joint_1\", from_deg = -60, to_deg = 45, points = 1 },\n    { joint = \"joint_2\", from",
            &["manoeuvre.grid.points", "from 2 to 1000000, got 1"],
        ),
        (
            first,
            "joint = \"joint_1\", from_deg = -60, to_deg = 45, points = 15626 },\n    { joint = \"joint_2\", from",
            &["manoeuvre.grid", "at most 1000000", "start poses"],
        ),
        (
            "max_rest_angle_deg = 45\n\n# A swing",
            "max_rest_angle_deg = 0\n\n# A swing",
            &["manoeuvre.max_rest_angle_deg", POSITIVE, "got 0"],
        ),
    ] as [(&str, &str, &[&str]); 11]
    {
        refused("manoeuvres.toml", from, to, parts);
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
        ("stiffness = 100", "stiffness = 0", &["hold.stiffness: ", POSITIVE, "got 0"]),
        ("damping = 20", "damping = { default = -20 }", &["hold.damping.default", POSITIVE, "got -20"]),
        ("rad_s2 = 6", "rad_s2 = inf", &["stop.deceleration_rad_s2: ", POSITIVE, "got inf"]),
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
        (
            "jump_rad = { warn = 0.0005",
            "jump_rad = { warn = 0",
            &["limits.encoder_jump_rad.warn", POSITIVE, "got 0"],
        ),
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
            "balance_distance_rad = { warn = 0.1745",
            "balance_distance_rad = { warn = 0",
            &["limits.balance_distance_rad.warn", "an angle above 0 and below pi/2 rad", "got 0"],
        ),
        ("late_cycles = { warn = 1", "late_cycles = { warn = 0", &["limits.late_cycles.warn", "got 0"]),
        ("trip = 600", "trip = 6", &["limits.plan_age_s.trip", "more than the 60 of warn", "got 6"]),
        ("attempts = 0", "attempts = -1", &["recovery.attempts", "from 0 to", "got -1"]),
        ("rest_speed_rad_s = 0.05", "rest_speed_rad_s = 0", &["recovery.rest_speed_rad_s", POSITIVE]),
        ("rest_s = 2", "rest_s = 0", &["recovery.rest_s", "at most 86400 s", "got 0"]),
        ("patience_s = 300", "patience_s = 1e6", &["recovery.patience_s", "at most 86400 s", "got 1000000"]),
        ("keep = 10", "keep = 0", &["recorder.keep", "from 1 to", "got 0"]),
        ("tolerance_rad = 0.05", "tolerance_rad = 0", &["start.tolerance_rad", POSITIVE, "got 0"]),
        ("tolerance_m = 0.05", "tolerance_m = nan", &["start.tolerance_m", POSITIVE, "got NaN"]),
        ("tolerance_rad_s = 0.2", "tolerance_rad_s = -1", &["start.tolerance_rad_s", POSITIVE, "got -1"]),
        ("priority = 80", "priority = 100", &["realtime.priority", "from 1 to 99", "got 100"]),
        ("cpu = -1", "cpu = -2", &["realtime.cpu", "from -1 to", "got -2"]),
    ] as [(&str, &str, &[&str]); 26]
    {
        refused("daemon.toml", from, to, parts);
    }
}

#[test]
fn plant() {
    for (from, to, parts) in [
        ("substeps = 1", "substeps = 0", &["integrator.substeps", "from 1 to", "got 0"]),
        (
            "{ pendulum_1 = 4.79",
            "{ pendulum_1 = -4.79",
            &["encoder.resolution_rad.pendulum_1", POSITIVE, "got -0.00004"],
        ),
        ("resolution_m = 2e-5", "resolution_m = inf", &["encoder.resolution_m", POSITIVE, "got inf"]),
        ("watchdog_cycles = 20", "watchdog_cycles = 0", &["drive.watchdog_cycles", "from 1 to", "got 0"]),
        ("constant_ms = 10", "constant_ms = 0", &["drive.brake_time_constant_ms", POSITIVE, "got 0"]),
        ("joint_1 = 0.2415", "joint_1 = -1", &["friction.viscous.joint_1", NOT_NEGATIVE, "got -1"]),
        ("joint_1 = 0.31909", "joint_1 = nan", &["friction.coulomb.joint_1", NOT_NEGATIVE, "got NaN"]),
        ("compensation = 1.0", "compensation = 1.1", &["friction.compensation", "[0, 1]", "got 1.1"]),
        ("rad_s = 0.01", "rad_s = 0", &["friction.coulomb_smoothing_rad_s", POSITIVE, "got 0"]),
        (
            "joint_4 = -95",
            "joint_4 = -125",
            &["start.q_deg", "-120 to 120 deg", "got -125 for joint `joint_4`"],
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
