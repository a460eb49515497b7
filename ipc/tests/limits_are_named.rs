//! A limit of the operating system that is too low is named before an operation fails because of it.

use std::process::Command;
use upswing_ipc::{IpcError, TempDomain};

const CHILD: &str = "UPSWING_TEST_LIMIT";

/// Runs this test again under `ulimit OPTION VALUE`; its standard output.
fn under(option: &str, value: &str) -> String {
    let output = Command::new("sh")
        .args(["-c", &format!("ulimit {option} {value} && exec \"$0\" \"$@\"")])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", "too_low_limits_are_refused_with_their_names", "--nocapture"])
        .env(CHILD, value)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{option} {value}: {:?}: {text}", output.status);
    text
}

#[test]
fn too_low_limits_are_refused_with_their_names() {
    if std::env::var_os(CHILD).is_some() {
        let domain = TempDomain::new("limits").unwrap();
        match domain.join("daemon") {
            Ok(_) => println!("joined"),
            Err(e @ IpcError::Limit { .. }) => println!("{e}"),
            Err(e) => panic!("{e}"),
        }
        return assert!(!domain.exists());
    }
    for files in ["64", "40", "20"] {
        let told = under("-n", files);
        assert!(told.contains(&format!("only {files} open files, 256 are needed")), "{told}");
        assert!(told.contains("ulimit -n"), "{told}");
    }
    let told = under("-v", "300000");
    assert!(told.contains("only 307200000 bytes of address space") && told.contains("ulimit -v"), "{told}");
    // What the process may raise itself is no trouble.
    assert!(under("-S -n", "64").contains("joined"));
}
