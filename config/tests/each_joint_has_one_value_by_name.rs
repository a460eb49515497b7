//! A value per joint is one number, or a table by joint name with or without a default; unknown and missing joints, and lists, are
//! refused with the names of the joints or the form that is expected.

mod common;
use common::{edit, exported, refused};
use std::path::Path;
use upswing_config::{Config, ConfigError};
use upswing_model::JointKind;

const ALL: &str = "joint_1, joint_2, joint_3, joint_4, joint_5, joint_6, joint_7, pendulum_1, pendulum_2";
const ACTUATED: &str = "joint_1, joint_2, joint_3, joint_4, joint_5, joint_6, joint_7";
const UNACTUATED: &str = "pendulum_1, pendulum_2";

/// Keys with one value per joint: file, section, key, and the joints that they concern.
const KEYS: [(&str, &str, &str, &str); 29] = [
    ("robot.toml", "limits", "qd_deg_s", ALL),
    ("robot.toml", "limits", "tau_nm", ACTUATED),
    ("robot.toml", "usage", "position_margin_deg", UNACTUATED),
    ("robot.toml", "coriolis_bound", "upper_nm", ACTUATED),
    ("robot.toml", "coriolis_bound", "lower_nm", ACTUATED),
    ("robot.toml", "drives", "rotor_inertia_kg_m2", ACTUATED),
    ("robot.toml", "drives", "friction_viscous", ACTUATED),
    ("robot.toml", "drives", "friction_coulomb", ACTUATED),
    ("robot.toml", "bearings", "friction_viscous", UNACTUATED),
    ("planner.toml", "replan", "weight_q", ALL),
    ("planner.toml", "replan", "weight_qd", ALL),
    ("planner.toml", "replan", "weight_u", ACTUATED),
    ("planner.toml", "replan", "metric", ACTUATED),
    ("daemon.toml", "hold", "stiffness", ACTUATED),
    ("daemon.toml", "hold", "damping", ACTUATED),
    ("daemon.toml", "stop", "deceleration_rad_s2", ACTUATED),
    ("daemon.toml", "standstill", "angle_rad", ALL),
    ("daemon.toml", "standstill", "friction_nms_rad", ALL),
    ("daemon.toml", "standstill", "unknown_torque_nm", ALL),
    ("daemon.toml", "start", "tolerance_rad", ALL),
    ("daemon.toml", "start", "tolerance_rad_s", ALL),
    ("plant.toml", "model", "rotor_inertia_kg_m2", ACTUATED),
    ("plant.toml", "encoder", "resolution_rad", ALL),
    ("plant.toml", "encoder", "noise_rad", ALL),
    ("plant.toml", "encoder", "bias_deg", ALL),
    ("plant.toml", "stops", "margin_deg", ALL),
    ("plant.toml", "drive", "torque_offset_nm", ACTUATED),
    ("plant.toml", "friction", "viscous", ALL),
    ("plant.toml", "friction", "coulomb", ALL),
];

/// Loads the folder with another `value` of a key, then restores it.
fn load_with(
    dir: &Path,
    (file, section, key): (&str, &str, &str),
    value: &str,
) -> Result<Config, ConfigError> {
    let path = dir.join(file);
    let original = std::fs::read_to_string(&path).expect("exported file");
    let start = original.find(&format!("\n[{section}]\n")).expect("the section");
    let start = start + original[start..].find(&format!("\n{key} = ")).expect("the key") + 1;
    let end = start + original[start..].find('\n').expect("its end");
    let text = format!("{}{key} = {value}{}", &original[..start], &original[end..]);
    std::fs::write(&path, text).expect("write");
    let result = Config::from_dir(dir);
    std::fs::write(&path, original).expect("restore");
    result
}

#[test]
fn unknown_and_missing_joints_and_lists() {
    let dir = exported();
    for (file, section, key, joints) in KEYS {
        let key_of_file = (file, section, key);
        let other =
            if joints == ALL { "joint_8" } else { if joints == ACTUATED { "pendulum_1" } else { "joint_1" } };
        let name = format!("{file}, line");
        let (first, last) =
            (joints.split(", ").next().expect("one"), joints.split(", ").last().expect("one"));
        let unknown =
            format!("{section}.{key}.{other}: expected `default` or one of {joints}, got `{other}`");
        let missing =
            format!("{section}.{key}: expected a value for joint `{last}` or a `default`, got neither");
        let list = format!(
            "{section}.{key}: expected a number for all joints, or a table of numbers by joint name, as in {{ default = 1, \
             joint_1 = 2 }}, got a list of 2"
        );
        let value = if key == "lower_nm" { "-0.01" } else { "0.01" };
        let all_but_last = joints.split(", ").filter(|joint| *joint != last);
        let all_but_last: Vec<_> = all_but_last.map(|joint| format!("{joint} = {value}")).collect();
        // The values of other keys have defaults.
        let without_last = if ["limits", "coriolis_bound"].contains(&section) {
            (format!("{{ {} }}", all_but_last.join(", ")), missing)
        } else {
            ("{ default = -inf }".to_owned(), format!("{section}.{key}.default: expected"))
        };
        for (bad, expected) in [
            (format!("{{ default = {value}, {other} = {value} }}"), unknown),
            without_last,
            (format!("[{value}, {value}]"), list),
            (
                format!("{{ default = {value}, {first} = \"a\" }}"),
                format!("{section}.{key}.{first}: invalid type: string"),
            ),
        ] {
            let message = load_with(dir.path(), key_of_file, &bad).map(drop).expect_err(&bad).to_string();
            assert!(message.contains(&expected) && message.contains(&name), "no `{expected}` in: {message}");
        }
    }
}

#[test]
fn ranges() {
    refused(
        "robot.toml",
        "pendulum_2 = [-45, 45]",
        "",
        &["limits.q_deg: expected a value for joint `pendulum_2` or a `default`, got neither"],
    );
    refused(
        "robot.toml",
        "pendulum_2 = [-45, 45]",
        "pendulum_3 = [-45, 45]",
        &["limits.q_deg.pendulum_3: expected `default` or one of joint_1", "got `pendulum_3`"],
    );
    let dir = exported();
    let original = std::fs::read_to_string(dir.path().join("robot.toml")).expect("exported");
    let (before, after) = original.split_once("[limits.q_deg]").expect("the ranges");
    let after = &after[after.find("\n\n").expect("their end")..];
    let load = |ranges: &str| {
        std::fs::write(dir.path().join("robot.toml"), format!("{before}{ranges}{after}")).expect("write");
        Config::from_dir(dir.path()).expect_err(ranges).to_string()
    };
    let message = load("q_deg = [-90, 180]");
    assert!(
        message.contains("limits.q_deg: expected the -170 of joint `joint_1` in robot.urdf, got -90"),
        "{message}"
    );
    for list in ["[1]", "[1, 2, 3]", "[]"] {
        let message = load(&format!("q_deg = {list}"));
        assert!(
            message.contains("limits.q_deg: expected a range [lowest, highest] for all joints, or a table"),
            "{message}"
        );
    }
    let message = load("q_deg = 90");
    assert!(
        message.contains("limits.q_deg: invalid type") && message.contains("[lowest, highest]"),
        "{message}"
    );
    let message = load("");
    assert!(message.contains("limits: missing field `q_deg`"), "{message}");
}

#[test]
fn a_number_a_default_and_names_give_the_same_values() {
    let dir = exported();
    let key = ("daemon.toml", "hold", "stiffness");
    let stiffness = |value: &str| {
        let config = load_with(dir.path(), key, value).unwrap_or_else(|e| panic!("{e}"));
        config.daemon.hold.stiffness
    };
    assert_eq!(stiffness("50").to_vec(), [50.0; 7]);
    assert_eq!(stiffness("{ default = 50 }"), stiffness("50"));
    assert_eq!(
        stiffness("{ default = 50, joint_3 = 20 }").to_vec(),
        [50.0, 50.0, 20.0, 50.0, 50.0, 50.0, 50.0]
    );
    let named =
        "{ joint_7 = 7, joint_1 = 1, joint_2 = 2, joint_3 = 3, joint_4 = 4, joint_5 = 5, joint_6 = 6 }";
    assert_eq!(stiffness(named).to_vec(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
}

#[test]
fn ranges_may_be_asymmetric() {
    let dir = exported();
    let limit = "lower=\"-2.9670597283903604\" upper=\"2.9670597283903604\" velocity=\"1.4835298641951802\"";
    let asymmetric = limit.replacen("-2.9670597283903604", "-1.5707963267948966", 1);
    edit(dir.path(), "robot.urdf", limit, &asymmetric);
    let message = Config::from_dir(dir.path()).expect_err("other limits than in the URDF").to_string();
    assert!(message.contains("limits.q_deg: expected the -90 of joint `joint_1`"), "{message}");
    edit(dir.path(), "robot.toml", "joint_1 = [-170, 170]", "joint_1 = [-90, 170]");
    let robot = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}")).robot;
    for limits in [robot.limits, robot.planning] {
        assert_eq!((limits.q_min[0], limits.q_max[0]), (-90_f64.to_radians(), 170_f64.to_radians()));
    }
}

#[test]
fn prismatic_joints_have_keys_in_metres() {
    let dir = exported();
    let edit = |file: &str, from: &str, to: &str| edit(dir.path(), file, from, to);
    let refused = |expected: &str| {
        let message = Config::from_dir(dir.path()).expect_err(expected).to_string();
        assert!(message.contains(expected), "no `{expected}` in: {message}");
    };
    edit(
        "robot.urdf",
        "<joint name=\"joint_7\" type=\"revolute\">",
        "<joint name=\"joint_7\" type=\"prismatic\">",
    );
    edit(
        "robot.urdf",
        "lower=\"-3.0543261909900767\" upper=\"3.0543261909900767\" velocity=\"2.356194490192345\"",
        "lower=\"-0.1\" upper=\"0.2\" velocity=\"0.5\"",
    );
    refused("limits.q_deg.joint_7: expected `default` or one of joint_1");
    edit("robot.toml", "joint_7 = [-175, 175]\n", "");
    refused("limits.qd_deg_s.joint_7: expected");
    edit("robot.toml", "joint_7 = 135, ", "");
    refused("limits: missing field `q_m`, for joint `joint_7`");
    edit("robot.toml", "[limits]", "[limits]\nq_m = [-0.1, 0.2]\nqd_m_s = { joint_7 = 0.5 }");
    refused("manoeuvre.target.value_deg: expected value_m for joint `joint_7`");
    edit(
        "manoeuvres.toml",
        "{ joint = \"joint_7\", value_deg = 0 },\n    { joint = \"pendulum_1\", value_deg = 180 },\n    { joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients",
        "{ joint = \"joint_7\", value_m = 0 },\n    { joint = \"pendulum_1\", value_deg = 180 },\n    { joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients",
    );
    let path = dir.path().join("manoeuvres.toml");
    let manoeuvres = std::fs::read_to_string(&path).expect("exported");
    let swing_up = &manoeuvres[..manoeuvres.find("# A swing-up run backwards").expect("the next one")];
    std::fs::write(&path, swing_up).expect("written");
    edit("plant.toml", "bias_m = 0", "bias_m = 0.01");
    edit("plant.toml", "margin_m = 0.02", "margin_m = { joint_7 = 0.01 }");
    edit("plant.toml", "q_m = 0", "q_m = { joint_7 = 0.15 }");
    let config = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(config.model.joint_kind(6), JointKind::Prismatic);
    let (limits, stops) = (&config.robot.limits, &config.plant.stops);
    assert_eq!((limits.q_min[6], limits.q_max[6], limits.qd_max[6]), (-0.1, 0.2, 0.5));
    assert_eq!((limits.q_min[5], limits.qd_max[7]), (-120_f64.to_radians(), 180_f64.to_radians()));
    assert_eq!((stops.q_min[6], stops.q_max[6], config.plant.encoder.bias[6]), (-0.11, 0.2 + 0.01, 0.01));
    assert_eq!((config.plant.start.q[6], config.plant.start.q[3]), (0.15, -95_f64.to_radians()));
    edit("plant.toml", "joint_7 = 0.15", "joint_7 = 0.25");
    refused("start.q_m: expected a position from -0.1 to 0.2 m, got 0.25 for joint `joint_7`");
    edit("plant.toml", "joint_7 = 0.25", "joint_7 = 0.15");
    let grid = |axis: &str| {
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, format!("grid = [{{ joint = 'joint_7', {axis} }}]\n")).expect("write");
        let mut config = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}"));
        config.use_grid(0, &path).map(|()| config.manoeuvres[0].grid.clone()).map_err(|e| e.to_string())
    };
    assert_eq!(grid("from_m = 0, to_m = 0.2, points = 3").expect("a grid").pose(1)[6], 0.1);
    assert_eq!(grid("value_m = 0.1").expect("a grid").pose(0)[6], 0.1);
    for (axis, expected) in [
        ("from_deg = 0, to_deg = 1, points = 3", "grid.from_deg: expected from_m for joint `joint_7`"),
        (
            "from_m = 0, to_m = 0.3, points = 3",
            "grid.to_m: expected a position from -0.1 to 0.2 m, got 0.3 for joint `joint_7`",
        ),
    ] {
        let message = grid(axis).expect_err(axis);
        assert!(message.contains(expected), "no `{expected}` in: {message}");
    }
}

#[test]
fn keys_in_metres_without_a_prismatic_joint() {
    refused(
        "plant.toml",
        "bias_m = 0",
        "bias_m = { joint_1 = 0 }",
        &["encoder.bias_m.joint_1: expected `default` or no joint of this kind, got `joint_1`"],
    );
}
