//! However the monitor ends, the terminal is as before: no raw mode, no alternate screen, a cursor.

mod common;

use common::{Place, Running};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, FromRawFd};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Both ends of a pseudo terminal of 100 x 30 characters.
fn terminal() -> (File, File) {
    let (mut ours, mut theirs) = (0, 0);
    let size = libc::winsize { ws_row: 30, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
    let no_name = std::ptr::null_mut();
    // SAFETY: the pointers are valid for the call; name and settings may be null.
    let made =
        unsafe { libc::openpty(&raw mut ours, &raw mut theirs, no_name, std::ptr::null(), &raw const size) };
    assert_eq!(made, 0);
    // Our end is ours alone: a child that held it would keep the terminal from going away.
    // SAFETY: plain system call on a descriptor that is open.
    assert_eq!(unsafe { libc::fcntl(ours, libc::F_SETFD, libc::FD_CLOEXEC) }, 0);
    // SAFETY: both are new and belong to nobody else.
    unsafe { (File::from_raw_fd(ours), File::from_raw_fd(theirs)) }
}

/// Local flags of a terminal: echo, whole lines, signals.
fn flags(terminal: &File) -> libc::tcflag_t {
    // SAFETY: all zeros are valid settings, and the call overwrites them.
    let mut settings: libc::termios = unsafe { std::mem::zeroed() };
    // SAFETY: the descriptor is open and the pointer valid for the call.
    assert_eq!(unsafe { libc::tcgetattr(terminal.as_raw_fd(), &raw mut settings) }, 0);
    settings.c_lflag
}

/// Reads what is printed until it holds `mark`.
fn read_until(output: &Receiver<Vec<u8>>, seen: &mut String, mark: &str) {
    while !seen.contains(mark) {
        match output.recv_timeout(Duration::from_secs(60)) {
            Ok(bytes) => seen.push_str(&String::from_utf8_lossy(&bytes)),
            Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) => {
                panic!("no {mark:?} in {seen:?}")
            }
        }
    }
}

fn ends(by: impl FnOnce(&mut File, &Running)) {
    const ENTER: &str = "\x1b[?1049h";
    const LEAVE: &str = "\x1b[?1049l";
    const CURSOR: &str = "\x1b[?25h";
    let place = Place::new();
    let (mut ours, theirs) = terminal();
    let before = flags(&theirs);
    let end = || Stdio::from(theirs.try_clone().expect("a copy"));
    let child = place.command(&["monitor"]).stdin(end()).stdout(end()).stderr(end()).spawn();
    let mut running = Running(child.expect("it starts"));
    let (send, output) = channel();
    let mut reader = ours.try_clone().expect("a copy");
    std::thread::spawn(move || {
        let mut bytes = vec![0; 4096];
        while let Ok(n @ 1..) = reader.read(&mut bytes) {
            let _ = send.send(bytes[..n].to_vec());
        }
    });
    let mut seen = String::new();
    read_until(&output, &mut seen, "quit");
    assert!(seen.contains(ENTER) && flags(&theirs) != before);
    by(&mut ours, &running);
    let status = running.0.wait().expect("it ends");
    assert!(status.success(), "{status}: {seen:?}");
    read_until(&output, &mut seen, LEAVE);
    read_until(&output, &mut seen, CURSOR);
    assert_eq!(flags(&theirs), before);
}

#[test]
fn by_key() {
    ends(|terminal, _| terminal.write_all(b"q").expect("typed"));
}

#[test]
fn by_ctrl_c() {
    ends(|terminal, _| terminal.write_all(b"\x03").expect("typed"));
}

#[test]
fn by_signals() {
    for signal in [libc::SIGTERM, libc::SIGHUP] {
        ends(|_, running| {
            let pid = libc::pid_t::try_from(running.0.id()).expect("an id");
            // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
            assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
        });
    }
}

/// A monitor whose terminal has shown something, and our end of that terminal. It is not the one that controls the process,
/// so that no SIGHUP comes.
fn shown() -> (Place, Running, File) {
    let place = Place::new();
    let (mut ours, theirs) = terminal();
    let end = || Stdio::from(theirs.try_clone().expect("a copy"));
    let child = place.command(&["monitor"]).stdin(end()).stdout(end()).stderr(end()).spawn();
    let running = Running(child.expect("it starts"));
    let (mut seen, mut bytes) = (String::new(), vec![0; 4096]);
    while !seen.contains("quit") {
        let n = ours.read(&mut bytes).expect("it is shown");
        seen.push_str(&String::from_utf8_lossy(&bytes[..n]));
    }
    (place, running, ours)
}

#[test]
fn a_terminal_that_goes_away_ends_it() {
    let (_place, mut running, ours) = shown();
    drop(ours);
    running.0.wait().expect("it ends");
}

#[test]
fn a_terminal_that_nobody_reads_does_not_keep_it_from_ending() {
    let (_place, mut running, _ours) = shown();
    // By then the buffer of the terminal is full and drawing blocks; on a machine too slow for that it ends all the same.
    std::thread::sleep(Duration::from_secs(5));
    let pid = libc::pid_t::try_from(running.0.id()).expect("an id");
    // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
    assert_eq!(unsafe { libc::kill(pid, libc::SIGTERM) }, 0);
    running.0.wait().expect("it ends");
}

#[test]
fn without_one_it_says_so() {
    let place = Place::new();
    let output = place.command(&["monitor"]).stdin(Stdio::null()).output().expect("it runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("expected a terminal") && stderr.contains("--web"), "{stderr}");
}
