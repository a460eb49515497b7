//! `upswing record` records every cycle of a running system. If it is killed, the file is readable up to the last quarter
//! of a second, and the control loop is not affected.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use upswing_ipc::Clock;
use upswing_record::{CHUNK, Tally, Window, read};
use upswing_tests::{START, System, programs};

const PATIENCE: Duration = Duration::from_secs(60);

#[test]
fn killed_while_recording() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("run.mcap");
    let mut system = System::start(Clock::Lockstep, START);
    system.session.advance(1).unwrap_or_else(|e| panic!("{e}"));
    let mut recorder = Command::new(programs().join("upswing"))
        .arg("record")
        .arg(&file)
        .args(["--domain", system.session.node().domain().name()])
        .stdout(Stdio::null())
        .spawn()
        .expect("upswing starts");
    let begin = Instant::now();
    // Until several chunks are complete, as another process sees it. The file is made when telemetry has its reader; time goes
    // on as far as that keeps up.
    let mut granted = 0;
    let cycles = loop {
        assert!(begin.elapsed() < PATIENCE, "no recording after {PATIENCE:?}");
        let cycles = read(&file, Window::ALL).map_or(0, |(cycles, _)| cycles.len());
        if cycles >= 4 * CHUNK {
            break cycles;
        }
        if file.exists() && granted < cycles + 2 * CHUNK {
            system.session.advance(800).unwrap_or_else(|e| panic!("{e}"));
            granted += 800;
        } else {
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    recorder.kill().expect("killed");
    recorder.wait().expect("reaped");
    let (read_back, recording) = read(&file, Window::ALL).unwrap_or_else(|e| panic!("{e}"));
    assert!(recording.cut.is_some(), "a killed recording has no end");
    assert!(read_back.len() >= cycles);
    assert_eq!(Tally::of(&read_back).lost, 0);
    // The same cycles as the session saw.
    let first = read_back[0].seq;
    system.session.advance(800).unwrap_or_else(|e| panic!("{e}"));
    let records = &system.session.records;
    let offset = records.iter().position(|r| r.seq == first).expect("recorded here, too");
    assert_eq!(read_back, records[offset..offset + read_back.len()]);
    assert_eq!(system.session.dropped(), 0);
}
