//! A recording holds every cycle bit for bit, up to its last complete chunk if it was cut off anywhere, and what is no
//! recording is refused.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::path::Path;
use upswing::recording::{CHUNK, Recorder, RecordingError, Window, cycle, read};
use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};

fn record(seq: u64) -> Telemetry {
    let mut t = Telemetry { seq, t_ns: seq * 125_000, mode: seq % 6, ..Telemetry::default() };
    for i in 0..9 {
        (t.q[i], t.qd[i]) = ((seq as f64 * 1e-3 + i as f64).sin(), -0.0);
    }
    (t.tau[6], t.write_ns) = (f64::MIN_POSITIVE, u64::MAX - seq);
    t
}

/// Records `cycles` in a new file in `dir`, in batches like those of the daemon.
fn recorded(dir: &Path, cycles: &[Telemetry]) -> std::path::PathBuf {
    let path = dir.join("run.mcap");
    let config = Config::embedded().expect("the settings load");
    let mut recorder =
        Recorder::create(&path, &config, [("clock", "lockstep".into())]).expect("the file is made");
    for batch in cycles.chunks(64) {
        recorder.write(batch).expect("written");
    }
    let tally = recorder.finish().expect("finished");
    assert_eq!(tally.cycles, cycles.len() as u64);
    path
}

#[test]
fn all_fields_of_all_cycles() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=CHUNK as u64 + 500).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let (read_back, recording) = read(&path, Window::ALL).expect("it reads");
    assert_eq!((&read_back, &recording.cut), (&cycles, &None));
    assert_eq!(recording.details["clock"], "lockstep");
    let config = Config::embedded().expect("the settings load");
    assert_eq!(recording.file_text("robot.urdf"), Some(config.urdf.as_str()));
    let (part, _) = read(&path, Window { from: 0.01, to: 0.02 }).expect("it reads");
    assert_eq!((part[0].seq, part.len()), (81, 81));
}

#[test]
fn lost_cycles_and_restarts_are_counted() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = Config::embedded().expect("the settings load");
    let mut recorder = Recorder::create(&dir.path().join("a.mcap"), &config, []).expect("made");
    recorder.write(&[7, 8, 11, 1, 2].map(record)).expect("written");
    let tally = recorder.tally();
    assert_eq!((tally.cycles, tally.lost, tally.restarts), (5, 2, 1));
}

#[test]
fn an_existing_file_is_kept() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("run.mcap");
    std::fs::write(&path, "precious").expect("written");
    let config = Config::embedded().expect("the settings load");
    assert!(matches!(Recorder::create(&path, &config, []), Err(RecordingError::Create { .. })));
    assert_eq!(std::fs::read(&path).expect("read"), b"precious");
}

#[test]
fn other_messages_are_refused() {
    let good = cycle::encode(&record(3));
    assert_eq!(cycle::decode(&good), Some(record(3)));
    for bad in [&good[..good.len() - 1], &good[..good.len() - 8], &good[4..], &[]] {
        assert_eq!(cycle::decode(bad), None);
    }
    // The definition names each field and each mode.
    let definition = cycle::definition();
    let balance = format!("uint64 BALANCE={}", Mode::Balance.code());
    for text in ["float64[9] q", "uint64 wake_ns", &balance] {
        assert!(cycle::layout_of(&definition).contains(&text), "{text} in {definition}");
    }
}

#[test]
fn another_kind_of_file_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("x.mcap");
    std::fs::write(&path, "no recording").expect("written");
    assert!(matches!(read(&path, Window::ALL), Err(RecordingError::NotMcap { .. })));
    let path = dir.path().join("gone.mcap");
    assert!(matches!(read(&path, Window::ALL), Err(RecordingError::Read { .. })));
}

#[test]
fn a_file_cut_anywhere_is_readable_to_its_last_chunk() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=4 * CHUNK as u64).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let whole = std::fs::read(&path).expect("read");
    let mut most = 0;
    for eighth in 1..8 {
        std::fs::write(&path, &whole[..whole.len() * eighth / 8]).expect("written");
        match read(&path, Window::ALL) {
            Ok((read_back, recording)) => {
                let n = read_back.len();
                assert!(recording.cut.is_some() && n >= most, "{n} cycles in {eighth}/8");
                assert!(n >= CHUNK * (eighth / 2).saturating_sub(1), "{n} cycles in {eighth}/8");
                assert_eq!(read_back, cycles[..n]);
                most = n;
            }
            // Shorter than what stands before the first chunk, and that chunk.
            Err(RecordingError::Missing { .. }) => assert_eq!(most, 0),
            Err(e) => panic!("{eighth}/8: {e}"),
        }
    }
    assert!(most >= 2 * CHUNK, "{most} cycles");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_damage_panics(at in 0.0_f64..1.0, byte in any::<u8>(), cut in 0.0_f64..1.0) {
        let dir = tempfile::tempdir().expect("a folder");
        let path = recorded(dir.path(), &(1..=40).map(record).collect::<Vec<_>>());
        let mut bytes = std::fs::read(&path).expect("read");
        let i = (at * bytes.len() as f64) as usize;
        bytes[i] ^= byte;
        bytes.truncate((bytes.len() as f64 * (0.5 + cut)) as usize);
        std::fs::write(&path, bytes).expect("written");
        if let Ok((read_back, _)) = read(&path, Window::ALL) {
            prop_assert!(read_back.len() <= 40);
        }
    }
}
