//! Every command that answers without a running system prints one JSON document on stdout with `--json`, in the
//! shapes that others rely on.

use serde_json::Value;
use std::io::Write;
use std::process::{Command, Stdio};

fn json(args: &[&str], stdin: &str) -> Value {
    let mut child = Command::new(env!("CARGO_BIN_EXE_upswing"))
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("upswing runs");
    child.stdin.take().expect("a pipe").write_all(stdin.as_bytes()).expect("written");
    let output = child.wait_with_output().expect("upswing ends");
    assert!(output.status.success(), "{args:?}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{args:?}: {e}"))
}

/// Rows and columns of a matrix.
fn shape(value: &Value) -> (usize, usize) {
    let rows = value.as_array().expect("an array");
    let columns: Vec<_> = rows.iter().map(|r| r.as_array().expect("rows").len()).collect();
    assert!(columns.iter().all(|c| *c == columns[0]), "ragged matrix");
    (rows.len(), columns[0])
}

fn length(value: &Value) -> usize {
    value.as_array().expect("an array").len()
}

#[test]
fn trajectories() {
    for command in ["optimize", "plan"] {
        let t = json(&[command, "--start", "0,-15,0,-95,0,10,0", "--json"], "");
        assert_eq!((shape(&t["x"]), shape(&t["u"])), ((101, 18), (101, 7)), "{command}");
        assert_eq!(t["status"], "solved", "{command}");
        assert!(t["t_f"].as_f64().is_some_and(|v| v > 1.0 && v < 4.0), "{command}");
        assert!(t["cost"].is_f64() && t["time_s"].is_f64(), "{command}");
    }
    let entry = json(&["db", "export", "--entry", "0", "--json"], "");
    assert_eq!((shape(&entry["x"]), shape(&entry["u"])), ((101, 18), (101, 7)));
}

#[test]
fn the_model() {
    let zeros = |n| vec!["0.1"; n].join(",");
    let line = format!("{{\"q\":[{}],\"qd\":[{}],\"u\":[{}]}}\n", zeros(9), zeros(9), zeros(7));
    let m = json(&["model", "eval", "--json"], &line);
    let shapes = [shape(&m["M"]), shape(&m["A"]), shape(&m["B"])];
    assert_eq!(shapes, [(9, 9), (18, 18), (18, 7)]);
    assert_eq!([&m["nle"], &m["g"], &m["f"], &m["tau"]].map(length), [9, 9, 18, 7]);
    assert!(json(&["model", "urdf", "--json"], "")["urdf"].as_str().is_some_and(|t| t.contains("<robot")));
}

#[test]
fn settings_and_database() {
    assert_eq!(json(&["config", "check", "--json"], "")["success"], true);
    let info = json(&["db", "info", "--json"], "");
    assert_eq!((&info["entries"], &info["fits_settings"]), (&428.into(), &true.into()));
}

#[test]
fn the_shipped_systems() {
    let list = json(&["demo", "--list", "--json"], "");
    let systems = list["systems"].as_array().expect("systems");
    assert_eq!(systems[0]["name"], "iiwa-pendulum");
    let crane = systems.iter().find(|system| system["name"] == "gantry-crane").expect("the crane");
    assert_eq!(crane["actuated"], serde_json::json!(["bridge", "trolley", "hoist"]));
    assert_eq!(crane["unactuated"], serde_json::json!(["sway_x", "sway_y"]));
    assert_eq!(crane["manoeuvres"], serde_json::json!(["move"]));
    assert!(systems.iter().all(|system| system["description"].as_str().is_some_and(|d| !d.is_empty())));
}

#[test]
fn a_demo() {
    let dir = tempfile::tempdir().expect("a folder");
    let picture = dir.path().join("demo.svg");
    let picture = picture.to_str().expect("a plain path");
    let d = json(&["demo", "--clock", "lockstep", "--seconds", "2", "--picture", picture, "--json"], "");
    assert_eq!(d["success"], true, "{d}");
    assert!(d["final_error_deg"].as_f64().is_some_and(|t| t < 2.0));
    let svg = std::fs::read_to_string(picture).expect("the picture");
    assert!(svg.starts_with("<svg") && svg.contains("pendulum_2"));
}
