//! Robot descriptions of other programs: what a robot's motion does not depend on is skipped, what is too much for a robot is
//! refused, and nothing overflows the stack.

use upswing_model::{JointVector, Model, Urdf, UrdfError};

const ROBOT: &str = include_str!("../../config/systems/iiwa-pendulum/robot.urdf");

fn with(more: &str) -> String {
    ROBOT.replace("</robot>", &format!("{more}</robot>"))
}

/// The robot is the shipped one, and these are the warnings.
fn warnings(text: &str) -> Vec<String> {
    let urdf = Urdf::read(text).unwrap_or_else(|e| panic!("{e}"));
    let model = Model::from_description(&urdf).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(model.fingerprint(), Model::from_urdf(ROBOT).expect("the robot").fingerprint());
    urdf.warnings
}

#[test]
fn the_shipped_robot_gives_no_warning() {
    assert_eq!(warnings(ROBOT), Vec::<String>::new());
}

#[test]
fn deep_nesting_is_skipped() {
    let depth = 20_000;
    let text = with(&("<a>".repeat(depth) + &"</a>".repeat(depth)));
    assert_eq!(warnings(&text).len(), 1);
    let inside =
        ROBOT.replacen("</visual>", &format!("{}{}</visual>", "<a>".repeat(depth), "</a>".repeat(depth)), 1);
    assert_eq!(warnings(&inside), Vec::<String>::new());
    let open = "<a>".repeat(400_000);
    assert!(matches!(Urdf::read(&open), Err(UrdfError::Parse(_))));
}

#[test]
fn more_than_any_robot_has_is_refused() {
    let number = |n| format!("<link name=\"l{n}\"/><joint name=\"j{n}\" type=\"fixed\"/>");
    let links: String = (0..50_000).map(number).collect();
    let attributes: String = (0..100_000).map(|n| format!(" a{n}=\"\"")).collect();
    let spaces: String = (0..10_000).map(|n| format!("<a xmlns:n{n}=\"{n}\">")).collect();
    for (text, what) in [
        (with(&"<a/>".repeat(200_000)), "elements"),
        (with(&links), "elements"),
        (with(&format!("<a{attributes}/>")), "attributes"),
        (with(&spaces), "name spaces"),
        (" ".repeat(5 << 20), "bytes"),
    ] {
        let e = Urdf::read(&text).expect_err("too much").to_string();
        assert!(e.contains(what) && e.contains("at most"), "{e}");
    }
}

#[test]
fn long_chains_are_read() {
    // In the worst order for whoever looks for parents in the order of the file.
    let n = 10_000;
    let link = |i| format!("<link name=\"x{i}\"/>");
    let joint = |i| {
        let parent = if i == 0 { "base".to_owned() } else { format!("x{}", i - 1) };
        format!(
            "<joint name=\"y{i}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"x{i}\"/></joint>"
        )
    };
    let more: String = (0..n).rev().map(link).chain((0..n).rev().map(joint)).collect();
    assert_eq!(warnings(&with(&more)), Vec::<String>::new());
}

#[test]
fn entities_are_refused() {
    let text = format!("<!DOCTYPE r [<!ENTITY a \"b\">]>{}", &ROBOT[ROBOT.find("<robot").unwrap()..]);
    assert!(matches!(Urdf::read(&text), Err(UrdfError::Parse(_))));
}

#[test]
fn what_other_programs_need_is_skipped() {
    let text = with(
        "<gazebo reference=\"link_1\"><mu1>0.2</mu1></gazebo><transmission name=\"t\"/><ros2_control name=\"c\" type=\"system\"/>\
         <material name=\"paint\"><texture filename=\"a.png\"/></material>",
    );
    let mesh = "<visual><geometry><mesh filename=\"package://a.stl\" scale=\"1 1 x\"/></geometry></visual><collision/>";
    let text = text.replace("<link name=\"world\"/>", &format!("<link name=\"world\">{mesh}</link>"));
    assert_eq!(warnings(&text), Vec::<String>::new());
    let vendor = text.replace("<robot ", "<robot xmlns:drake=\"http://drake.mit.edu\" ");
    assert_eq!(
        warnings(&vendor.replace("</robot>", "<drake:joint name=\"d\"/></robot>")),
        Vec::<String>::new()
    );
}

#[test]
fn a_root_link_may_be_named_only_or_have_no_mass() {
    let root = "<link name=\"world\"/>";
    assert!(ROBOT.contains(root));
    assert_eq!(warnings(&ROBOT.replace(root, "")), Vec::<String>::new());
    let inertia = r#"<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>"#;
    let massless = format!("<link name=\"world\"><inertial><mass value=\"0\"/>{inertia}</inertial></link>");
    assert_eq!(warnings(&ROBOT.replace(root, &massless)), Vec::<String>::new());
}

#[test]
fn a_speed_of_0_without_a_motor_is_none() {
    let at = ROBOT.find("<joint name=\"pendulum_1\"").expect("the pendulum");
    let (front, behind) = ROBOT.split_at(at);
    let from = behind.find("velocity=\"").expect("a speed") + "velocity=\"".len();
    let to = from + behind[from..].find('"').expect("its end");
    let text = format!("{front}{}0{}", &behind[..from], &behind[to..]);
    let model = Model::from_urdf(&text).unwrap_or_else(|e| panic!("{e}"));
    assert!(model.rated_limits().qd_max[7].is_infinite());
}

#[test]
fn what_may_change_the_robot_is_told() {
    let joint = "<axis xyz=\"0 0 1\"/>";
    let text = ROBOT.replacen(
        joint,
        &format!("{joint}<dynamics damping=\"0.5\" friction=\"0\"/><safety_controller k_velocity=\"1\"/>"),
        1,
    );
    let told = warnings(&text);
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(
        told[0].contains("joint_1") && told[0].contains("damping `0.5`") && told[0].contains("plant.toml"),
        "{told:?}"
    );
    assert!(told[1].contains("joint_1") && told[1].contains("safety_controller"), "{told:?}");
    let xacro = with("<xacro:include filename=\"a\"/>")
        .replace("<robot ", "<robot xmlns:xacro=\"http://ros.org/wiki/xacro\" ");
    let told = warnings(&xacro);
    assert!(told.len() == 1 && told[0].contains("xacro:include") && told[0].contains("expand"), "{told:?}");
    let told = warnings(&with("<lnk name=\"a\"/>"));
    assert!(told.len() == 1 && told[0].contains("<lnk> in line"), "{told:?}");
    let many: String = (0..1000).map(|n| format!("<a{n}/>")).collect();
    assert_eq!(warnings(&with(&many)).len(), 20);
}

#[test]
fn other_formats_are_named() {
    for (text, parts) in [
        ("<sdf version='1.7'><model name='m'/></sdf>", ["<robot>", "<sdf>", "URDF"]),
        ("<mujoco/>", ["<robot>", "<mujoco>", "URDF"]),
        (&ROBOT[..ROBOT.find("</joint>").unwrap()], ["complete", "in line", "joint `ceiling_mount`"]),
        (
            &ROBOT.replace("<child link=\"link_3\"/>", "<child link=\"link_3\">"),
            ["not a readable", ":", "joint `joint_3`"],
        ),
    ] {
        let e = Urdf::read(text).expect_err("refused").to_string();
        assert!(parts.iter().all(|part| e.contains(part)), "{e}");
    }
}

#[test]
fn the_pendulum_may_turn_without_limit() {
    let (a, b) = ROBOT.split_at(ROBOT.find("<joint name=\"pendulum_1\"").unwrap());
    let end = b.find("</joint>").unwrap();
    let limit = &b[b.find("<limit").unwrap()..end];
    let text = format!("{a}{}", b.replacen(limit, "", 1).replacen("revolute", "continuous", 1));
    let model = Model::from_urdf(&text).unwrap_or_else(|e| panic!("{e}"));
    let (limits, stated) = (*model.rated_limits(), *Model::from_urdf(ROBOT).unwrap().rated_limits());
    assert_eq!(
        (limits.q_min[7], limits.q_max[7], limits.qd_max[7]),
        (f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY)
    );
    let others =
        |v: &JointVector| v.iter().enumerate().filter(|(i, _)| *i != 7).map(|(_, v)| *v).collect::<Vec<_>>();
    assert_eq!(others(&limits.q_max), others(&stated.q_max));
    let scale = limits.scale();
    assert_eq!((scale.q_min[7], scale.q_max[7]), (-std::f64::consts::PI, std::f64::consts::PI));
    assert_eq!(scale.q_max[8], stated.q_max[8]);
}

#[test]
fn orientations_may_be_quaternions() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rpy = "<origin xyz=\"0 0 0.2025\" rpy=\"-1.5707963267948966 0 0\"/>";
    assert!(ROBOT.contains(rpy));
    let text =
        ROBOT.replacen(rpy, &format!("<origin xyz=\"0 0 0.2025\" quat_xyzw=\"-{half} 0 0 {half}\"/>"), 1);
    let (a, b) = (Model::from_urdf(ROBOT).unwrap(), Model::from_urdf(&text).unwrap());
    let q = JointVector::repeat(a.sizes(), 0.3);
    assert!((a.tip(&q) - b.tip(&q)).norm() < 1e-12);
}
