//! A database file reads back exactly, for chains of any sizes; any flipped bit, truncation or appended byte is found and named; a
//! journal that ends within a record gives what is whole; a header that no build writes is refused.

use proptest::prelude::*;
use upswing_model::{ActuatedVector, Model, Sizes, State};
use upswing_trajectory::{
    Certificate, Database, DatabaseContents, DatabaseError, DatabaseHeading, DatabaseSource, Entry,
    PoseOutcome, PoseRecord, RecordScan, Trajectory,
};
use xxhash_rust::xxh3::xxh3_64;

const N: usize = 20;

/// The contents of a file with these bytes.
fn decode(bytes: &[u8]) -> Result<DatabaseContents, DatabaseError> {
    DatabaseContents::decode(bytes.to_vec())
}

/// The complete records of a journal with these bytes, and where they end.
fn recover(bytes: &[u8]) -> Result<(Vec<PoseRecord>, u64), DatabaseError> {
    let source = DatabaseSource::Memory(bytes.to_vec().into());
    let mut scan = RecordScan::new(&source)?;
    let records = scan.by_ref().map_while(Result::ok).map(|(_, record)| record).collect();
    Ok((records, scan.at()))
}

/// The bytes of a journal with these contents.
fn journal(contents: &DatabaseContents) -> Vec<u8> {
    contents
        .records
        .iter()
        .fold(contents.heading.journal(), |bytes, record| [bytes, record.encode()].concat())
}

/// The records of a file without an index.
fn scan(bytes: &[u8]) -> Result<Vec<PoseRecord>, DatabaseError> {
    let source = DatabaseSource::Memory(bytes.to_vec().into());
    RecordScan::new(&source)?.map(|found| found.map(|(_, record)| record)).collect()
}

fn check_for(contents: &DatabaseContents, model: &Model) -> Result<(), DatabaseError> {
    Database::load(DatabaseSource::Memory(contents.encode().into()))?.check_for(model, 2)
}

fn robot() -> Model {
    Model::from_urdf(include_str!("../../config/systems/iiwa-pendulum/robot.urdf"))
        .expect("the shipped robot")
}

fn example() -> DatabaseContents {
    example_of(Sizes::new(9, 7).expect("a chain"), N)
}

fn example_of(sizes: Sizes, n: usize) -> DatabaseContents {
    let solved = |pose: u64| {
        let seed = pose as f64 + 0.25;
        let trajectory = Trajectory {
            t_f: 2.0 + seed,
            x: (0..=n).map(|k| State::from_fn(sizes, |i| (k as f64 * 0.1 + i as f64 + seed).sin())).collect(),
            u: (0..=n).map(|k| ActuatedVector::from_fn(sizes, |i| (k as f64 - i as f64) * seed)).collect(),
        };
        let figures = |t: &Trajectory| Certificate {
            cost: t.t_f,
            defect: 1e-9,
            margin_q: 0.1,
            margin_qd: -0.2,
            margin_tau: 0.3,
            end_error: f64::NAN,
        };
        PoseRecord { pose, outcome: PoseOutcome::Solved(Box::new(Entry::new(&trajectory, figures))) }
    };
    let short = |pose, outcome| PoseRecord { pose, outcome };
    DatabaseContents {
        heading: DatabaseHeading {
            sizes,
            // Lengths of 0, 8 and more bytes, and letters of more than one.
            joints: (0..sizes.joints()).map(|i| "éa1_joint".chars().take(i).collect()).collect(),
            intervals: n,
            key: sizes.actuated(),
            model: 1,
            problem: 2,
            grid: 3,
            poses: 4,
            shard: 1,
            shards: 1,
        },
        records: vec![solved(0), short(1, PoseOutcome::Rejected), short(2, PoseOutcome::Failed), solved(3)],
    }
}

#[test]
fn what_was_written_is_read() {
    for (joints, actuated, n) in [(2, 1, 20), (3, 1, 37), (9, 7, 100), (16, 1, 20), (16, 15, 1000)] {
        let example = example_of(Sizes::new(joints, actuated).expect("a chain"), n);
        let bytes = example.encode();
        let read = decode(&bytes).expect("it reads");
        // As bytes, because a NaN differs from itself.
        assert_eq!(read.encode(), bytes);
        assert_eq!(read.heading, example.heading);
        assert_eq!(read.entries().count(), 2);
        for (read, written) in read.entries().zip(example.entries()) {
            assert_eq!((&read.key, &read.trajectory), (&written.key, &written.trajectory));
            assert_eq!(read.key, read.trajectory.start().q_a().to_vec());
        }
    }
}

#[test]
fn keys_may_have_more_than_the_start_pose() {
    let mut example = example();
    example.heading.key = 9;
    for record in &mut example.records {
        let PoseOutcome::Solved(entry) = &mut record.outcome else { continue };
        entry.key.extend([0.5, -0.25]);
    }
    let read = decode(&example.encode()).expect("it reads");
    assert!(read.entries().all(|e| e.key.len() == 9 && e.key[7..] == [0.5, -0.25]));
    let PoseOutcome::Solved(entry) = &mut example.records[3].outcome else { panic!("solved") };
    entry.key[8] = f64::NAN;
    let refusal = scan(&journal(&example)).expect_err("refused");
    assert!(refusal.to_string().contains("the key of record 3: expected finite numbers"), "{refusal}");
    assert!(matches!(decode(&example.encode()), Err(DatabaseError::Value { .. })), "the index, too");
}

#[test]
fn an_empty_file_says_how_to_get_one() {
    assert_eq!(decode(&[]), Err(DatabaseError::Empty));
    let model = robot();
    let none = DatabaseContents { records: Vec::new(), ..of_robot(&model) };
    assert_eq!(check_for(&none, &model), Err(DatabaseError::Empty));
}

/// The example, as one that was made for `model`.
fn of_robot(model: &Model) -> DatabaseContents {
    let mut database = example_of(model.sizes(), N);
    database.heading.joints = DatabaseHeading::joints_of(model);
    database.heading.model = model.fingerprint();
    database
}

#[test]
fn other_robots_other_settings_and_single_shards_are_refused() {
    let model = robot();
    assert_eq!(check_for(&of_robot(&model), &model), Ok(()));
    let refused = |change: &dyn Fn(&mut DatabaseHeading), expected: DatabaseError| {
        let mut database = of_robot(&model);
        change(&mut database.heading);
        assert_eq!(database.heading.check_origin(&model, 2), Err(expected));
    };
    let expected = model.fingerprint();
    let got = expected ^ 1;
    refused(&|h| h.model = got, DatabaseError::Fingerprint { what: "robot model", expected, got });
    let what = "set of limits and weights";
    refused(&|h| h.problem = 9, DatabaseError::Fingerprint { what, expected: 2, got: 9 });
    let expected = DatabaseHeading::joints_of(&model);
    let mut got = expected.clone();
    got.swap(0, 1);
    refused(&|h| h.joints.swap(0, 1), DatabaseError::Joints { expected: expected.clone(), got });
    let got = expected[1..].to_vec();
    refused(&|h| drop(h.joints.remove(0)), DatabaseError::Joints { expected, got });
    let motors = DatabaseError::Motors { expected: 7, got: 6 };
    refused(&|h| h.sizes = Sizes::new(9, 6).expect("a chain"), motors);
    let mut database = of_robot(&model);
    (database.heading.shard, database.heading.shards) = (2, 3);
    assert_eq!(check_for(&database, &model), Err(DatabaseError::Shard { shard: 2, shards: 3 }));
    database.heading.problem = 9;
    let other = DatabaseError::Fingerprint { what, expected: 2, got: 9 };
    assert_eq!(check_for(&database, &model), Err(other));
}

/// The header of the example with its word number `i` replaced by `value`, and the right checksum.
fn with_word(i: usize, value: u64) -> Vec<u8> {
    let mut bytes = example().heading.journal();
    bytes[8 * i..][..8].copy_from_slice(&value.to_le_bytes());
    let content = bytes.len() - 8;
    let checksum = xxh3_64(&bytes[..content]);
    bytes[content..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn headers_that_no_build_writes_are_refused() {
    let names = 15;
    for (word, value, what) in [
        (2, 0, "length of the header: expected 128 to 1048576, whole words, got 0"),
        (2, 129, "length of the header"),
        (2, u64::MAX - 7, "length of the header"),
        (3, 17, "number of motors"),
        (3, 7, "number of motors: expected fewer than the 7 joints, which are at most 16, got 7"),
        (3, u64::MAX, "number of motors"),
        (4, 0, "number of motors"),
        (4, 9, "number of motors"),
        (4, u64::MAX, "number of motors"),
        (5, 19, "number of intervals: expected 20 to 1000, got 19"),
        (5, 1001, "number of intervals"),
        (5, u64::MAX, "number of intervals"),
        (6, 6, "length of the keys: expected 7 to 25, got 6"),
        (6, 26, "length of the keys"),
        (6, u64::MAX, "length of the keys"),
        (14, u64::MAX, "number of entries: expected at most the "),
        (11, 0, "shard: expected 1 to 1, got 0"),
        (11, 2, "shard"),
        (3, 8, "names of the joints: expected 8 names in UTF-8, got "),
        (3, 10, "names of the joints: expected 10 names in UTF-8, got 9 names"),
        (names, 1 << 20, "names of the joints: expected 9 names in UTF-8, got 0 names"),
        (names, u64::MAX, "names of the joints"),
        // Within the first of the two bytes of the letter of the second name.
        (names + 1, 1, "names of the joints: expected 9 names in UTF-8, got name 2"),
    ] {
        let bytes = with_word(word, value);
        for refusal in [decode(&bytes).expect_err(what), recover(&bytes).expect_err(what)] {
            assert!(matches!(refusal, DatabaseError::Value { .. }), "word {word} = {value}: {refusal}");
            assert!(refusal.to_string().starts_with(what), "word {word} = {value}: {refusal}");
        }
    }
    let bytes = with_word(2, 1 << 19);
    assert!(matches!(decode(&bytes), Err(DatabaseError::Length { .. })));
    // More records than the file has.
    let mut bytes = with_word(13, 1 << 60);
    bytes.extend(example().records[1].encode());
    assert!(matches!(decode(&bytes), Err(DatabaseError::Length { .. })));
}

#[test]
fn another_file_is_not_taken_for_a_database() {
    assert!(matches!(decode(b"<?xml version=\"1.0\"?>"), Err(DatabaseError::Magic { .. })));
}

/// The bytes of a file of the version before databases had an index.
fn without_index(contents: &DatabaseContents) -> Vec<u8> {
    let mut header = contents.heading.encode(contents.records.len() as u64, 0);
    header.drain(14 * 8..15 * 8);
    header[8] = 3;
    let length = header.len() as u64;
    header[16..24].copy_from_slice(&length.to_le_bytes());
    let content = header.len() - 8;
    let checksum = xxh3_64(&header[..content]);
    header[content..].copy_from_slice(&checksum.to_le_bytes());
    contents.records.iter().for_each(|record| header.extend(record.encode()));
    header
}

#[test]
fn a_file_without_an_index_can_be_scanned() {
    let example = example();
    let bytes = without_index(&example);
    let refusal = decode(&bytes).expect_err("refused");
    assert_eq!(refusal, DatabaseError::NoIndex);
    let encoded = |records: &[PoseRecord]| records.iter().map(PoseRecord::encode).collect::<Vec<_>>();
    assert_eq!(encoded(&scan(&bytes).expect("it is whole")), encoded(&example.records));
    assert!(matches!(scan(&bytes[..bytes.len() - 8]), Err(DatabaseError::Length { .. })));
    assert!(matches!(scan(&[&bytes[..], &[0; 8]].concat()), Err(DatabaseError::Length { .. })));
}

#[test]
fn a_journal_is_no_database() {
    let bytes = [example().heading.journal(), example().records[0].encode()].concat();
    assert_eq!(decode(&bytes), Err(DatabaseError::Journal));
}

/// An index that no build writes, with the right checksum.
#[test]
fn an_index_is_not_trusted() {
    let (bytes, entries, width) = (example().encode(), 2, 7);
    let end = bytes.len() - 8;
    // Ends with the numbers and keys of two trees.
    let tree = 8 * entries * (1 + width);
    let (keys, ends) = (end - 2 * tree, end - tree);
    let durations = keys - 8 * entries;
    for (at, word, what) in [
        (keys, 1, "keys in the index"),
        (keys, 2, "keys in the index"),
        (ends, u64::MAX, "keys in the index"),
        (keys + 8 * entries, f64::NAN.to_bits(), "keys in the index"),
        (end - 8, f64::INFINITY.to_bits(), "keys in the index"),
        (durations, (-1.0_f64).to_bits(), "durations in the index"),
        (durations + 8, f64::NAN.to_bits(), "durations in the index"),
    ] {
        let mut bytes = bytes.clone();
        bytes[at..at + 8].copy_from_slice(&word.to_le_bytes());
        let index = durations - 8 * example().records.len();
        let checksum = xxh3_64(&bytes[index..end]);
        bytes[end..].copy_from_slice(&checksum.to_le_bytes());
        let refusal = decode(&bytes).expect_err(what);
        assert!(refusal.to_string().starts_with(what), "{refusal}");
    }
}

#[test]
fn a_file_that_changes_while_it_is_used_gives_errors() {
    let path = std::env::temp_dir().join(format!("upswing-database-{}.bin", std::process::id()));
    let bytes = example().encode();
    std::fs::write(&path, &bytes).expect("written");
    let open = || std::fs::File::open(&path).expect("it is there");
    let database = Database::load(DatabaseSource::File(open())).expect("it is whole");
    assert!(database.entry(0).is_ok() && database.entry(1).is_ok());
    assert!(database.entry(2).is_err(), "only two records are entries");
    assert!(database.record(3).is_ok() && database.record(4).is_err());
    // Another entry, whole in itself.
    let mut other = example();
    let PoseOutcome::Solved(entry) = &mut other.records[0].outcome else { panic!("solved") };
    entry.certificate.cost += 1.0;
    std::fs::write(&path, other.encode()).expect("written");
    let refusal = database.entry(0).expect_err("another record");
    assert!(matches!(refusal, DatabaseError::Checksum { .. }), "{refusal}");
    let refusal = database.ends().expect_err("another index");
    assert!(matches!(refusal, DatabaseError::Checksum { .. }), "{refusal}");
    std::fs::write(&path, &bytes[..1000]).expect("written");
    let refusal = database.entry(1).expect_err("beyond the end");
    assert_eq!(refusal.to_string(), "cannot read record 1: unexpected end of file");
    let refusal = database.ends().expect_err("beyond the end");
    assert_eq!(refusal.to_string(), "cannot read the index: unexpected end of file");
    std::fs::write(&path, &bytes).expect("written");
    let ends = database.ends().expect("the index is whole again");
    let entries: Vec<_> = example().entries().map(|entry| entry.trajectory.end().q_a().to_vec()).collect();
    assert_eq!(ends.keys().count(), entries.len());
    assert!(ends.keys().all(|(number, end)| end == entries[number]));
    std::fs::remove_file(&path).expect("removed");
}

#[test]
fn another_version_is_named() {
    let mut bytes = example().encode();
    bytes[8] = 1;
    let refusal = decode(&bytes).expect_err("refused");
    assert_eq!(refusal, DatabaseError::Layout { what: "format version", expected: 4, got: 1 });
}

#[test]
fn numbers_that_no_trajectory_has_are_refused() {
    let refused_entry = |change: &dyn Fn(&mut Entry), part: &str| {
        let mut database = example();
        let PoseOutcome::Solved(entry) = &mut database.records[3].outcome else { panic!("solved") };
        change(entry);
        let refusal = decode(&database.encode()).expect_err("refused");
        assert!(matches!(refusal, DatabaseError::Value { .. }), "{refusal}");
        let bytes = journal(&database);
        let refusal = scan(&bytes).expect_err("refused");
        assert!(matches!(refusal, DatabaseError::Value { .. }), "{refusal}");
        assert!(refusal.to_string().contains("record 3") && refusal.to_string().contains(part), "{refusal}");
        assert_eq!(recover(&bytes).expect("the rest is good").0.len(), 3);
    };
    let refused = |change: &dyn Fn(&mut Trajectory), part: &str| {
        refused_entry(&|e| change(&mut e.trajectory), part);
    };
    for t_f in [0.0, -1.0, 1e9, f64::NAN, f64::INFINITY] {
        refused(
            &|t| t.t_f = t_f,
            &format!("t_F of record 3: expected more than 0 and at most 60 s, got {t_f}"),
        );
    }
    refused(&|t| t.x[0][3] = f64::INFINITY, "expected finite numbers, got inf");
    refused(&|t| t.x[N][8] = f64::NAN, "expected finite numbers, got NaN");
    refused(&|t| t.u[10][2] = f64::NAN, "expected finite numbers, got NaN");
    refused_entry(&|e| e.key[3] = 5.0, "the key of record 3: expected the start pose");
    refused_entry(&|e| e.key[3] = f64::NAN, "the key of record 3: expected the start pose");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn a_flipped_bit_is_found(place in any::<prop::sample::Index>(), bit in 0u8..8) {
        let mut bytes = example().encode();
        let at = place.index(bytes.len());
        bytes[at] ^= 1 << bit;
        prop_assert!(decode(&bytes).is_err(), "bit {bit} of byte {at}");
    }

    #[test]
    fn a_truncated_file_is_found(place in any::<prop::sample::Index>()) {
        let bytes = example().encode();
        prop_assert!(decode(&bytes[..place.index(bytes.len())]).is_err());
    }

    #[test]
    fn an_appended_file_is_found(extra in prop::collection::vec(any::<u8>(), 1..100)) {
        let mut bytes = example().encode();
        bytes.extend(extra);
        let found = matches!(decode(&bytes), Err(DatabaseError::Length { .. }));
        prop_assert!(found);
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(decode(&bytes).is_err());
        prop_assert!(recover(&bytes).is_err());
    }

    #[test]
    fn a_torn_journal_gives_its_whole_records(place in any::<prop::sample::Index>()) {
        let example = example();
        let mut bytes = example.heading.journal();
        let mut ends = vec![bytes.len()];
        for record in &example.records {
            bytes.extend(record.encode());
            ends.push(bytes.len());
        }
        let cut = ends[0] + place.index(bytes.len() - ends[0] + 1);
        let (recovered, length) = recover(&bytes[..cut]).expect("the header is whole");
        let whole = ends.iter().filter(|end| **end <= cut).count() - 1;
        prop_assert_eq!((recovered.len(), length), (whole, ends[whole] as u64));
    }
}
