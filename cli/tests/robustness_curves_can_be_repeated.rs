//! A robustness curve is the same on any number of threads; each failed start is listed, and repeated with its value it
//! fails again for the same reason. Missed cycles beyond the daemon's limits make it trip.

mod common;

use common::{json, upswing};
use serde_json::Value;

const COMMAND: [&str; 2] = ["montecarlo", "robustness"];

/// The curves, without times.
fn curves(args: &[&str]) -> (Option<i32>, Value) {
    let (code, mut answer) = json(&[&COMMAND, args].concat());
    (code, answer["curves"].take())
}

#[test]
fn missed_cycles() {
    let dir = tempfile::tempdir().expect("a folder");
    let svg = dir.path().join("curve.svg");
    let file = svg.to_str().expect("a plain path");
    let run = ["--over", "missed-balance", "--values", "5,30", "--samples", "2", "--seed", "3"];
    let (code, one) = curves(&[&run[..], &["--threads", "1", "--svg", file]].concat());
    let (_, two) = curves(&[&run[..], &["--threads", "2"]].concat());
    assert_eq!((code, &one), (Some(0), &two), "a curve that falls is a result, no failure");
    let points = one[0]["points"].as_array().expect("points");
    let counts: Vec<_> = points.iter().map(|p| (p["value"].as_f64(), p["succeeded"].as_u64())).collect();
    assert_eq!(counts, [(Some(5.0), Some(2)), (Some(30.0), Some(0))], "{one}");
    let failed = &points[1]["failed"][1];
    assert!(
        failed["kind"].as_str().is_some_and(|kind| kind.contains("measurements were missed")),
        "{failed}"
    );
    let svg = std::fs::read_to_string(svg).expect("the picture");
    assert!(svg.starts_with("<svg") && svg.contains("cycles missed in Balance"));

    let again = ["--over", "missed-balance", "--values", "30", "--seed", "3", "--only", "1"];
    let (code, again) = curves(&again);
    assert_eq!((code, &again[0]["points"][0]["failed"][0]), (Some(1), failed));
}

#[test]
fn misses_as_recorded() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("missed.json");
    let file = path.to_str().expect("a plain path");
    std::fs::write(&path, r#"{"cycles": 1000, "missed": {"2": 9, "30": 1}, "more": true}"#).expect("written");
    let run = ["--over", "jitter", "--values", "0,1", "--samples", "2", "--missed", file];
    let (_, one) = curves(&run);
    let succeeded: Vec<_> = (0..2).map(|i| one[0]["points"][i]["succeeded"].as_u64()).collect();
    // Thirty in a row, which the daemon does not bear, come every 10^4 cycles.
    assert_eq!(succeeded, [Some(2), Some(0)], "{one}");
    assert_eq!(one, curves(&run).1);
}

#[test]
fn each_way_to_estimate_velocities_has_its_curve() {
    let run = ["--over", "encoder-bits", "--values", "17", "--samples", "1", "--velocity", "filter,model"];
    let (_, both) = curves(&run);
    let names: Vec<_> = (0..2).map(|i| both[i]["velocity"].as_str()).collect();
    assert_eq!(names, [Some("filter"), Some("model")]);
    assert!((0..2).all(|i| both[i]["points"][0]["succeeded"] == 1), "{both}");
}

#[test]
fn what_cannot_be_is_refused() {
    for (args, part) in [
        (&["--over", "torque-delay", "--values", "2.5"][..], "a whole number from 0 to 63, got 2.5"),
        (&["--over", "friction", "--values", "nan"], "from 0 to 100, got NaN"),
        (&["--over", "jitter"], "expected a file by --missed"),
        (&["--over", "jitter", "--missed", "/nowhere.json"], "/nowhere.json"),
        (&["--over", "push", "--only", "1", "--picture", "x.svg"], "expected one --over, --values"),
    ] {
        let output = upswing(&[&COMMAND, args].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(text.contains(part), "{args:?}: expected `{part}` in: {text}");
    }
}
