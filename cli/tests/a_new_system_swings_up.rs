//! `upswing system new` makes a system from a URDF that nobody prepared, which swings up without an edit; input that gives no system is
//! refused with one line on stderr, before a file is written.

mod common;

use common::{success, upswing};
use std::path::Path;

/// A cart with a pole that stands at 0 and turns freely although a motor is stated.
const URDF: &str = r#"<robot name="cart">
  <link name="rail"/>
  <joint name="slide" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="4" effort="40"/>
  </joint>
  <link name="cart"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="pole" type="continuous">
    <parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/>
    <limit velocity="30" effort="5"/>
  </joint>
  <link name="pole">
    <inertial><origin xyz="0 0 0.25"/><mass value="0.2"/><inertia ixx="0.005" ixy="0" ixz="0" iyy="0.005" iyz="0" izz="0.0001"/></inertial>
  </link>
</robot>"#;

fn plain(path: &Path) -> &str {
    path.to_str().expect("a plain path")
}

#[test]
fn without_an_edit() {
    let dir = tempfile::tempdir().expect("a folder");
    let (urdf, system) = (dir.path().join("cart.urdf"), dir.path().join("cart"));
    std::fs::write(&urdf, URDF).expect("written");
    let new = ["system", "new", plain(&system), "--urdf", plain(&urdf), "--free", "pole"];
    let made = success(&new);
    assert_eq!(made["files"].as_array().map(Vec::len), Some(6), "{made}");
    assert_eq!((&made["joints"][1]["hanging"], &made["joints"][1]["standing"]), (&180.0.into(), &0.0.into()));
    assert_eq!(made["manoeuvres"][0], "swing-up");
    assert!(made["to_decide"].as_array().is_some_and(|open| open.len() > 3), "{made}");
    success(&["config", "check", "--system", plain(&system)]);
    let picture = dir.path().join("demo.svg");
    let demo = [
        "demo",
        "--system",
        plain(&system),
        "--clock",
        "lockstep",
        "--seconds",
        "4",
        "--picture",
        plain(&picture),
    ];
    assert_eq!(success(&demo)["success"], true);
    // The folder has files now.
    refused(&new, &["cart: expected a new or empty folder, got one with files", "choose another name"]);
}

#[test]
fn unless_the_input_gives_no_system() {
    let dir = tempfile::tempdir().expect("a folder");
    let (urdf, system) = (dir.path().join("cart.urdf"), dir.path().join("cart"));
    std::fs::write(&urdf, URDF).expect("written");
    std::fs::write(dir.path().join("file"), "").expect("written");
    let new = |more: &[&'static str], parts: &[&str]| {
        let args = [&["system", "new", plain(&system), "--urdf", plain(&urdf)], more].concat();
        refused(&args, parts);
        assert!(!system.exists(), "{more:?}");
    };
    new(&[], &["cart.urdf", "expected a joint without a motor, got none", "slide, pole", "--free JOINT"]);
    new(&["--free", "rod"], &["expected a joint of the robot, one of slide, pole; got `rod`"]);
    new(&["--free", "slide", "pole"], &["expected a joint with a motor, got none among slide, pole"]);
    new(
        &["--free", "pole", "--tip", "hand"],
        &["expected a link of the robot, one of rail, cart, pole; got `hand`"],
    );
    new(&["--free", "pole", "--tip", "rail"], &["got none: all joints are fixed"]);
    refused(&["system", "new", plain(&system)], &["--urdf"]);
    refused(
        &["system", "new", plain(&system), "--urdf", "/nonexistent.urdf"],
        &["--urdf: /nonexistent.urdf: cannot be read"],
    );
    refused(
        &["system", "new", plain(&dir.path().join("file")), "--urdf", plain(&urdf), "--free", "pole"],
        &["file: expected a new or empty folder"],
    );
    std::fs::write(&urdf, "<mujoco/>").expect("written");
    new(&[], &["cart.urdf", "expected <robot>", "convert"]);
    std::fs::write(&urdf, [0xff, 0xfe]).expect("written");
    new(&[], &["cart.urdf", "UTF-8"]);
}

/// Expects exit code 2 and one error line with all of `parts`.
fn refused(args: &[&str], parts: &[&str]) {
    let output = upswing(args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
    assert!(output.stdout.is_empty(), "{args:?} printed on stdout");
    assert_eq!(stderr.lines().filter(|line| line.starts_with("error:")).count(), 1, "{args:?}: {stderr}");
    for part in parts {
        assert!(stderr.contains(part), "{args:?}: expected `{part}` in: {stderr}");
    }
}
