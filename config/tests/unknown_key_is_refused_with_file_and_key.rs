//! An unknown key, a missing key, a value of the wrong type and invalid TOML are refused with the file, the line and the
//! key.

mod common;
use common::{exported, refused};
use upswing_config::Config;

#[test]
fn unknown_keys() {
    for (file, from, to, parts) in [
        ("robot.toml", "qd_deg_s =", "qd_rad_s =", &["limits.qd_rad_s", "expected one of", "`qd_deg_s`"]),
        ("robot.toml", "[usage]", "[use]", &["use:", "unknown field `use`", "`usage`"]),
        (
            "planner.toml",
            "neighbours =",
            "neighbors =",
            &["replan.neighbors", "unknown field", "`neighbours`"],
        ),
        (
            "manoeuvres.toml",
            "\"joint_4\", from_deg = -120",
            "\"joint_4\", from = -120",
            &["manoeuvre.grid.from", "`from_deg`"],
        ),
        (
            "daemon.toml",
            "balance_distance_rad =",
            "balance_distance =",
            &["limits.balance_distance", "unknown field", "`balance_distance_rad`"],
        ),
        ("plant.toml", "substeps = 1", "substeps = 1\nstep = 1", &["integrator.step", "`substeps`"]),
    ] as [(&str, &str, &str, &[&str]); 6]
    {
        refused(file, from, to, parts);
    }
}

#[test]
fn missing_keys() {
    for (file, from, to, parts) in [
        ("robot.toml", "tau_nm = {", "# {", &["line 9, `[limits]`: limits: missing field `tau_nm`"]),
        ("robot.toml", "[limits.q_deg]", "[[limits.q_deg]]", &["limits.q_deg"]),
        ("robot.toml", "lower_nm = {", "# {", &["[coriolis_bound]", "missing field `lower_nm`"]),
        ("manoeuvres.toml", "name = \"swing-up\"", "", &["[[manoeuvre]]", "missing field `name`"]),
    ] as [(&str, &str, &str, &[&str]); 4]
    {
        refused(file, from, to, parts);
    }
}

#[test]
fn values_of_the_wrong_type() {
    for (file, from, to, parts) in [
        (
            "manoeuvres.toml",
            "{ joint = \"joint_7\", value_deg = 0 },\n    { joint = \"pendulum_1\", value_deg = 180 },\n    { joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients",
            "{ joint = \"joint_7\", value_deg = \"0\" },\n    { coefficients",
            &["manoeuvre.target.value_deg", "string \"0\"", "expected f64"],
        ),
        (
            "robot.toml",
            "joint_1 = 320,",
            "joint_1 = true,",
            &["limits.tau_nm.joint_1", "boolean", "expected f64"],
        ),
        (
            "robot.toml",
            "joint_1 = [-170, 170]",
            "joint_1 = 170",
            &["limits.q_deg.joint_1", "integer `170`", "expected a sequence"],
        ),
        (
            "robot.toml",
            "joint_1 = [-170, 170]",
            "joint_1 = [-170, 0, 170]",
            &["limits.q_deg.joint_1: expected [lowest, highest], got a list of 3"],
        ),
        (
            "daemon.toml",
            "stiffness = 100",
            "stiffness = '100'",
            &["hold.stiffness", "string \"100\"", "a number for all joints"],
        ),
        (
            "planner.toml",
            "torque = \"exact\"\n# Largest residual",
            "torque = \"fast\"\n#",
            &["offline.torque", "`fast`", "`exact` or `paper`"],
        ),
        (
            "manoeuvres.toml",
            "points = 4 },\n    { joint = \"joint_2\", from",
            "points = 4.5 },\n    { joint = \"joint_2\", from",
            &["manoeuvre.grid.points", "floating point `4.5`"],
        ),
        (
            "daemon.toml",
            "mode = \"warn\"",
            "mode = \"off\"",
            &["realtime.mode", "`off`", "`warn` or `strict`"],
        ),
        (
            "plant.toml",
            "unactuated = \"rest\"",
            "unactuated = 0",
            &["start.unactuated", "string", "`unactuated = 0`"],
        ),
    ] as [(&str, &str, &str, &[&str]); 9]
    {
        refused(file, from, to, parts);
    }
}

#[test]
fn broken_toml() {
    refused("robot.toml", "torque_fraction = 0.5", "torque_fraction = ", &["line", "`torque_fraction =`"]);
    refused("daemon.toml", "[plans]", "[plans", &["line", "`[plans`"]);
    refused(
        "plant.toml",
        "substeps = 1",
        "substeps = 1\nsubsteps = 3",
        &["line", "`substeps = 3`", "duplicate key"],
    );
}

#[test]
fn the_line_counts_from_one() {
    let dir = exported();
    std::fs::write(dir.path().join("robot.toml"), "[limits]\nq_deg = 1\n").expect("write");
    let message = Config::from_dir(dir.path()).expect_err("a number for a list").to_string();
    assert!(message.contains("robot.toml, line 2, `q_deg = 1`: limits.q_deg: "), "{message}");
}
