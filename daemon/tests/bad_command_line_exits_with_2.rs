//! Exit codes of the process.

use std::process::{Command, Output};

fn daemon(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_upswingd")).args(args).output().unwrap()
}

fn refused(args: &[&str], part: &str) {
    let output = daemon(args);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains(part), "{text}");
}

#[test]
fn unknown_option() {
    refused(&["--nonsense"], "--nonsense");
}

#[test]
fn missing_settings() {
    refused(&["--system", "/nonexistent/settings"], "/nonexistent/settings");
}

#[test]
fn impossible_domain() {
    refused(&["--domain", "No Domain!"], "No Domain!");
}

#[test]
fn help_shows_an_example() {
    let output = daemon(&["--help"]);
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stdout).contains("Example:"));
}
