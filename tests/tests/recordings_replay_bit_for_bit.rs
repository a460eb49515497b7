//! Replaying a recording gives the same bits; a changed input is found at its cycle; and each kept recording still gives
//! the modes and faults that were kept with it.

use std::path::{Path, PathBuf};
use std::process::Command;
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;
use upswing_ipc::{Clock, Mode};
use upswing_record::Message;
use upswing_record::replay::{RecordedRun, Replay, ReplayError, settings};
use upswing_tests::{START, System, programs};

fn replay(recording: &RecordedRun) -> Result<Replay, ReplayError> {
    upswing_record::replay::replay(recording, &settings(&recording.recording)?)
}

/// A run on the way to a mode, then with a lost encoder and a reset.
fn recorded(folder: &Path, clock: Clock, goal: Mode) -> (PathBuf, RecordedRun) {
    let file = folder.join("run.mcap");
    let mut system = System::start_recorded(clock, START, None, Some(&file));
    system.bring_to(goal);
    system.inject("encoder-nan --joint pendulum_1 --cycles 1");
    system.wait_until("a fault", |record| record.mode() == Ok(Mode::Fault));
    system.advance(400);
    system.request(OperatorRequest::Reset);
    system.advance(400);
    system.end();
    let recording = RecordedRun::read(&file).unwrap_or_else(|e| panic!("{e}"));
    (file, recording)
}

#[test]
fn from_lockstep() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, recording) = recorded(folder.path(), Clock::Lockstep, Mode::Balance);
    let result = replay(&recording).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(result.difference, None);
    assert!(result.compared > 10_000, "only {} cycles", result.compared);
    assert_eq!(result.compared, recording.cycles.len() as u64);

    a_changed_input_is_found(&recording);
    a_missing_step_is_told(&recording);
    kept_by_one_command(&file);
}

#[test]
fn from_a_paced_run() {
    let folder = tempfile::tempdir().expect("a folder");
    // Short: steps wait for a second, and a busy machine may leave a test without a CPU for as long.
    let (_, recording) = recorded(folder.path(), Clock::Paced, Mode::Hold);
    let result = replay(&recording).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(result.difference, None);
    assert!(result.compared > 2_000, "only {} cycles", result.compared);
}

#[test]
fn from_a_run_on_the_wall_clock() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let mut system = System::start_recorded(Clock::Wall, START, None, Some(&file));
    system.advance(1);
    // Whatever becomes of it where the machine is busy: late cycles and their faults replay like all others.
    let _ = system.session.request(OperatorRequest::Enable);
    system.advance(2000);
    system.end();
    let recording = RecordedRun::read(&file).unwrap_or_else(|e| panic!("{e}"));
    let result = replay(&recording).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(result.difference, None);
    assert!(result.compared >= 2000, "only {} cycles", result.compared);
}

fn a_changed_input_is_found(recording: &RecordedRun) {
    let mut changed = recording.clone();
    let cycle = recording.cycles.len() as u64 / 2;
    for input in &mut changed.inputs {
        if let Message::Step(step) = input
            && step.cycle == cycle
        {
            step.measurement.q[6] += 1e-9;
        }
    }
    let result = replay(&changed).unwrap_or_else(|e| panic!("{e}"));
    let difference = result.difference.expect("a difference");
    assert_eq!((difference.cycle, difference.field.as_str()), (cycle, "q of joint_7"));
}

fn a_missing_step_is_told(recording: &RecordedRun) {
    let mut cut = recording.clone();
    cut.inputs.retain(|input| !matches!(input, Message::Step(step) if step.number == 5));
    let error = replay(&cut).expect_err("a step is missing");
    assert!(matches!(error, ReplayError::Gap { expected: 5, got: 6 }), "{error}");
}

fn kept_by_one_command(file: &Path) {
    let kept = file.with_file_name("kept.mcap");
    let output = Command::new(programs().join("upswing"))
        .arg("replay")
        .arg(file)
        .arg("--keep")
        .arg(&kept)
        .output()
        .expect("upswing runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let size = |path: &Path| path.metadata().expect("a file").len();
    assert!(size(&kept) < size(file) / 2, "{} of {} bytes", size(&kept), size(file));
    let modes = decisions(&kept);
    assert_eq!(
        modes,
        [Mode::Idle, Mode::Hold, Mode::Track, Mode::Balance, Mode::Fault, Mode::Idle, Mode::Idle]
    );
}

/// Replays a kept recording with the default settings: the modes in it, which must be those of the controller.
fn decisions(file: &Path) -> Vec<Mode> {
    let recording = RecordedRun::read(file).unwrap_or_else(|e| panic!("{e}"));
    let config = Config::embedded().expect("settings");
    let result = upswing_record::replay::replay(&recording, &config);
    let result = result.unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    assert_eq!(result.compared, recording.cycles.len() as u64, "{}", file.display());
    assert_eq!(result.decision, None, "{}", file.display());
    recording.cycles.iter().map(|cycle| cycle.mode().expect("a mode")).collect()
}

#[test]
fn kept_ones_decide_as_ever() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings");
    let files = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let files: Vec<_> = files.flatten().map(|entry| entry.path()).collect();
    let recordings = files.iter().filter(|path| path.extension().is_some_and(|e| e == "mcap"));
    let kept: Vec<_> = recordings.map(|file| decisions(file)).collect();
    assert!(kept.iter().all(|modes| !modes.is_empty()) && !kept.is_empty(), "in {}", folder.display());
}
