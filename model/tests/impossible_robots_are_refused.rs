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
fn weightless_bodies() {
    let e = refusal("<mass value=\"3.94781\"/>", "<mass value=\"-1\"/>");
    assert!(e.to_string().contains("joint_1") && e.to_string().contains("-1"), "{e}");
}
