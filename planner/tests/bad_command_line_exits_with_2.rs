//! Invalid options of the planner process are refused with one line and exit code 2.

use std::process::Command;

#[test]
fn settings_and_options() {
    for (options, part) in [
        (&["--system", "/nonexistent"][..], "/nonexistent"),
        (&["--domain", "no spaces"], "domain"),
        (&["--warp"], "--warp"),
    ] {
        let output =
            Command::new(env!("CARGO_BIN_EXE_upswing-planner")).args(options).output().expect("it runs");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{options:?}: {message}");
        assert!(message.contains(part), "{options:?}: {message}");
    }
}
