//! A flight record has the newest cycles, and a damaged file is refused.

use proptest::prelude::*;
use upswing_config::RecorderSettings;
use upswing_ipc::Telemetry;
use upswingd::flight::{FlightError, FlightRecorder, read};

fn record(seq: u64) -> Telemetry {
    let mut record = Telemetry { seq, mode: seq % 6, t_plan: seq as f64 * 0.1, ..Telemetry::default() };
    (record.q[8], record.tau[6], record.write_ns) = (-0.0, f64::MIN_POSITIVE, u64::MAX - seq);
    record
}

fn recorder(capacity: usize, cycles: u64) -> FlightRecorder {
    let mut recorder = FlightRecorder::new(capacity);
    (1..=cycles).for_each(|seq| recorder.push(&record(seq)));
    recorder
}

fn settings(dir: &tempfile::TempDir, keep: usize) -> RecorderSettings {
    // The folder is made when it is needed.
    RecorderSettings { directory: Some(dir.path().join("flights")), keep }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(50))]

    #[test]
    fn the_newest_cycles_in_order(capacity in 1_usize..40, cycles in 0_u64..200) {
        let dir = tempfile::tempdir().unwrap();
        let path = recorder(capacity, cycles).save(&settings(&dir, 1)).unwrap().unwrap();
        let first = cycles.saturating_sub(capacity as u64) + 1;
        prop_assert_eq!(read(&path).unwrap(), (first..=cycles).map(record).collect::<Vec<_>>());
    }

    #[test]
    fn any_damage_is_found(byte in 0_usize..2000, bit in 0_u32..8, cut in 0_usize..100) {
        let dir = tempfile::tempdir().unwrap();
        let path = recorder(3, 5).save(&settings(&dir, 1)).unwrap().unwrap();
        let good = std::fs::read(&path).unwrap();
        let mut bytes = good.clone();
        let byte = byte % bytes.len();
        bytes[byte] ^= 1 << bit;
        std::fs::write(&path, &bytes).unwrap();
        prop_assert!(!matches!(read(&path), Ok(_) | Err(FlightError::Io(_))), "bit {bit} of byte {byte}");
        std::fs::write(&path, &good[..good.len() - 1 - cut]).unwrap();
        prop_assert!(!matches!(read(&path), Ok(_) | Err(FlightError::Io(_))));
    }

    #[test]
    fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..4000)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.flight");
        std::fs::write(&path, bytes).unwrap();
        prop_assert!(read(&path).is_err());
    }
}

#[test]
fn the_oldest_files_go_first() {
    let dir = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    for cycles in 1..=4 {
        paths.push(recorder(2, cycles).save(&settings(&dir, 2)).unwrap().unwrap());
        // Names carry milliseconds.
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let left: Vec<bool> = paths.iter().map(|path| path.exists()).collect();
    assert_eq!(left, [false, false, true, true]);
    assert_eq!(read(&paths[3]).unwrap(), [record(3), record(4)]);
}

#[test]
fn without_a_folder_nothing_is_written() {
    assert_eq!(recorder(2, 3).save(&RecorderSettings { directory: None, keep: 1 }).unwrap(), None);
}

#[test]
fn a_folder_that_cannot_be_made_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("flights"), "in the way").unwrap();
    recorder(2, 3).save(&settings(&dir, 1)).unwrap_err();
}
