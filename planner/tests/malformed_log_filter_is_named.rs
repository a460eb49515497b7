//! Invalid parts of RUST_LOG are named on stderr, and the other parts apply.

use std::process::Command;

#[test]
fn beside_a_good_one() {
    let output = Command::new(env!("CARGO_BIN_EXE_upswing-planner"))
        .args(["--system", "/nonexistent"])
        .env("RUST_LOG", "warn,upswing=loud")
        .output()
        .expect("it runs");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("ignoring `upswing=loud`"), "{message}");
    assert!(!message.contains("ignoring `warn`"), "{message}");
}
