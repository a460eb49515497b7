//! A robot description that is no chain of nine revolute joints, or no possible body, is refused with the reason.

use upswing_model::{Model, UrdfError};

const ROBOT: &str = include_str!("../../config/robot.urdf");

fn refusal(from: &str, to: &str) -> UrdfError {
    assert!(ROBOT.contains(from), "`{from}` is not in the robot description");
    Model::from_urdf(&ROBOT.replacen(from, to, 1)).expect_err("refused")
}

#[test]
fn other_texts() {
    assert!(matches!(Model::from_urdf("no robot"), Err(UrdfError::Parse(_))));
    assert!(matches!(Model::from_urdf("<robot name=\"r\"></robot>"), Err(UrdfError::NoRoot)));
}

#[test]
fn another_number_of_joints() {
    let e = refusal(
        "<joint name=\"pendulum_2\" type=\"revolute\">",
        "<joint name=\"pendulum_2\" type=\"fixed\">",
    );
    assert!(matches!(e, UrdfError::JointCount { got: 8 }), "{e}");
}

#[test]
fn joints_that_slide() {
    let e =
        refusal("<joint name=\"joint_3\" type=\"revolute\">", "<joint name=\"joint_3\" type=\"prismatic\">");
    assert!(e.to_string().contains("joint_3") && e.to_string().contains("prismatic"), "{e}");
}

#[test]
fn joints_to_nowhere() {
    for (from, to) in [
        ("<child link=\"link_3\"/>", "<child link=\"elsewhere\"/>"),
        ("<parent link=\"link_2\"/>", "<parent link=\"elsewhere\"/>"),
    ] {
        let e = refusal(from, to).to_string();
        assert!(e.contains("joint_3") && e.contains("no link `elsewhere`"), "{e}");
    }
}

#[test]
fn a_link_on_two_joints() {
    let e = refusal("<child link=\"link_3\"/>", "<child link=\"link_2\"/>").to_string();
    assert!(e.contains("joint_3") && e.contains("`link_2`") && e.contains("joint_2"), "{e}");
}

#[test]
fn a_loop() {
    // From the root fixed joints lead round and round.
    let link = |name: &str| format!("<link name=\"{name}\"/>");
    let joint = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name=\"{name}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/></joint>"
        )
    };
    let text = format!(
        "<robot name=\"r\">{}{}{}{}{}{}</robot>",
        link("root"),
        link("a"),
        link("b"),
        joint("in", "root", "a"),
        joint("there", "a", "b"),
        joint("back", "b", "a"),
    );
    let e = Model::from_urdf(&text).expect_err("refused").to_string();
    assert!(e.contains("back") && e.contains("`a`"), "{e}");
}

#[test]
fn places_and_axes_that_are_no_numbers() {
    let origin = "<origin xyz=\"0 0 0.1525\" rpy=\"0 0 0\"/>";
    for (from, to, part) in [
        (origin, "<origin xyz=\"0 NaN 0\" rpy=\"0 0 0\"/>", "xyz, got [0.0, NaN, 0.0]"),
        (origin, "<origin xyz=\"0 0 0\" rpy=\"inf 0 0\"/>", "rpy, got [inf, 0.0, 0.0]"),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 NaN\"/>", "axis, got [0.0, 0.0, NaN]"),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", "the axis is zero"),
    ] {
        let e = refusal(from, to).to_string();
        assert!(e.contains("joint_1") && e.contains(part), "{e}");
    }
}

#[test]
fn weightless_bodies() {
    let e = refusal("<mass value=\"3.94781\"/>", "<mass value=\"-1\"/>");
    assert!(e.to_string().contains("joint_1") && e.to_string().contains("-1"), "{e}");
}
