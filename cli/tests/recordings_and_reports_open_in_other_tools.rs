//! The official Python reader reads recordings, also one that was cut off, what the official writer has written is read, and
//! Chromium shows the report.
//!
//! Needs Python 3.10 or newer and the package index for the first, Chromium, too, for the second; a test whose tools are
//! not there says so and does nothing.

mod common;

use common::{chromium, python, run, script, success};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use upswing_config::Config;
use upswing_ipc::Telemetry;
use upswing_record::Recorder;

/// A demo with its recording in `dir`; cycles in it by our own count.
fn demo(dir: &Path) -> (String, usize) {
    let path = |name: &str| dir.join(name).to_str().expect("a plain path").to_owned();
    let (file, picture, table) = (path("run.mcap"), path("demo.svg"), path("run.csv"));
    let lockstep = ["demo", "--clock", "lockstep", "--seconds", "2", "--picture", &picture];
    let answer = success(&[&lockstep[..], &["--record", &file]].concat());
    let cycles = success(&["export", &file, "--csv", &table])["lines"].as_u64().expect("a number");
    assert!(cycles >= answer["cycles"].as_u64().expect("a number"), "the end of the run is in the file, too");
    let csv = std::fs::read_to_string(table).expect("the table");
    let columns: Vec<usize> = csv.lines().map(|line| line.split(',').count()).collect();
    assert_eq!(columns, vec![79; cycles as usize + 1]);
    assert!(
        csv.starts_with("seq,t_ns,") && csv.contains("q_pendulum_2_rad") && csv.contains("tau_joint_7_Nm")
    );
    (file, cycles as usize)
}

/// The report of a system that loses sight of joint 9.
fn blind(dir: &Path) -> String {
    let path = |name: &str| dir.join(name).to_str().expect("a plain path").to_owned();
    let file = path("blind.mcap");
    let config = Config::embedded().expect("the settings load");
    let mut recorder = Recorder::create(file.as_ref(), &config, []).expect("the file is made");
    let cycle = |seq: u64| {
        let mut t = Telemetry { seq, t_ns: seq * 10_000_000, joints: 9, actuated: 7, ..Telemetry::default() };
        t.q[8] = if seq < 50 { 0.1 } else { f64::NAN };
        t
    };
    recorder.write(&(0..100).map(cycle).collect::<Vec<_>>()).expect("written");
    recorder.finish().expect("finished");
    success(&["report", &file])["page"].as_str().expect("a path").to_owned()
}

#[test]
fn the_official_python_reader() {
    let dir = tempfile::tempdir().expect("a folder");
    let (file, cycles) = demo(dir.path());
    let python = match python() {
        Ok(python) => python,
        Err(why) => return eprintln!("skipped: no Python with the packages needed: {why}"),
    };
    let read = |cycles: usize, options: &[&str]| {
        let mut command = Command::new(python);
        command.arg(script("read_recording.py")).args([&file, &cycles.to_string()]).args(options);
        run(&mut command).unwrap_or_else(|e| panic!("{e}"))
    };
    read(cycles, &[]);
    // And back: what another tool has written.
    let path = |name: &str| dir.path().join(name).to_str().expect("a plain path").to_owned();
    let table = |file: &str| {
        let answer = success(&["export", file, "--csv", &path("table.csv"), "--force"]);
        assert!(answer["cut"].is_null() && answer["damage"].is_null(), "{answer}");
        std::fs::read(path("table.csv")).expect("the table")
    };
    let own = table(&file);
    for compression in ["lz4", "zstd", "none"] {
        let mut command = Command::new(python);
        command.arg(script("rewrite_recording.py")).args([&file, &path("other.mcap"), compression]);
        run(&mut command).unwrap_or_else(|e| panic!("{e}"));
        assert!(table(&path("other.mcap")) == own, "{compression}");
    }
    let bytes = std::fs::read(&file).expect("read");
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).expect("written");
    // Bytes per cycle differ: a rod at rest compresses better than one that moves.
    read(cycles / 3, &["--cut"]);
}

#[test]
fn chromium_plays_the_report() {
    let dir = tempfile::tempdir().expect("a folder");
    let (file, _) = demo(dir.path());
    let answer = success(&["report", &file, "--svg", "--png"]);
    let page = answer["page"].as_str().expect("a path");
    let html = std::fs::read_to_string(page).expect("the page");
    // One file: nothing is fetched.
    assert!(!html.contains("src=") && !html.contains("<link"), "the page refers to other files");
    let figures = answer["figures"].as_array().expect("figures");
    // Lockstep has no cycle times.
    assert_eq!(figures.len(), 4, "{figures:?}");
    for figure in figures.iter().filter_map(Value::as_str) {
        let bytes = std::fs::read(figure).expect("the figure");
        assert!(bytes.starts_with(b"<svg") || bytes.starts_with(b"\x89PNG"), "{figure}");
    }
    let (python, chromium) = match (python(), chromium()) {
        (Ok(python), Some(chromium)) => (python, chromium),
        (Err(why), _) => return eprintln!("skipped: no Python with the packages needed: {why}"),
        (_, None) => return eprintln!("skipped: no Chromium (on Debian: apt install chromium)"),
    };
    let mut look = Command::new(python);
    let blind = blind(dir.path());
    look.arg(script("look_at_page.py")).args([&chromium, page, &blind]).arg(dir.path().join("screenshots"));
    run(&mut look).unwrap_or_else(|e| panic!("{e}"));
}
