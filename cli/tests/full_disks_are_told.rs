//! A picture that does not fit on its disk is an error, and costs nothing but the picture.

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
fn of_a_demo_whose_report_is_printed() {
    let demo = ["demo", "--clock", "lockstep", "--seconds", "2", "--domain", "full-test", "--picture", FULL];
    let (code, report) = json(&demo);
    assert_eq!((code, &report["success"]), (Some(1), &true.into()), "{report}");
}
