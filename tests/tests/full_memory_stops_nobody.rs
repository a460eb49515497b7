//! A system needs at most 128 MiB of /dev/shm, as docs/daemon.md states. A full /dev/shm does not affect a running system,
//! and new processes are refused with an error.
//!
//! The test runs itself with a /dev/shm of its own. Where the system does not allow that, it says so.

use std::process::Command;
use upswing_ipc::{Clock, Domain, Mode};
use upswing_tests::{START, System, programs};

const CHILD: &str = "UPSWING_TEST_FULL_MEMORY";
const NAME: &str = "a_swing_up_in_full_memory";

#[test]
fn a_swing_up_in_full_memory() {
    if std::env::var_os(CHILD).is_some() {
        return swing_up();
    }
    let script = "mount -t tmpfs -o size=128m tmpfs /dev/shm || exit 77; exec \"$0\" \"$@\"";
    let output = Command::new("unshare")
        .args(["--mount", "--map-root-user", "--", "sh", "-c", script])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", NAME, "--nocapture"])
        .env(CHILD, "1")
        .output();
    let output = match output {
        Ok(output) if output.status.code() != Some(77) && !output.stderr.starts_with(b"unshare:") => output,
        refused => return println!("skipped: no memory of its own: {refused:?}"),
    };
    let text = String::from_utf8_lossy(&output.stdout);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("1 passed"), "{:?}: {text}{said}", output.status);
}

fn swing_up() {
    let mut system = System::start(Clock::Lockstep, START);
    system.bring_to(Mode::Hold);
    let free = Domain::free_memory().expect("its size");
    let _ = std::fs::write("/dev/shm/filler", vec![1; usize::try_from(free).expect("a size")]);
    assert!(Domain::free_memory().expect("its size") < 4096);

    let status = Command::new(programs().join("upswing"))
        .args(["status", "--domain", system.session.node().domain().name()])
        .output()
        .expect("upswing runs");
    let said = String::from_utf8_lossy(&status.stderr);
    assert!(status.status.code() == Some(1) && said.contains("/dev/shm is too full"), "{said}");

    system.bring_to(Mode::Balance);
    system.advance(8_000);
    let last = system.session.records.last().expect("cycles");
    assert_eq!((last.mode(), system.session.dropped()), (Ok(Mode::Balance), 0));
    system.end();
    std::fs::remove_file("/dev/shm/filler").expect("it was there");
}
