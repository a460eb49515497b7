//! `upswing plan --reference` adapts the optimal trajectory from the angles given, and `--svg` draws both.

mod common;

use common::success;
use serde_json::Value;
use std::path::Path;

/// The paper's illustrated replan, Fig. 4: a start, and one that is no entry of the database.
const START: &str = "-15,-15,0,-95,0,10,0";
const REFERENCE: &str = "0,0,0,-90,0,0,0";

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[test]
fn the_optimum_from_there_is_adapted() {
    let there = success(&["plan", "--start", REFERENCE, "--reference", REFERENCE]);
    let optimum = success(&["optimize", "--start", REFERENCE, "--best"]);
    assert_eq!(number(&there["distance"]), 0.0);
    // A replan keeps 1 % more distance from the limits.
    let more = number(&there["cost"]) / number(&optimum["cost"]) - 1.0;
    assert!((0.0..0.03).contains(&more), "the plan costs {more} more");

    let plan = success(&["plan", "--start", START, "--reference", REFERENCE]);
    let distance = [15.0_f64, 15.0, 5.0, 10.0].iter().map(|d| d.to_radians().powi(2)).sum::<f64>().sqrt();
    assert!((number(&plan["distance"]) - distance).abs() < 1e-9);
    for (i, angle) in [-15.0_f64, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0].iter().enumerate() {
        assert!((number(&plan["x"][0][i]) - angle.to_radians()).abs() < 1e-9, "joint {}", i + 1);
    }
}

#[test]
fn both_are_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let draw = |name: &str, reference: &str| {
        let path = folder.path().join(name);
        let file = path.to_str().expect("a plain path");
        success(&["plan", "--start", START, "--reference", reference, "--svg", file]);
        curves(&path)
    };
    let (apart, equal) = (draw("apart.svg", REFERENCE), draw("equal.svg", START));
    // 9 positions, 9 velocities, 7 torques: each solid, also in the legend, and, in many short lines, dashed.
    assert_eq!([apart.0, equal.0], [2 * 25; 2]);
    assert!(apart.1 >= 25 * 10 && equal.1 >= 25 * 10, "{} and {} dashes", apart.1, equal.1);
}

#[test]
fn pictures_with_the_same_titles_have_the_same_scale() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a plain path").to_owned();
    let (plan, far, flight) = (path("plan.svg"), path("far.svg"), path("flight.svg"));
    success(&["plan", "--start", START, "--svg", &plan]);
    success(&["plan", "--start", "0,-15,60,-95,60,10,60", "--svg", &far]);
    success(&["demo", "--clock", "lockstep", "--seconds", "2", "--picture", &flight]);
    let limits = |file: &str| {
        let svg = std::fs::read_to_string(file).expect("the picture");
        let lines = svg.split("<polyline").filter(|line| line.contains("opacity=\"0.35\""));
        let heights =
            lines.map(|line| line.split("points=\"").nth(1)?.split([',', ' ']).nth(1)?.parse().ok());
        heights.collect::<Option<Vec<i32>>>().expect("heights")
    };
    let heights = limits(&plan);
    // Two limits in nine panels.
    assert_eq!(heights.len(), 18, "{heights:?}");
    assert_eq!((&limits(&far), &limits(&flight)), (&heights, &heights));
}

/// Numbers of the thick lines and of the thin coloured ones.
fn curves(path: &Path) -> (usize, usize) {
    let svg = std::fs::read_to_string(path).expect("the picture");
    assert!(svg.starts_with("<svg") && svg.contains("pendulum_2"));
    let lines = || svg.split('<').filter(|l| l.starts_with("polyline") && !l.contains("#000000"));
    let of_width = |width: &str| lines().filter(|l| l.contains(width)).count();
    (of_width("stroke-width=\"2\""), of_width("stroke-width=\"1\""))
}
