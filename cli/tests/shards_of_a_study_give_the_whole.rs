//! The shards of a study, merged, print and draw what one run does, whatever was interrupted; files of another study, of other settings, a
//! missing shard and one that is there twice are refused.

mod common;

use common::{forget_times, json, upswing};
use serde_json::Value;
use std::path::Path;

const SHARDS: usize = 3;

/// The document of a study, which is about success, without its times.
fn document(args: &[&str]) -> Value {
    let (code, mut answer) = json(args);
    assert_eq!(code == Some(0), answer["success"] == true, "{args:?}: {answer}");
    forget_times(&mut answer);
    answer
}

/// Paths of the shards in a folder.
fn files(dir: &Path) -> Vec<String> {
    let name = |i| dir.join(format!("shard-{i}.runs")).to_str().expect("a plain path").to_owned();
    (1..=SHARDS).map(name).collect()
}

/// Runs shard number `i` of a study, from 1.
fn run_shard(study: &[&str], i: usize, file: &str) -> (Option<i32>, Value) {
    let shard = format!("{i}/{SHARDS}");
    json(&[study, &["--shard", &shard, "--output", file]].concat())
}

fn merge(study: &[&str], files: &[String]) -> Vec<String> {
    let words = study.iter().copied().chain(["--merge"]).chain(files.iter().map(String::as_str));
    words.map(str::to_owned).collect()
}

fn words(args: &[String]) -> Vec<&str> {
    args.iter().map(String::as_str).collect()
}

/// The last line of the errors of a merge that is refused.
fn refusal(study: &[&str], files: &[String]) -> String {
    let output = upswing(&words(&merge(study, files)));
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned()
}

fn check(study: &[&str], runs: u64) {
    let dir = tempfile::tempdir().expect("a folder");
    let files = files(dir.path());
    let mut done = 0;
    for (i, file) in files.iter().enumerate() {
        let (code, answer) = run_shard(study, i + 1, file);
        assert_eq!((code, &answer["success"], &answer["resumed"]), (Some(0), &true.into(), &0.into()));
        done += answer["runs"].as_u64().expect("a number");
    }
    assert_eq!(done, runs);
    let whole = document(study);
    assert_eq!(document(&words(&merge(study, &files))), whole);
    let backwards: Vec<String> = files.iter().rev().cloned().collect();
    assert_eq!(document(&words(&merge(study, &backwards))).to_string(), whole.to_string());
}

#[test]
fn of_replans() {
    check(&["montecarlo", "replan", "--samples", "7", "--seed", "3"], 7);
}

#[test]
fn of_closed_loops() {
    let study = ["montecarlo", "closed-loop", "--samples", "4", "--condition", "arm-mass,dead-encoder"];
    check(&study, 8);
}

#[test]
fn of_robustness_curves() {
    let over = ["--over", "torque-delay", "--values", "0,63", "--seconds", "2"];
    check(&[&["montecarlo", "robustness", "--samples", "2"], &over[..]].concat(), 4);
}

#[test]
fn a_drawing_is_the_same() {
    let dir = tempfile::tempdir().expect("a folder");
    let files = files(dir.path());
    let study = ["montecarlo", "replan", "--samples", "4"];
    for (i, file) in files.iter().enumerate() {
        run_shard(&study, i + 1, file);
    }
    let pictures =
        ["whole.svg", "merged.svg"].map(|name| dir.path().join(name).to_str().expect("plain").to_owned());
    upswing(&[&study[..], &["--svg", &pictures[0]]].concat());
    let merged = [&study[..], &["--svg", &pictures[1]]].concat();
    upswing(&words(&merge(&merged, &files)));
    let [whole, merged] = pictures.map(|path| std::fs::read(path).expect("a picture"));
    assert!(whole == merged && !whole.is_empty());
}

#[test]
fn a_killed_shard_goes_on() {
    let dir = tempfile::tempdir().expect("a folder");
    let files = files(dir.path());
    let study = ["montecarlo", "replan", "--samples", "6"];
    for (i, file) in files.iter().enumerate() {
        run_shard(&study, i + 1, file);
    }
    let expected = document(&words(&merge(&study, &files)));
    // The second of two runs was being written.
    let whole = std::fs::read(&files[1]).expect("a file");
    std::fs::write(&files[1], &whole[..whole.len() - 40]).expect("written");
    let text = refusal(&study, &files);
    assert!(text.contains("shard 2 of 3 is not finished: run it again"), "{text}");
    let (code, answer) = run_shard(&study, 2, &files[1]);
    assert_eq!((code, &answer["resumed"], &answer["runs"]), (Some(0), &1.into(), &2.into()));
    assert_eq!(document(&words(&merge(&study, &files))), expected);
    // Killed while it began.
    std::fs::write(&files[1], &whole[..30]).expect("written");
    let (code, answer) = run_shard(&study, 2, &files[1]);
    assert_eq!((code, &answer["resumed"]), (Some(0), &0.into()));
    assert_eq!(document(&words(&merge(&study, &files))), expected);
    // Complete: there is nothing to do, and nothing is changed.
    let before = std::fs::read(&files[1]).expect("a file");
    let (code, answer) = run_shard(&study, 2, &files[1]);
    assert_eq!((code, &answer["resumed"]), (Some(0), &2.into()));
    assert_eq!(before, std::fs::read(&files[1]).expect("a file"));
}

#[test]
fn files_that_do_not_belong_together_are_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let files = files(dir.path());
    let study = ["montecarlo", "replan", "--samples", "3"];
    for (i, file) in files.iter().enumerate() {
        run_shard(&study, i + 1, file);
    }
    let text = refusal(&study, &files[1..]);
    assert!(text.contains("shards missing: 1 of 3"), "{text}");
    let twice = [&files[..], &files[..1]].concat();
    let text = refusal(&study, &twice);
    assert!(text.contains("are both shard 1; name each shard once"), "{text}");
    let other = ["montecarlo", "replan", "--samples", "3", "--seed", "1"];
    let text = refusal(&other, &files);
    assert!(text.contains("shard-1.runs: fingerprint of settings and options is "), "{text}");
    let other = ["montecarlo", "closed-loop", "--samples", "3"];
    let text = refusal(&other, &files);
    assert!(text.contains("shard-1.runs: study is replan, expected closed-loop"), "{text}");
    // To another shard nothing is appended.
    let output = upswing(&[&study[..], &["--shard", "2/3", "--output", &files[0]]].concat());
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && text.contains("shard is 1, expected 2"), "{text}");
    // Damage.
    let mut bytes = std::fs::read(&files[0]).expect("a file");
    let at = bytes.len() - 20;
    bytes[at] ^= 1;
    std::fs::write(&files[0], bytes).expect("written");
    let text = refusal(&study, &files);
    assert!(
        text.contains("shard-1.runs, line 2: expected a line of a file of runs with its checksum"),
        "{text}"
    );
    let unrelated = dir.path().join("unrelated").to_str().expect("plain").to_owned();
    std::fs::write(&unrelated, "mine\n").expect("written");
    let output = upswing(&[&study[..], &["--shard", "1/3", "--output", &unrelated]].concat());
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert_eq!(std::fs::read(&unrelated).expect("a file"), b"mine\n");
    let output = upswing(&[&study[..], &["--shard", "1/3", "--output", &unrelated, "--force"]].concat());
    assert!(output.status.success(), "{output:?}");
    document(&words(&merge(&study, &[&[unrelated], &files[1..]].concat())));
}
