//! `upswing soak` kills processes and shows that the system recovers: only killed rounds fail, and the next round begins
//! with all three processes.

mod common;

use common::json;

/// One round, in which `role` is killed.
fn killed(role: &str, seed: &str) {
    let (code, answer) =
        json(&["soak", "--domain", "soak-test", "--seconds", "1", "--kills", "1", "--seed", seed]);
    let count = |key: &str| answer[key].as_array().map_or(0, Vec::len) as u64;
    assert_eq!(count("losses"), 0, "{}", answer["losses"]);
    assert_eq!((count("kills"), answer["rounds"].as_u64()), (1, Some(1)), "{answer}");
    let kill = &answer["kills"][0];
    assert_eq!(kill["role"], role, "{kill}");
    assert!(kill["recovered_s"].as_f64().is_some_and(|s| s > 0.0), "{kill}");
    // The daemon goes on without its planner, and the next plan comes from the new one.
    let completed = role == "planner";
    assert_eq!(answer["completed"].as_u64(), Some(completed.into()), "{answer}");
    assert_eq!((&answer["success"], code), (&completed.into(), Some(if completed { 0 } else { 1 })));
    let sample = &answer["samples"][0];
    for role in ["daemon", "planner", "plant", "operator"] {
        assert!(sample[role]["resident_kib"].as_u64().is_some_and(|kib| kib > 1000), "{role}: {sample}");
        assert!(sample[role]["handles"].as_u64().is_some_and(|n| n > 3), "{role}: {sample}");
    }
    assert!(answer["cycles"].as_u64().is_some_and(|n| n > 8000), "{}", answer["cycles"]);
}

// The random numbers of a seed decide who is killed.

#[test]
fn of_the_daemon() {
    killed("daemon", "2");
}

#[test]
fn of_the_planner() {
    killed("planner", "4");
}

#[test]
fn of_the_plant() {
    killed("plant", "3");
}
