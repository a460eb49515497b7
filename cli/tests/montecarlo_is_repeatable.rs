//! Equal settings, seeds and conditions give equal results: on one thread and on two, and when a single start is
//! repeated, and on CPUs with and without FMA. Only times differ.

mod common;

use common::{forget_times, json};
use serde_json::Value;
use std::process::Command;

/// The document of `upswing montecarlo ARGS --json`, without its times.
fn montecarlo(args: &[&str]) -> Value {
    let (code, mut answer) = json(&[&["montecarlo"], args].concat());
    assert_eq!(code == Some(0), answer["success"] == true, "{args:?}");
    forget_times(&mut answer);
    answer
}

#[test]
fn replans() {
    let run = ["replan", "--samples", "5", "--seed", "3"];
    let one = montecarlo(&[&run[..], &["--threads", "1"]].concat());
    let two = montecarlo(&[&run[..], &["--threads", "2"]].concat());
    assert_eq!(one, two);
    assert_eq!((&one["success"], &one["samples"]), (&true.into(), &5.into()), "{one}");
    let again = montecarlo(&["replan", "--seed", "3", "--only", "4"]);
    assert_eq!(again["samples"], 1);
    assert_eq!(again["results"][0], one["results"][4]);
    let other = montecarlo(&["replan", "--seed", "4", "--only", "4"]);
    assert_ne!(other["results"][0]["start"], one["results"][4]["start"]);
}

#[test]
fn closed_loops() {
    // With masses that are drawn, and encoders whose noise is.
    let run = ["closed-loop", "--samples", "3", "--seed", "3", "--condition", "arm-mass,coarse-encoders"];
    let one = montecarlo(&[&run[..], &["--threads", "1"]].concat());
    let two = montecarlo(&[&run[..], &["--threads", "2"]].concat());
    assert_eq!(one, two);
    for (i, condition) in ["arm-mass", "coarse-encoders"].iter().enumerate() {
        let results = &one["conditions"][i]["results"];
        assert_eq!(results.as_array().map(Vec::len), Some(3));
        let again = montecarlo(&["closed-loop", "--seed", "3", "--condition", condition, "--only", "2"]);
        assert_eq!(again["conditions"][0]["results"][0], results[2], "{condition}");
    }
}

#[test]
fn runs_on_cpus_with_and_without_fma() {
    // Optimisation, gains, the control law and the noise of encoders. The C library chooses its functions by these tunables.
    const RUN: [&str; 7] =
        ["montecarlo", "closed-loop", "--samples", "2", "--condition", "coarse-encoders", "--json"];
    let results = |tunables: &str| {
        let mut run = Command::new(env!("CARGO_BIN_EXE_upswing"));
        let output = run.args(RUN).env("GLIBC_TUNABLES", tunables).output().expect("upswing runs");
        let mut answer = serde_json::from_slice(&output.stdout).expect("JSON");
        forget_times(&mut answer);
        answer
    };
    let with_fma = results("");
    assert_eq!(with_fma, results("glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"));
    assert_eq!(with_fma["conditions"][0]["results"].as_array().map(Vec::len), Some(2), "{with_fma}");
}
