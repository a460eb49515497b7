//! A flight record of the daemon becomes a page and a table like any recording; a damaged one is refused.

mod common;

use common::{success, upswing};
use std::path::Path;
use upswing_config::RecorderSettings;
use upswing_ipc::{Mode, Telemetry};
use upswingd::flight::FlightRecorder;

const CYCLES: u64 = 4000;

fn text(path: &Path) -> &str {
    path.to_str().expect("a plain path")
}

#[test]
fn report_and_export() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut recorder = FlightRecorder::new(CYCLES as usize);
    for seq in 1..=CYCLES {
        let mode = if seq < CYCLES { Mode::Hold } else { Mode::Fault };
        let (joints, actuated) = (9, 7);
        let record = Telemetry { seq, t_ns: seq * 125_000, mode: mode.code(), ..Telemetry::default() };
        recorder.push(&Telemetry { joints, actuated, ..record });
    }
    let settings = RecorderSettings { directory: Some(dir.path().to_owned()), keep: 1 };
    let file = recorder.save(&settings).expect("written").expect("a folder is set");

    let table = dir.path().join("run.csv");
    let answer = success(&["export", text(&file), "--csv", text(&table)]);
    assert_eq!(answer["lines"], CYCLES);
    let page = dir.path().join("run.html");
    success(&["report", text(&file), "--output", text(&page)]);
    let html = std::fs::read_to_string(&page).expect("the page");
    assert!(html.contains("flight_record") && html.contains("fault"));

    let mut bytes = std::fs::read(&file).expect("the record");
    bytes[4000] ^= 1;
    std::fs::write(&file, bytes).expect("damaged");
    let output = upswing(&["report", text(&file)]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2));
    assert!(message.contains(text(&file)) && message.contains("checksum"), "{message}");
}
