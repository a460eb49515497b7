//! A picture that does not fit on its disk is an error, but only the picture is lost; one that cannot be written at all is
//! refused before the work.

mod common;

use common::{json, upswing};

/// A disk that is always full.
const FULL: &str = "/dev/full";

#[test]
fn of_a_plan() {
    let output = upswing(&["plan", "--start", "0,-15,0,-95,0,10,0", "--svg", FULL]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("cannot write /dev/full"), "{text}");
}

#[test]
fn that_there_is_no_such_folder_is_told_before_the_work() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = |name: &str| dir.path().join(name).to_str().expect("a plain path").to_owned();
    let (missing, record) = (path("missing/a.svg"), path("run.mcap"));
    for args in [
        &["demo", "--clock", "lockstep", "--seconds", "2", "--record", &record, "--picture", &missing][..],
        &[
            "demo",
            "--clock",
            "lockstep",
            "--seconds",
            "2",
            "--picture",
            dir.path().to_str().expect("a plain path"),
        ],
        &["montecarlo", "replan", "--samples", "1", "--svg", &missing],
        &["montecarlo", "robustness", "--over", "friction", "--samples", "1", "--svg", &missing],
    ] {
        let output = upswing(args);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(text.contains("cannot write") && output.stdout.is_empty(), "{args:?}: {text}");
    }
    assert_eq!(std::fs::read_dir(dir.path()).expect("the folder").count(), 0, "something was left behind");
}

#[test]
fn of_a_demo_whose_report_is_printed() {
    let demo = ["demo", "--clock", "lockstep", "--seconds", "2", "--domain", "full-test", "--picture", FULL];
    let (code, report) = json(&demo);
    assert_eq!((code, &report["success"]), (Some(1), &true.into()), "{report}");
}
