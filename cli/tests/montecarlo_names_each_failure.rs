//! A run with a failed start has exit code 1 and lists the start with the limit and the state.

mod common;

use common::{json, upswing};
use serde_json::Value;

#[test]
fn a_loop_that_is_given_up() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = dir.path().join("config");
    upswing_planner::export(
        &upswing_config::Config::embedded().expect("embedded settings"),
        &config,
        Default::default(),
    )
    .expect("settings are exported");
    let file = config.join("daemon.toml");
    let (from, to) = (
        "tracking_error_rad = { warn = 0.25, trip = 0.5 }",
        "tracking_error_rad = { warn = 0.0025, trip = 0.005 }",
    );
    let text = std::fs::read_to_string(&file).expect("read");
    assert_eq!(text.matches(from).count(), 1);
    std::fs::write(&file, text.replace(from, to)).expect("written");

    let config = config.to_str().expect("a plain path");
    let run = ["montecarlo", "closed-loop", "--samples", "2", "--seed", "3", "--system", config];
    let (code, answer) = json(&run);
    assert_eq!(code, Some(1));
    let runs = &answer["conditions"][0];
    assert_eq!((&answer["success"], &runs["succeeded"]), (&false.into(), &0.into()));
    for i in 0..2 {
        let failure = runs["results"][i]["reasons"][0].as_str().expect("a reason");
        for part in ["track tripped", "from its reference, limit 0.0050 rad", "q [", "qd ["] {
            assert!(failure.contains(part), "expected `{part}` in: {failure}");
        }
    }
    let kinds = runs["failures"].as_object().expect("kinds of failures");
    assert_eq!(kinds.values().filter_map(Value::as_u64).sum::<u64>(), 2);
    assert!(kinds.keys().all(|kind| kind.contains("too far from the reference, joint ")), "{kinds:?}");
    let text = upswing(&run);
    let text = String::from_utf8_lossy(&text.stdout);
    assert!(text.contains("0 of 2 starts") && text.contains("start 1 at ["), "{text}");
}

#[test]
fn a_failed_run_can_be_drawn() {
    let dir = tempfile::tempdir().expect("a folder");
    let picture = dir.path().join("run.svg");
    let file = picture.to_str().expect("a plain path");
    let condition = ["--condition", "dead-encoder", "--only", "1", "--picture", file];
    let output = upswing(&[&["montecarlo", "closed-loop"], &condition[..]].concat());
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("the position of joint `pendulum_2` is NaN"), "{text}");
    let svg = std::fs::read_to_string(picture).expect("the picture");
    assert!(svg.starts_with("<svg") && svg.contains("pendulum_2"));
}

#[test]
fn a_start_without_a_plan() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = |name: &str| dir.path().join(name).to_str().expect("a plain path").to_owned();
    let (grid, database) = (path("grid.toml"), path("database.bin"));
    // One linearisation of one entry in the middle of the ranges does not serve all of them.
    std::fs::write(&grid, "grid = [{ joint = \"joint_4\", value_deg = -90 }]\nmax_rest_angle_deg = 45\n")
        .expect("written");
    let build = ["db", "build", "--grid", &grid, "--output", &database];
    let built = upswing(&build);
    assert!(built.status.success(), "{built:?}");

    let args = ["montecarlo", "replan", "--samples", "10", "--iterations", "1", "--database", &database];
    let (code, answer) = json(&args);
    assert_eq!(code, Some(1));
    let results = answer["results"].as_array().expect("results");
    let failures: Vec<_> = results.iter().filter_map(|r| r["failure"].as_str()).collect();
    assert!((1..10).contains(&failures.len()), "{failures:?}");
    assert_eq!((&answer["success"], &answer["succeeded"]), (&false.into(), &(10 - failures.len()).into()));
    // What took no time, because it was not done, is no time of QPs and gains.
    for part in ["qp", "lqr"] {
        let least = answer["times"][part]["min"].as_f64().expect("a time");
        assert!(least > 0.0, "{part}: {least} s");
    }
    for failure in failures {
        assert!(failure.contains("entry 0 (") && failure.contains("rad away): "), "{failure}");
    }
}

#[test]
fn plans_of_others_have_the_runs_of_ours() {
    let dir = tempfile::tempdir().expect("a folder");
    let plans = dir.path().join("plans.json");
    let benchmark = dir.path().join("benchmark.json");
    let (plans, benchmark) = (plans.to_str().expect("plain"), benchmark.to_str().expect("plain"));
    let system = ["--system", "cart-pole"];
    let (code, exported) = json(
        &[&["bench", "export", benchmark, "--samples", "2", "--condition", "nominal"], &system[..]].concat(),
    );
    assert_eq!((code, &exported["samples"]), (Some(0), &2.into()));
    let document: Value =
        serde_json::from_str(&std::fs::read_to_string(benchmark).expect("read")).expect("JSON");
    // The starts of the file, of which the second one gets no plan.
    let start = document["starts"][0][0].to_string();
    let output = upswing(&[&["plan", "--start", &start, "--json"], &system[..]].concat());
    std::fs::write(plans, [&output.stdout[..], b"null"].concat()).expect("written");

    let given = ["montecarlo", "closed-loop", "--samples", "2", "--plans", plans];
    let (code, answer) = json(&[&given[..], &system[..]].concat());
    let runs = &answer["conditions"][0];
    assert_eq!((code, &runs["succeeded"], &answer["plans"]), (Some(1), &1.into(), &plans.into()));
    assert_eq!(runs["results"][1]["failure"], "no plan");
    let text = upswing(&[&given[..], &system[..]].concat());
    assert!(String::from_utf8_lossy(&text.stdout).contains("the file has no plan for this start"));
    let ours = json(&[&["montecarlo", "closed-loop", "--samples", "1"], &system[..]].concat()).1;
    let plan: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(runs["results"][0]["end"]["t_f"], plan["t_f"]);
    // The planner plans from the measured start, which the encoders round.
    let t_f = |answer: &Value| answer["conditions"][0]["results"][0]["end"]["t_f"].as_f64();
    let (ours, given) = (t_f(&ours).expect("a run"), t_f(&answer).expect("a run"));
    assert!((ours - given).abs() < 1e-2, "{ours} {given}");

    let (code, score) = json(&["bench", "score", benchmark, "--plans", plans, "--name", "mine"]);
    assert_eq!((code, &score["name"]), (Some(0), &"mine".into()));
    assert_eq!(score["conditions"][0]["results"], runs["results"]);
    let table = upswing(&["bench", "score", benchmark, "--plans", plans, "--name", "mine"]);
    let table = String::from_utf8_lossy(&table.stdout);
    assert!(table.contains("| mine | nominal | 1 of 2 | "), "{table}");
}
