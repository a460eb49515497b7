//! A robot description that is no chain with actuated and unactuated joints, or no possible body, is refused with the reason.

use upswing_model::{Model, UrdfError};

const ROBOT: &str = include_str!("../../config/systems/iiwa-pendulum/robot.urdf");

fn refusal(from: &str, to: &str) -> UrdfError {
    assert!(ROBOT.contains(from), "`{from}` is not in the robot description");
    Model::from_urdf(&ROBOT.replacen(from, to, 1)).expect_err("refused")
}

#[test]
fn other_texts() {
    assert!(matches!(Model::from_urdf("no robot"), Err(UrdfError::Parse(_))));
    assert!(matches!(Model::from_urdf("<robot name=\"r\"></robot>"), Err(UrdfError::NoRoot)));
}

/// The robot with the same effort of all joints.
fn with_effort(effort: &str) -> Result<Model, UrdfError> {
    let mut parts = ROBOT.split(" effort=\"");
    let mut text = parts.next().expect("a first part").to_owned();
    for part in parts {
        let rest = part.split_once('"').expect("the number ends").1;
        text += &format!(" effort=\"{effort}\"{rest}");
    }
    Model::from_urdf(&text)
}

#[test]
fn chains_without_a_motor_or_without_a_free_joint() {
    let e = with_effort("0").expect_err("no motor");
    assert!(matches!(e, UrdfError::NoActuatedJoint { .. }) && e.to_string().contains("joint_1"), "{e}");
    let e = with_effort("10").expect_err("no free joint");
    assert!(matches!(e, UrdfError::NoUnactuatedJoint { .. }), "{e}");
    assert!(e.to_string().contains("pendulum_2") && e.to_string().contains("effort=\"0\""), "{e}");
    let fixed = ROBOT.replace("type=\"revolute\"", "type=\"fixed\"");
    assert_eq!(Model::from_urdf(&fixed).expect_err("nothing moves"), UrdfError::NoJoint);
}

#[test]
fn joints_that_do_not_say_whether_they_have_a_motor() {
    let e = refusal(" effort=\"0\"", "").to_string();
    assert!(e.contains("pendulum_1") && e.contains("effort"), "{e}");
    let e = refusal(" effort=\"0\"", " effort=\"-3\"").to_string();
    assert!(e.contains("pendulum_1") && e.contains("-3 N m"), "{e}");
}

#[test]
fn more_joints_than_there_is_room_for() {
    let more: String = (0..8)
        .map(|i| {
            let parent = if i == 0 { "rod".to_owned() } else { format!("more_{}", i - 1) };
            format!(
                "<link name=\"more_{i}\"><inertial><mass value=\"1\"/><inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"0\" ixz=\"0\" \
                 iyz=\"0\"/></inertial></link><joint name=\"more_{i}\" type=\"continuous\"><parent link=\"{parent}\"/>\
                 <child link=\"more_{i}\"/><limit effort=\"0\" velocity=\"1\"/></joint>"
            )
        })
        .collect();
    let text = ROBOT.replace("</robot>", &format!("{more}</robot>"));
    assert_eq!(Model::from_urdf(&text).expect_err("refused"), UrdfError::TooManyJoints { got: 17 });
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
        (
            origin,
            "<origin xyz=\"0 NaN 0\" rpy=\"0 0 0\"/>",
            "origin xyz: expected 3 numbers of at most 100 m, got `0 NaN 0`",
        ),
        (origin, "<origin xyz=\"1e308 0 0\" rpy=\"0 0 0\"/>", "got `1e308 0 0`"),
        (origin, "<origin xyz=\"0 0\" rpy=\"0 0 0\"/>", "got `0 0`"),
        (origin, "<origin xyz=\"0 0 ${d}\" rpy=\"0 0 0\"/>", "got `0 0 ${d}`: expand the file with xacro"),
        (origin, "<origin rpy=\"0 0 0\" quat_xyzw=\"0 0 0 1\"/>", "got both"),
        (origin, "<origin quat_xyzw=\"0 0 0 0.1\"/>", "got `0 0 0 0.1`"),
        ("type=\"revolute\"", "type=\"floating\"", "got `floating`"),
        (origin, "<origin xyz=\"0 0 0\" rpy=\"inf 0 0\"/>", "got `inf 0 0`"),
        (
            "<axis xyz=\"0 0 1\"/>",
            "<axis xyz=\"0 0 NaN\"/>",
            "axis xyz: expected 3 numbers of at most 100, got `0 0 NaN`",
        ),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", "the axis is zero"),
    ] {
        let e = refusal(from, to).to_string();
        assert!(e.contains("joint_1") && e.contains(part), "{e}");
    }
}

#[test]
fn weightless_bodies() {
    let e = refusal("<mass value=\"3.94781\"/>", "<mass value=\"-1\"/>");
    assert!(e.to_string().contains("link_1") && e.to_string().contains("`-1`"), "{e}");
    let massless = r#"<mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>"#;
    let text = part("link", "link_1");
    let inertial = &text[text.find("<mass").unwrap()..text.find("</inertial>").unwrap()];
    let e = refusal(inertial, massless).to_string();
    assert!(e.contains("joint_1") && e.contains("mass above 0"), "{e}");
}

/// The text of a link or joint of the robot.
fn part(kind: &str, name: &str) -> &'static str {
    let start = ROBOT.find(&format!("<{kind} name=\"{name}\"")).expect("it is there");
    let end = ROBOT[start..].find(&format!("</{kind}>")).expect("it ends");
    &ROBOT[start..start + end + kind.len() + 3]
}

/// The refusal of a robot in which `from` of a link or joint is replaced.
fn refusal_in(kind: &str, name: &str, from: &str, to: &str) -> String {
    let old = part(kind, name);
    assert!(old.contains(from), "`{from}` is not in {old}");
    refusal(old, &old.replacen(from, to, 1)).to_string()
}

/// The refusal of a robot with something more.
fn refusal_with(more: &str) -> String {
    refusal("</robot>", &format!("{more}</robot>")).to_string()
}

#[test]
fn names_that_appear_twice() {
    let e = refusal_in("joint", "joint_4", "\"joint_4\"", "\"joint_3\"");
    assert!(e.contains("joint `joint_3`") && e.contains("a name of its own"), "{e}");
    let e = refusal_with("<link name=\"link_3\"/>");
    assert!(e.contains("link `link_3`") && e.contains("a name of its own"), "{e}");
    let e = refusal_with("<link/>");
    assert!(e.contains("link in line ") && e.contains("expected a name"), "{e}");
}

#[test]
fn two_roots() {
    for text in [
        "<link name=\"other\"/>",
        "<link name=\"other\"/><link name=\"o1\"/><joint name=\"oj\" type=\"revolute\"><parent link=\"other\"/><child link=\"o1\"/></joint>",
    ] {
        let e = refusal_with(text);
        assert!(e.contains("`world`") && e.contains("`other`"), "{e}");
    }
    let e = refusal("<link name=\"world\"/>", "<link name=\"other\"/><link name=\"world\"/>").to_string();
    assert!(e.contains("`world`") && e.contains("`other`"), "{e}");
}

#[test]
fn links_that_only_a_loop_carries() {
    let joint = |name, parent, child| {
        format!("<joint name='{name}' type='fixed'><parent link='{parent}'/><child link='{child}'/></joint>")
    };
    let e = refusal_with(&format!(
        "<link name='a'/><link name='b'/>{}{}",
        joint("to", "a", "b"),
        joint("fro", "b", "a")
    ));
    assert!(e.contains("link `a`") && e.contains("loop"), "{e}");
}

#[test]
fn branches() {
    let more =
        "<link name='b1'/><joint name='bj' type='revolute'><parent link='link_2'/><child link='b1'/></joint>";
    let e = refusal_with(more);
    assert!(e.contains("link `link_2`") && e.contains("joint_3, bj"), "{e}");
}

#[test]
fn coupled_joints() {
    let e = refusal_in("joint", "joint_5", "</joint>", "<mimic joint=\"joint_3\"/></joint>");
    assert!(
        e.contains("joint `joint_5`") && e.contains("joint `joint_3`") && e.contains("not supported yet"),
        "{e}"
    );
}

#[test]
fn limits_that_cannot_be() {
    let limit = "<limit lower=\"-2.0943951023931953\" upper=\"2.0943951023931953\" velocity=\"1.4835298641951802\" effort=\"320\"/>";
    for (to, expected) in [
        ("", "expected a <limit>"),
        ("<limit velocity=\"1\" effort=\"1\"/>", "got 0 and 0 rad"),
        ("<limit lower=\"1\" upper=\"-1\" velocity=\"1\" effort=\"1\"/>", "got 1 and -1 rad"),
        ("<limit lower=\"-1\" upper=\"1\" effort=\"1\"/>", "expected a velocity"),
        ("<limit lower=\"-1\" upper=\"1\" velocity=\"1\"/>", "expected an effort"),
        ("<limit lower=\"-1\" upper=\"1\" velocity=\"0\" effort=\"1\"/>", "got 0 rad/s"),
        ("<limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"-1\"/>", "got -1 N m"),
        ("<limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"nan\"/>", "got `nan`"),
        ("<limit lower=\"-1\" upper=\"1e7\" velocity=\"1\" effort=\"1\"/>", "got `1e7`"),
        (
            "<limit lower=\"-1,5\" upper=\"1\" velocity=\"1\" effort=\"1\"/>",
            "got `-1,5`: a number is written",
        ),
        (&format!("{limit}{limit}"), "expected one <limit>"),
    ] {
        let e = refusal_in("joint", "joint_2", limit, to);
        assert!(e.contains("joint `joint_2`") && e.contains(expected), "{to}: {e}");
    }
}

#[test]
fn bodies_that_cannot_be() {
    // Together with the rest of the flange they may look possible.
    let body = |mass: &str, inertia: &str| {
        format!(
            "<link name='bad'><inertial><mass value='{mass}'/><inertia ixx='{inertia}' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/>\
             </inertial></link><joint name='bad_joint' type='fixed'><parent link='tool_base'/><child link='bad'/></joint>"
        )
    };
    for (mass, inertia, got) in [
        ("-0.001", "1", "`-0.001`"),
        ("2,4", "1", "`2,4`"),
        ("1e6", "1", "`1e6`"),
        ("1", "-1", "ixx=-1"),
        ("1", "1e300", "`1e300`"),
        ("0", "1", "without a mass"),
    ] {
        let e = refusal_with(&body(mass, inertia));
        assert!(e.contains("link `bad`") && e.contains(got), "{e}");
    }
    let e = refusal_in(
        "link",
        "link_3",
        "<inertial>",
        "<inertial><origin xyz=\"0 0 1e200\"/></inertial><inertial>",
    );
    assert!(e.contains("link `link_3`") && e.contains("expected one <inertial>"), "{e}");
    let e = refusal_in("link", "link_2", "<mass value=\"4.50275\"/>", "");
    assert!(e.contains("link `link_2`") && e.contains("no <mass>"), "{e}");
    let e = refusal_in("link", "link_2", "ixz=\"0\"", "");
    assert!(e.contains("link `link_2`") && e.contains("ixz"), "{e}");
    let flat = r#"<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>"#;
    let old = part("link", "link_2");
    let inertia = &old[old.find("<inertia ").unwrap()..old.find("</inertial>").unwrap()];
    let e = refusal_in("link", "link_2", inertia, flat);
    assert!(e.contains("joint `joint_2`") && e.contains("positive definite"), "{e}");
}

#[test]
fn joints_that_are_not_whole() {
    for (from, to, expected) in [
        ("<parent link=\"link_2\"/>", "", "expected a <parent>"),
        ("<child link=\"link_3\"/>", "<child/>", "expected link="),
        (" type=\"revolute\"", "", "expected type="),
    ] {
        let e = refusal_in("joint", "joint_3", from, to);
        assert!(e.contains("joint `joint_3`") && e.contains(expected), "{e}");
    }
}
