//! A manoeuvre that the robot cannot perform, and a robot without a manoeuvre, are refused with the names of joints and the remedy.

mod common;
use common::{edit, export};
use std::path::Path;
use upswing_config::Config;

/// Exports a shipped system.
fn exported(name: &str) -> tempfile::TempDir {
    let system = name.parse().expect("a shipped system");
    export(&Config::load(&system).unwrap_or_else(|e| panic!("{e}")))
}

fn message(dir: &Path) -> String {
    match Config::from_dir(dir) {
        Ok(_) => panic!("accepted"),
        Err(e) => e.to_string(),
    }
}

fn contains(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "no `{part}` in: {message}");
    }
}

/// Makes one edit in a file of a shipped system and expects a message with all of `parts`.
fn refused(system: &str, file: &str, from: &str, to: &str, parts: &[&str]) {
    let dir = exported(system);
    edit(dir.path(), file, from, to);
    let message = message(dir.path());
    contains(&message, parts);
    assert!(message.contains(file) || file == "robot.urdf", "{message}");
}

/// As [`refused`], for the first manoeuvre of the cart-pole, alone in its file.
fn swing_up(target: &str, rest: &str, parts: &[&str]) {
    let dir = exported("cart-pole");
    let text = format!(
        "[[manoeuvre]]\nname = 'swing-up'\ntarget = [\n{target}\n]\n{rest}\ngrid = [\n{{ joint = 'cart', value_m = 0 }}]\n"
    );
    std::fs::write(dir.path().join("manoeuvres.toml"), text).expect("written");
    contains(&message(dir.path()), parts);
}

const UP: &str = "start = 'hanging'\nend = 'standing'";

#[test]
fn targets_that_are_no_equilibrium() {
    swing_up(
        "{ joint = 'cart', value_m = 0 },\n{ joint = 'pole', value_deg = 170 }",
        UP,
        &[
            "line 3",
            "manoeuvre.target: expected an equilibrium of the unactuated joints",
            "joint `pole` at rest accelerates with",
            "rad/s^2, at cart 0.0000 m, pole 170.0000 deg: change the rows",
        ],
    );
    // Without a row for the pole it may be anywhere.
    swing_up(
        "{ joint = 'cart', value_m = 0 }",
        UP,
        &["expected an equilibrium in which", "got one in which they are hanging"],
    );
    swing_up(
        "{ joint = 'cart', value_m = 0 }",
        "start = 'hanging'\nend = 'hanging'",
        &["joint `pole` at rest accelerates"],
    );
    refused(
        "iiwa-pendulum",
        "manoeuvres.toml",
        "{ joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients = { joint_2 = 1, joint_4 = -1, joint_6 = 1 }, value_deg = 90 },",
        "{ joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients = { joint_2 = 1, joint_4 = -1, joint_6 = 1 }, value_deg = 60 },",
        &["an equilibrium", "joint `pendulum_2` at rest accelerates"],
    );
    // One sign differs from that of the chain: an equilibrium with joint_4 at 0 only.
    refused(
        "iiwa-pendulum",
        "manoeuvres.toml",
        "{ joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients = { joint_2 = 1, joint_4 = -1, joint_6 = 1 }, value_deg = 90 },",
        "{ joint = \"pendulum_2\", value_deg = 0 },\n    { coefficients = { joint_2 = 1, joint_4 = 1, joint_6 = 1 }, value_deg = 90 },",
        &["an equilibrium", "at rest accelerates"],
    );
}

#[test]
fn ends_of_another_posture() {
    let parts =
        ["in which the unactuated joints are hanging, as `end` says, got one in which they are standing"];
    swing_up(
        "{ joint = 'cart', value_m = 0 },\n{ joint = 'pole', value_deg = 180 }",
        "start = 'hanging'\nend = 'hanging'",
        &parts,
    );
    let dir = exported("cart-double");
    // One pole stands, the other hangs.
    let text = "[[manoeuvre]]\nname = 'a'\nstart = 'hanging'\nend = 'hanging'\ntarget = [\n{ joint = 'cart', value_m = 0 },\n\
                { joint = 'pole_1', value_deg = 0 },\n{ joint = 'pole_2', value_deg = 180 }]\ngrid = [{ joint = 'cart', value_m = 0 }]\n";
    std::fs::write(dir.path().join("manoeuvres.toml"), text).expect("written");
    contains(&message(dir.path()), &parts);
}

#[test]
fn rows_that_depend_on_each_other() {
    let row = "{ joint = 'cart', value_m = 0 },\n{ joint = 'pole', value_deg = 180 },\n";
    swing_up(
        &format!("{row}{{ coefficients = {{ pole = 2 }}, value_deg = 360 }}"),
        UP,
        &["line 6", "pole = 2", "manoeuvre.target: expected a row that does not depend on the other rows"],
    );
    refused(
        "iiwa-pendulum",
        "manoeuvres.toml",
        "    { joint = \"joint_1\", value_deg = 0 },\n    { joint = \"joint_3\"",
        "    { coefficients = { joint_3 = 1, pendulum_1 = 1e-9 }, value_deg = 0 },\n    { joint = \"joint_3\"",
        &["manoeuvre.target: expected a row that does not depend on the other rows"],
    );
    swing_up(
        "{ joint = 'cart', value_m = 0 },\n{ joint = 'pole', value_deg = 0 },\n{ joint = 'pole', rest = true }",
        "start = 'hanging'\nend = 'hanging'",
        &["line 6", "depend on the other rows"],
    );
}

#[test]
fn a_rest_in_an_unknown_pose() {
    swing_up(
        "{ joint = 'pole', rest = true }",
        "start = 'hanging'\nend = 'hanging'",
        &["line 4", "expected rows that determine the position of joint `cart`, got none"],
    );
}

#[test]
fn values_outside_the_ranges() {
    swing_up(
        "{ joint = 'cart', value_m = 0.5 },\n{ joint = 'pole', value_deg = 180 }",
        UP,
        &[
            "manoeuvre.target.value_m: expected a value from -0.38665 to 0.38665 m, which the ranges of `cart` allow, got 0.5",
        ],
    );
    swing_up(
        "{ joint = 'cart', given = true, from_m = 0, to_m = 0.5, points = 2 },\n{ joint = 'pole', value_deg = 180 }",
        UP,
        &["manoeuvre.target.to_m: expected a position from -0.38665 to 0.38665 m, got 0.5 for joint `cart`"],
    );
}

#[test]
fn rows_that_are_none() {
    for (row, parts) in [
        ("{ joint = 'cart' }", &["manoeuvre.target: expected value_m, `given = true` or `rest = true`"][..]),
        (
            "{ joint = 'cart', value_deg = 0 }",
            &["manoeuvre.target.value_deg: expected value_m for joint `cart`"],
        ),
        (
            "{ joint = 'card', value_m = 0 }",
            &["manoeuvre.target.joint: expected one of cart, pole, got `card`"],
        ),
        ("{ value_m = 0 }", &["expected `joint`, one of cart, pole, got none"]),
        (
            "{ joint = 'pole', given = true, value_deg = 0 }",
            &["manoeuvre.target.joint: expected one of cart, got `pole`"],
        ),
        ("{ joint = 'cart', rest = true }", &["manoeuvre.target.joint: expected one of pole, got `cart`"]),
        ("{ joint = 'pole', rest = true, value_deg = 0 }", &["expected no value with `rest = true`"]),
        ("{ joint = 'pole', rest = true, given = true }", &["got two of them"]),
        (
            "{ joint = 'cart', coefficients = { cart = 1 }, value_m = 0 }",
            &["expected `joint` or `coefficients`, got both"],
        ),
        (
            "{ coefficients = { cart = 1, pole = 1 }, value_m = 0 }",
            &["coefficients: expected joints of one unit"],
        ),
        (
            "{ coefficients = { card = 1 }, value_m = 0 }",
            &["expected names of joints, cart, pole, got `card`"],
        ),
        ("{ coefficients = { cart = 0 }, value_m = 0 }", &["other than 0 for joint `cart`, got 0"]),
        ("{ coefficients = {}, value_m = 0 }", &["coefficients: expected at least one joint, got none"]),
        ("{ joint = 'cart', value = 0 }", &["manoeuvre.target.value", "unknown field `value`", "`value_m`"]),
    ] {
        swing_up(row, UP, &[&["line 4"], parts].concat());
    }
}

#[test]
fn names_and_reversals() {
    let dir = exported("cart-pole");
    let path = dir.path().join("manoeuvres.toml");
    let text = std::fs::read_to_string(&path).expect("exported");
    let with = |from: &str, to: &str, parts: &[&str]| {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replace(from, to)).expect("written");
        contains(&message(dir.path()), parts);
    };
    with("name = \"carry\"", "name = \"move\"", &["manoeuvre.name: expected another name", "`move` twice"]);
    for name in ["", "Move", "a b", "hold", "a/../b", &"a".repeat(33)] {
        with(
            "name = \"carry\"",
            &format!("name = \"{name}\""),
            &["manoeuvre.name: expected 1 to 32", &format!("got `{name}`")],
        );
    }
    with(
        "reverses = \"swing-up\"",
        "reverses = \"swing-down\"",
        &[
            "manoeuvre.reverses: expected the name of a manoeuvre with a target, one of swing-up, move, carry, got `swing-down`",
        ],
    );
    with("reverses = \"swing-up\"", "reverses = \"none\"", &["one of swing-up, move, carry, got `none`"]);
    with(
        "reverses = \"swing-up\"",
        "reverses = \"swing-up\"\nstart = \"hanging\"",
        &["expected no other keys than `name` and `reverses` for manoeuvre `swing-down`"],
    );
    with(
        "reverses = \"swing-up\"",
        "",
        &["missing `start` of manoeuvre `swing-down`, which has no `reverses`"],
    );
    with(
        "start = \"standing\"",
        "start = \"lying\"",
        &["manoeuvre.start", "`lying`", "`hanging` or `standing`"],
    );
    std::fs::write(&path, "").expect("written");
    contains(&message(dir.path()), &["missing field `manoeuvre`"]);
    std::fs::write(&path, "manoeuvre = []").expect("written");
    contains(&message(dir.path()), &["expected at least one manoeuvre, got none"]);
}

#[test]
fn grids_without_a_start() {
    swing_up(
        "{ joint = 'cart', value_m = 0 },\n{ joint = 'pole', value_deg = 0 }",
        "start = 'standing'\nend = 'hanging'",
        &[
            "manoeuvre.grid: expected poses in which the unactuated joints are standing within their ranges, got none",
        ],
    );
}

#[test]
fn ranges_in_which_an_unactuated_joint_moves_nothing() {
    // The rope of the crane may be so short that the load is at the axes of sway.
    let dir = exported("gantry-crane");
    edit(
        dir.path(),
        "robot.urdf",
        "<limit lower=\"0.4\" upper=\"1.6\"",
        "<limit lower=\"-0.1\" upper=\"1.6\"",
    );
    edit(dir.path(), "robot.toml", "hoist = [0.4, 1.6]", "hoist = [-0.1, 1.6]");
    edit(dir.path(), "robot.toml", "position_fraction_actuated = 0.98", "position_fraction_actuated = 1");
    for (from, to) in [("0 0 -0.1", "0 0 0"), ("0 0 -0.05", "0 0 0")] {
        let path = dir.path().join("robot.urdf");
        let text = std::fs::read_to_string(&path).expect("exported");
        std::fs::write(
            &path,
            text.replace(&format!("<origin xyz=\"{from}\""), &format!("<origin xyz=\"{to}\"")),
        )
        .expect("written");
    }
    let text = std::fs::read_to_string(dir.path().join("robot.urdf")).expect("exported");
    // Bodies without rotational inertia behind the first axis of sway, the fork.
    let (front, behind) = text.split_at(text.find("<link name=\"fork\">").expect("the fork"));
    let lighter: Vec<_> = behind
        .lines()
        .map(|line| {
            if line.contains("<inertia ") {
                "<inertia ixx=\"1e-9\" ixy=\"0\" ixz=\"0\" iyy=\"1e-9\" iyz=\"0\" izz=\"1e-9\"/>"
            } else {
                line
            }
        })
        .collect();
    std::fs::write(dir.path().join("robot.urdf"), format!("{front}{}", lighter.join("\n"))).expect("written");
    edit(dir.path(), "robot.toml", "hoist = [-0.1, 1.6]", "hoist = [0, 1.6]");
    edit(dir.path(), "robot.urdf", "<limit lower=\"-0.1\" upper=\"1.6\"", "<limit lower=\"0\" upper=\"1.6\"");
    contains(
        &message(dir.path()),
        &[
            "robot.toml",
            "limits: expected ranges in which the unactuated joint `sway_y` moves a mass",
            "got a singular M_UU, or nearly so, at",
            "hoist 0.0000 m",
            "narrow the ranges",
        ],
    );
}

#[test]
fn robots_without_joints_to_swing_or_to_drive() {
    // No free joint, no driven joint, two branches.
    refused(
        "cart-pole",
        "robot.urdf",
        "velocity=\"20.943951023931955\" effort=\"0\"",
        "velocity=\"20.943951023931955\" effort=\"1\"",
        &["robot.urdf", "effort"],
    );
    refused("cart-pole", "robot.urdf", "effort=\"17.9\"", "effort=\"0\"", &["robot.urdf", "effort"]);
    refused(
        "cart-pole",
        "robot.urdf",
        "</robot>",
        "<link name=\"second\"><inertial><mass value=\"1\"/><inertia ixx=\"1\" ixy=\"0\" ixz=\"0\" iyy=\"1\" iyz=\"0\" izz=\"1\"/></inertial></link>\n\
         <joint name=\"branch\" type=\"continuous\"><parent link=\"cart_body\"/><child link=\"second\"/><axis xyz=\"0 1 0\"/>\
         <limit velocity=\"1\" effort=\"0\"/></joint></robot>",
        &["robot.urdf", "pole", "branch"],
    );
}
