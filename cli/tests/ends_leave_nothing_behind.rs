//! A client creates no files in a domain without processes; an interrupt of the whole process group ends a demo as
//! interrupted; an unwritable stderr causes no panic. None of them leaves a file.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A name that no other process uses.
fn domain(what: &str) -> String {
    format!("{what}-{}", std::process::id())
}

fn upswing(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_upswing"));
    command.args(arguments).stdin(Stdio::null());
    command
}

/// Files of a domain, and folders with logs of it.
fn traces(domain: &str) -> Vec<PathBuf> {
    let entries = |folder: PathBuf| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let all = entries("/dev/shm".into()).chain(entries(std::env::temp_dir()));
    all.filter(|path| path.file_name().unwrap().to_string_lossy().contains(domain)).collect()
}

#[test]
fn clients_of_a_domain_that_does_not_exist_create_nothing() {
    let domain = domain("nobody");
    let file = std::env::temp_dir().join(format!("record-{}.mcap", std::process::id()));
    for arguments in [
        &["status"][..],
        &["request", "stop"],
        &["disturb", "clear"],
        &["record", file.to_str().unwrap(), "--seconds", "1"],
    ] {
        let (command, rest) = arguments.split_at(1);
        let output = upswing(&[command, &["--domain", &domain], rest].concat()).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(text.contains(&domain), "{arguments:?}: {text}");
        assert_eq!(traces(&domain), [""; 0].map(PathBuf::from), "{arguments:?}");
    }
    assert!(!file.exists());
}

#[test]
fn an_interrupted_process_group_ends_a_demo_as_interrupted() {
    for clock in ["lockstep", "paced"] {
        let domain = domain(clock);
        let demo =
            ["demo", "--domain", &domain, "--clock", clock, "--seconds", "600", "--picture", "/dev/null"];
        let mut demo = upswing(&demo).process_group(0).stderr(Stdio::piped()).spawn().unwrap();
        let mut told = BufReader::new(demo.stderr.take().unwrap()).lines();
        let first = told.next().unwrap().unwrap();
        assert!(first.contains("starting daemon"), "{first}");
        let folder = std::env::temp_dir().join(format!("{domain}-demo-{}", demo.id()));
        // From here on children run.
        while !folder.join("plant.log").exists() {
            assert!(demo.try_wait().unwrap().is_none(), "{:?}", told.next());
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let group = -libc::pid_t::try_from(demo.id()).unwrap();
        // SAFETY: plain system call; the group's leader has not been waited for, so that the id is still its own.
        assert_eq!(unsafe { libc::kill(group, libc::SIGINT) }, 0);
        let rest: Vec<_> = told.map(Result::unwrap).collect();
        assert_eq!(demo.wait().unwrap().code(), Some(1), "{rest:?}");
        assert!(rest.iter().any(|line| line.contains("interrupted")), "{rest:?}");
        assert_eq!(traces(&domain), [""; 0].map(PathBuf::from));
    }
}

#[test]
fn a_full_or_closed_stderr_is_no_panic() {
    let full = || File::options().write(true).open("/dev/full").unwrap();
    let closed = || {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        writer
    };
    let refused = ["plan", "--start", "0"];
    assert_eq!(upswing(&refused).stderr(full()).status().unwrap().code(), Some(2));
    assert_eq!(upswing(&refused).stderr(closed()).status().unwrap().code(), Some(2));
    let domain = domain("stderr");
    let demo =
        ["demo", "--domain", &domain, "--clock", "lockstep", "--seconds", "2", "--picture", "/dev/null"];
    let status = upswing(&demo).stdout(Stdio::null()).stderr(closed()).status().unwrap();
    assert_eq!(status.code(), Some(0));
    assert_eq!(traces(&domain), [""; 0].map(PathBuf::from));
    // A log that cannot be written: the daemon warns before it ends.
    let daemon = ["daemon", "--domain", &domain, "--system", "/nowhere"];
    assert_eq!(upswing(&daemon).stderr(full()).status().unwrap().code(), Some(2));
}
