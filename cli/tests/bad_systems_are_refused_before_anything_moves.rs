//! A folder that is no system (a robot that is no chain with free and driven joints, targets that are none, names that do not exist, a
//! database of another system) gives one line on stderr: file, place, expected, got and remedy, by names. Every command that would plan or
//! move refuses it with exit code 2 before it starts a process or writes a file.

mod common;

use common::upswing;
use std::path::{Path, PathBuf};
use upswing_config::{Config, System};

/// A copy of a shipped system.
struct Folder {
    dir: tempfile::TempDir,
}

impl Folder {
    fn of(system: &str) -> Self {
        let dir = tempfile::tempdir().expect("a folder");
        let system: System = system.parse().expect("a shipped system");
        let config = Config::load(&system).unwrap_or_else(|e| panic!("{e}"));
        upswing_planner::export(&config, &dir.path().join("system"), Default::default()).expect("exported");
        Self { dir }
    }

    fn path(&self) -> PathBuf {
        self.dir.path().join("system")
    }

    /// Replaces text, which must occur exactly once.
    fn edit(self, file: &str, from: &str, to: &str) -> Self {
        let path = self.path().join(file);
        let text = std::fs::read_to_string(&path).expect("a file");
        assert_eq!(text.matches(from).count(), 1, "`{from}` in {file}");
        std::fs::write(path, text.replace(from, to)).expect("written");
        self
    }

    /// The one error that all commands give; it has all of `parts`.
    fn refused(&self, start: &str, parts: &[&str]) {
        let (system, picture) = (self.path(), self.dir.path().join("picture.svg"));
        let system = system.to_str().expect("a plain path");
        let picture_path = picture.to_str().expect("a plain path");
        let commands: [&[&str]; 7] = [
            &["demo", "--picture", picture_path],
            &["plan", "--start", start],
            &["montecarlo", "replan", "--samples", "1"],
            &["config", "check"],
            &["daemon", "--domain", "bad-system"],
            &["planner", "--domain", "bad-system"],
            &["plant", "--domain", "bad-system"],
        ];
        for command in commands {
            // Files of databases are read by those that plan.
            let needs_database = matches!(command[0], "demo" | "plan" | "montecarlo" | "planner");
            if parts.contains(&"swing-up.bin") && !needs_database {
                continue;
            }
            let output = upswing(&[command, &["--system", system]].concat());
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{command:?}: {stderr}");
            assert!(output.stdout.is_empty(), "{command:?} printed on stdout");
            let errors: Vec<_> = stderr.lines().filter(|line| line.starts_with("error:")).collect();
            assert_eq!(errors.len(), 1, "{command:?}: {stderr}");
            for part in parts {
                assert!(errors[0].contains(part), "{command:?}: expected `{part}` in: {stderr}");
            }
            assert!(!picture.exists(), "{command:?} wrote a picture");
        }
    }
}

const CART_POLE: (&str, &str) = ("cart-pole", "0");

#[test]
fn a_chain_with_two_branches() {
    let (system, start) = CART_POLE;
    let branch = r#"<joint name="arm" type="continuous"><parent link="cart_body"/><child link="hand"/><axis xyz="0 1 0"/></joint>
        <link name="hand"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"#;
    Folder::of(system).edit("robot.urdf", "</robot>", branch).refused(
        start,
        &[
            "robot.urdf",
            "expected one unbranched chain",
            "a link `cart_body`",
            "pole, arm",
            "type=\"fixed\"",
            "--tip LINK",
        ],
    );
}

#[test]
fn no_free_joint() {
    let (system, start) = CART_POLE;
    Folder::of(system).edit("robot.urdf", "effort=\"0\"", "effort=\"5\"").refused(
        start,
        &[
            "robot.urdf",
            "expected a joint without a motor, got none",
            "effort=\"0\"",
            "cart, pole",
            "--free JOINT",
        ],
    );
}

#[test]
fn no_driven_joint() {
    let (system, start) = CART_POLE;
    Folder::of(system).edit("robot.urdf", "effort=\"17.9\"", "effort=\"0\"").refused(
        start,
        &["robot.urdf", "expected a joint with a motor, got none among cart, pole", "effort=", "velocity="],
    );
}

#[test]
fn a_target_that_is_no_equilibrium() {
    let (system, start) = CART_POLE;
    let (from, to) = (
        "    { joint = \"pole\", value_deg = 180 },\n]\ngrid = [{ joint = \"cart\", from_m = -0.2",
        "value_deg = 170 },",
    );
    let to = from.replace("value_deg = 180 },", to);
    Folder::of(system).edit("manoeuvres.toml", from, &to).refused(
        start,
        &[
            "manoeuvres.toml, line",
            "target",
            "expected an equilibrium of the unactuated joints",
            "`pole` at rest accelerates",
            "at cart 0.0000 m, pole 170.0000 deg",
            "change the rows",
        ],
    );
}

#[test]
fn rows_that_depend_on_each_other() {
    let (system, start) = CART_POLE;
    Folder::of(system)
        .edit(
            "manoeuvres.toml",
            "    { joint = \"cart\", value_m = 0 },\n",
            "    { joint = \"cart\", value_m = 0 },\n    { coefficients = { cart = 2 }, value_m = 0 },\n",
        )
        .refused(
            start,
            &[
                "manoeuvres.toml, line",
                "cart = 2",
                "expected a row that does not depend on the other rows",
                "`cart`",
                "remove it",
            ],
        );
}

#[test]
fn a_singular_inertia_in_the_range() {
    // A point mass on a rope whose length passes 0 between its ends.
    let folder = Folder::of("gantry-crane");
    let urdf = folder.path().join("robot.urdf");
    let text = std::fs::read_to_string(&urdf).expect("a file");
    let (front, behind) = text.split_at(text.find("<link name=\"fork\">").expect("the fork"));
    let point = |line: &str| match line.trim_start() {
        line if line.starts_with("<inertia ") => {
            r#"<inertia ixx="1e-9" ixy="0" ixz="0" iyy="1e-9" iyz="0" izz="1e-9"/>"#.to_owned()
        }
        line => line
            .replace("<origin xyz=\"0 0 -0.1\"", "<origin xyz=\"0 0 0\"")
            .replace("<origin xyz=\"0 0 -0.05\"", "<origin xyz=\"0 0 0\""),
    };
    let behind: Vec<_> = behind.lines().map(point).collect();
    std::fs::write(&urdf, format!("{front}{}", behind.join("\n"))).expect("written");
    folder
        .edit("robot.urdf", "lower=\"0.4\" upper=\"1.6\"", "lower=\"-0.5\" upper=\"1.6\"")
        .edit("robot.toml", "hoist = [0.4, 1.6]", "hoist = [-0.5, 1.6]")
        .refused(
            "0,0,1",
            &[
                "robot.toml",
                "limits",
                "`sway_y`",
                "got a singular M_UU",
                "hoist",
                "0.0000 m",
                "narrow the ranges",
            ],
        );
}

#[test]
fn names_that_do_not_exist() {
    let (system, start) = CART_POLE;
    Folder::of(system)
        .edit("robot.toml", "qd_deg_s = { pole = 1200 }", "qd_deg_s = { pol = 1200 }")
        .refused(start, &["robot.toml, line", "qd_deg_s", "one of pole, got `pol`", "robot.urdf"]);
    Folder::of(system)
        .edit(
            "manoeuvres.toml",
            "    { joint = \"cart\", value_m = 0 },\n",
            "    { joint = \"car\", value_m = 0 },\n",
        )
        .refused(start, &["manoeuvres.toml, line", "expected one of cart, pole, got `car`"]);
    Folder::of(system)
        .edit("manoeuvres.toml", "reverses = \"swing-up\"", "reverses = \"swingup\"")
        .refused(start, &["manoeuvres.toml, line", "swing-up, move, carry, got `swingup`"]);
    let output = upswing(&["demo", "--system", "cartpole"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("cart-pole") && stderr.contains("`cartpole`"), "{stderr}");
}

#[test]
fn a_database_of_another_system() {
    let (system, start) = CART_POLE;
    let (folder, other) = (Folder::of(system), Folder::of("iiwa-pendulum"));
    copy(&other.path().join("swing-up.bin"), &folder.path().join("swing-up.bin"));
    folder.refused(
        start,
        &["swing-up.bin", "made for another robot", "joint_1", "cart, pole", "upswing db build"],
    );
}

fn copy(from: &Path, to: &Path) {
    std::fs::copy(from, to).expect("copied");
}
