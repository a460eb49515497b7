//! A robot whose reflected rotor inertias are in `robot.toml` swings up a plant that has them, from a database made for it;
//! a database made without them is refused.

mod common;

use common::{success, upswing};

#[test]
fn from_a_database_made_for_them() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = |name: &str| dir.path().join(name).to_str().expect("a plain path").to_owned();
    let config = dir.path().join("config");
    upswing_planner::export(
        &upswing_config::Config::embedded().expect("embedded settings"),
        &config,
        Default::default(),
    )
    .expect("settings are exported");
    let of = |file: &str| std::fs::read_to_string(config.join(file)).expect("a file of the set");
    let line = |text: &str| text.lines().find(|l| l.starts_with("rotor_inertia_kg_m2")).map(str::to_owned);
    let rotors = line(&of("scenarios/rotor-inertia.toml")).expect("the rotors of the scenario");
    let unknown = line(&of("robot.toml")).expect("the rotors of the settings");
    std::fs::write(config.join("robot.toml"), of("robot.toml").replace(&unknown, &rotors)).expect("written");
    let settings = path("config");

    let start = "0,-15,0,-95,0,10,0";
    let refused = upswing(&["plan", "--system", &settings, "--start", start]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");

    // One pose, which is the start.
    let (grid, database) = (path("grid.toml"), path("database.bin"));
    let axis = |(joint, deg)| format!("{{ joint = \"{joint}\", value_deg = {deg} }}");
    let joints = [("joint_2", -15), ("joint_4", -95), ("joint_6", 10)].map(axis).join(", ");
    let text = format!("grid = [{joints}]\nmax_rest_angle_deg = 45\n");
    std::fs::write(&grid, text).expect("written");
    let built = upswing(&["db", "build", "--system", &settings, "--grid", &grid, "--output", &database]);
    assert!(built.status.success(), "{built:?}");
    std::fs::copy(&database, config.join("swing-up.bin")).expect("copied");
    // Those of the other manoeuvres were made for the unknown rotors.
    for other in ["move.bin", "carry.bin"] {
        std::fs::remove_file(config.join(other)).expect("removed");
    }

    let picture = path("demo.svg");
    let demo = ["demo", "--clock", "lockstep", "--seconds", "3", "--scenario", "rotor-inertia"];
    let place = ["--system", &settings, "--domain", "rotor-test", "--picture", &picture, "--start", start];
    let answer = success(&[&demo[..], &place[..]].concat());
    assert_eq!(answer["success"], true, "{answer}");
}
