//! A URDF becomes a folder of settings that load as they are, with manoeuvres that end in equilibria of the model.

use std::path::Path;
use upswing_config::{Changes, Config, ConfigError, NewSystem, System, TargetValue};
use upswing_model::Posture;

const CART_POLE: &str = include_str!("../systems/cart-pole/robot.urdf");

/// A cart with a pole that stands at 0, with a root link as some programs mark it, and without range, speed and effort of the pole.
const STANDS_AT_ZERO: &str = r#"<robot name="cart">
  <link name="rail"><inertial><mass value="0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="slide" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
    <dynamics damping="0.5"/>
    <limit lower="-3" upper="2" velocity="4" effort="50"/>
  </joint>
  <link name="cart"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="the pole" type="continuous">
    <parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/>
    <dynamics damping="0.01" friction="0.002"/>
  </joint>
  <link name="pole">
    <inertial><origin xyz="0 0 0.5"/><mass value="0.5"/><inertia ixx="0.04" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.001"/></inertial>
  </link>
</robot>"#;

fn new(urdf: &str) -> NewSystem {
    NewSystem::new("machine.urdf", urdf, &Changes::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn refusal(urdf: &str, changes: &Changes) -> String {
    match NewSystem::new("machine.urdf", urdf, changes) {
        Err(e) => e.to_string(),
        Ok(system) => panic!("accepted: {system:?}"),
    }
}

/// The settings in the files of a system.
fn load(system: &NewSystem) -> Result<Config, ConfigError> {
    let dir = tempfile::tempdir().expect("a folder");
    write(system, dir.path());
    Config::from_dir(dir.path())
}

fn write(system: &NewSystem, dir: &Path) {
    for (name, text) in &system.files {
        std::fs::write(dir.join(name), text).expect("written");
    }
}

#[test]
fn that_of_each_shipped_machine() {
    for shipped in System::shipped() {
        let name = shipped.name();
        let known = Config::load(&System::Shipped(shipped)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let system = NewSystem::new("robot.urdf", &known.urdf, &Changes::default());
        let system = system.unwrap_or_else(|e| panic!("{name}: {e}"));
        let config = load(&system).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(config.urdf, known.urdf, "{name}");
        // Ranges of joints that turn over are assumed as they are in the shipped systems.
        assert_eq!(config.robot.limits.tau_max, known.robot.limits.tau_max, "{name}");
        let difference = (config.robot.limits.q_max - known.robot.limits.q_max).amax();
        assert!(difference < 1e-6, "{name}: {difference}");
        let names: Vec<_> = config.manoeuvres.iter().map(|manoeuvre| manoeuvre.name.as_str()).collect();
        assert_eq!(names, system.manoeuvres, "{name}");
        let first = &config.manoeuvres[0];
        // The forks of the crane's sway angles leave no room for a swing-up.
        let (expected, end) = match name {
            "gantry-crane" => ("move", Posture::Hanging),
            _ => ("swing-up", Posture::Standing),
        };
        assert_eq!((first.name.as_str(), first.end), (expected, end), "{name}");
        assert_eq!(system.to_decide.iter().any(|open| open.contains("no swing-up")), expected == "move");
    }
}

#[test]
fn complete_and_with_comments() {
    let dir = tempfile::tempdir().expect("a folder");
    let system = new(STANDS_AT_ZERO);
    write(&system, dir.path());
    let config = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{e}"));
    for (name, text) in config.texts().expect("texts") {
        let (_, written) = system.files.iter().find(|(of_system, _)| *of_system == name).expect("a file");
        assert_eq!(*written, text, "{name}");
        if name != "robot.urdf" {
            let (first, comments) = (text.lines().next().unwrap_or_default(), text.matches("\n# ").count());
            assert!(first.starts_with("# ") && comments > 5, "{name}: {first}, {comments} comments");
        }
    }
}

#[test]
fn whose_zero_is_upright() {
    let system = new(STANDS_AT_ZERO);
    let pole = &system.joints[1];
    assert_eq!((pole.name.as_str(), pole.is_actuated, pole.range), ("the pole", false, [-360.0, 360.0]));
    assert_eq!((pole.hanging, pole.standing), (180.0, Some(0.0)));
    // The middle of the range.
    assert_eq!((system.joints[0].hanging, system.joints[0].range), (-0.5, [-3.0, 2.0]));
    assert_eq!(system.manoeuvres, ["swing-up", "swing-down", "move", "carry"]);
    let config = load(&system).unwrap_or_else(|e| panic!("{e}"));
    let start = config.start_state(&[-0.5], upswing_config::PendulumStart::Rest).expect("it hangs");
    assert!((start.q_u()[0] - std::f64::consts::PI).abs() < 1e-9, "{start:?}");
    assert!(matches!(config.manoeuvres[0].target[1].value, TargetValue::Fixed(value) if value == 0.0));
    // Twice the speed of a fall: sqrt(2 * 2 m g l / J), J about the pivot.
    let fall = (4.0 * 0.5 * 9.81 * 0.5 / (0.04_f64 + 0.5 * 0.25)).sqrt();
    assert!((1.0..1.1).contains(&(pole.speed.to_radians() / (2.0 * fall))), "{} deg/s", pole.speed);
}

#[test]
fn with_the_friction_that_it_states() {
    let config = load(&new(STANDS_AT_ZERO)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(config.plant.friction.viscous.to_vec(), [0.5, 0.01]);
    assert_eq!(config.plant.friction.coulomb.to_vec(), [0.0, 0.002]);
    let open = new(STANDS_AT_ZERO).to_decide;
    assert!(!open.iter().any(|open| open.contains("friction")), "{open:?}");
    let open = new(CART_POLE).to_decide;
    assert!(open.iter().any(|open| open.contains("friction of the free joints")), "{open:?}");
}

#[test]
fn and_what_it_leaves_open_is_told() {
    let system = new(STANDS_AT_ZERO);
    for part in [
        "`the pole`: the URDF has no range",
        "`the pole`: the URDF has no speed",
        "without motor: `the pole`",
    ] {
        assert!(system.to_decide.iter().any(|open| open.contains(part)), "{part}: {:?}", system.to_decide);
    }
    let extra = STANDS_AT_ZERO.replace("</robot>", "<loop_joint name=\"a\"/></robot>");
    let ignored = new(&extra).ignored;
    assert!(ignored.len() == 1 && ignored[0].contains("<loop_joint> in line"), "{ignored:?}");
}

#[test]
fn whose_free_joints_are_named() {
    let motor = r#"<limit lower="-7" upper="7" velocity="30" effort="5"/>"#;
    let urdf = STANDS_AT_ZERO.replace("<axis xyz=\"0 1 0\"/>", &format!("<axis xyz=\"0 1 0\"/>{motor}"));
    let message = refusal(&urdf, &Changes::default());
    assert!(message.contains("machine.urdf") && message.contains("without a motor"), "{message}");
    assert!(message.contains("slide, the pole") && message.contains("--free JOINT"), "{message}");
    let changes = Changes { free: vec!["the pole".into()], tip: None };
    let system = NewSystem::new("machine.urdf", &urdf, &changes).unwrap_or_else(|e| panic!("{e}"));
    // Nothing else changes.
    assert_eq!(system.files[0].1, urdf.replace("effort=\"5\"", "effort=\"0\""));
    let config = load(&system).unwrap_or_else(|e| panic!("{e}"));
    assert!((config.robot.limits.qd_max.unactuated()[0] - 30.0).abs() < 1e-6);
    let message = refusal(&urdf, &Changes { free: vec!["pole".into()], tip: None });
    assert!(message.contains("one of slide, the pole") && message.contains("got `pole`"), "{message}");
}

#[test]
fn whose_other_branches_are_fixed() {
    let finger = |side: &str| {
        format!(
            r#"<joint name="{side} finger" type="prismatic"><parent link="cart"/><child link="{side}"/>
               <limit lower="0" upper="1" velocity="1" effort="1"/><mimic joint="slide"/></joint>
               <link name="{side}"><inertial><mass value="0.1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>"#
        )
    };
    let branches = format!("{}{}</robot>", finger("left"), finger("right"));
    let urdf = STANDS_AT_ZERO.replace("</robot>", &branches);
    let without_mimic = urdf.replace("<mimic joint=\"slide\"/>", "");
    let message = refusal(&without_mimic, &Changes::default());
    for part in ["link `cart`", "the pole, left finger, right finger", "--tip LINK", "pole or left or right"]
    {
        assert!(message.contains(part), "{part}: {message}");
    }
    let changes = Changes { free: Vec::new(), tip: Some("pole".into()) };
    let system = NewSystem::new("machine.urdf", &urdf, &changes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(system.joints.len(), 2);
    assert_eq!(system.files[0].1.matches("type=\"fixed\"").count(), 2);
    let mass = |config: &Config| {
        let work = &mut upswing_model::Workspace::default();
        config.model.mass_matrix(&upswing_model::JointVector::zeros(config.model.sizes()), work)[(0, 0)]
    };
    let [with, without] =
        [&system, &new(STANDS_AT_ZERO)].map(|system| mass(&load(system).unwrap_or_else(|e| panic!("{e}"))));
    assert!((with - without - 0.2).abs() < 1e-12, "{with} {without}");
    let message = refusal(&urdf, &Changes { free: Vec::new(), tip: Some("hand".into()) });
    assert!(
        message.contains("one of rail, cart, pole, left, right") && message.contains("got `hand`"),
        "{message}"
    );
}

#[test]
fn unless_nothing_hangs_in_it() {
    // A pole that turns about the vertical.
    let urdf = STANDS_AT_ZERO.replace("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 1\"/>");
    let message = refusal(&urdf, &Changes::default());
    assert!(message.contains("expected a pose in which the unactuated joints hang"), "{message}");
    assert!(message.contains("got none of") && message.contains("-z of the root link"), "{message}");
}
