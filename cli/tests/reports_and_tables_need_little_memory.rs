//! A report and a table of a recording need no memory for its cycles: those of this file would fill 125 MB.

use std::process::{Command, Stdio};
use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};
use upswing_record::Recorder;

const CYCLES: u64 = 200_000;
/// The cycles alone would need twice as much.
const MOST_KB: i64 = 64_000;

fn record(seq: u64) -> Telemetry {
    let mut t = Telemetry { seq, t_ns: seq * 125_000, compute_ns: seq % 5000, ..Telemetry::default() };
    t.mode = if seq % 20_000 < 10_000 { Mode::Track.code() } else { Mode::Balance.code() };
    (t.joints, t.actuated) = (9, 7);
    for (i, q) in t.q.iter_mut().enumerate().take(9) {
        *q = 0.2 * (seq as f64 * 1e-4 + i as f64).sin();
    }
    t
}

/// Most memory that `upswing` has had in RAM, KB.
fn peak(args: &[&str]) -> i64 {
    let child = Command::new(env!("CARGO_BIN_EXE_upswing")).args(args).stdout(Stdio::null()).spawn();
    let pid = libc::pid_t::try_from(child.expect("it starts").id()).expect("an id");
    let mut status = 0;
    // SAFETY: all zeros are a valid value, and the call overwrites it.
    let mut used: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: our own child, which nobody else waits for; the pointers are valid for the call.
    assert_eq!(unsafe { libc::wait4(pid, &raw mut status, 0, &raw mut used) }, pid);
    assert_eq!(status, 0, "{args:?}");
    used.ru_maxrss
}

#[test]
fn whatever_its_length() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = |name: &str| dir.path().join(name).to_str().expect("a plain path").to_owned();
    let (file, table) = (path("run.mcap"), path("run.csv"));
    let config = Config::embedded().expect("the settings load");
    let mut recorder = Recorder::create(file.as_ref(), &config, []).expect("the file is made");
    for begin in (1..CYCLES).step_by(1000) {
        let batch: Vec<_> = (begin..begin + 1000).map(record).collect();
        recorder.write(&batch).expect("written");
    }
    assert_eq!(recorder.finish().expect("finished").cycles, CYCLES);
    for args in [vec!["report", &file, "--svg"], vec!["export", &file, "--csv", &table, "--every", "100"]] {
        let peak = peak(&args);
        assert!(peak < MOST_KB, "{args:?} needed {peak} KB");
    }
    let lines = std::fs::read_to_string(table).expect("the table").lines().count();
    assert_eq!(lines as u64, CYCLES / 100 + 1);
}
