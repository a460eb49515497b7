//! A database file reads back exactly; any flipped bit, truncation or appended byte is found and named; a journal
//! that ends within a record gives what is whole.

use proptest::prelude::*;
use upswing_model::{ActuatedVector, State};
use upswing_trajectory::{
    Certificate, Database, DatabaseError, DatabaseHeading, Entry, KNOTS, PoseOutcome, PoseRecord, Trajectory,
};

fn example() -> Database {
    let solved = |pose: u64| {
        let seed = pose as f64 + 0.25;
        let trajectory = Trajectory {
            t_f: 2.0 + seed,
            x: Box::new(std::array::from_fn(|k| {
                State::from_fn(|i, _| (k as f64 * 0.1 + i as f64 + seed).sin())
            })),
            u: Box::new(std::array::from_fn(|k| {
                ActuatedVector::from_fn(|i, _| (k as f64 - i as f64) * seed)
            })),
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
    Database {
        heading: DatabaseHeading { model: 1, problem: 2, grid: 3, poses: 4, shard: 1, shards: 1 },
        records: vec![solved(0), short(1, PoseOutcome::Rejected), short(2, PoseOutcome::Failed), solved(3)],
    }
}

#[test]
fn what_was_written_is_read() {
    let bytes = example().encode();
    let read = Database::decode(&bytes).expect("it reads");
    // As bytes, because a NaN differs from itself.
    assert_eq!(read.encode(), bytes);
    assert_eq!(read.entries().count(), 2);
}

#[test]
fn an_empty_file_says_how_to_get_one() {
    assert_eq!(Database::decode(&[]), Err(DatabaseError::Empty));
    let none = Database { records: Vec::new(), ..example() };
    assert_eq!(none.entries_for(1, 2), Err(DatabaseError::Empty));
}

#[test]
fn other_settings_and_single_shards_are_refused() {
    let expected = DatabaseError::Fingerprint { what: "robot model", expected: 9, got: 1 };
    assert_eq!(example().entries_for(9, 2), Err(expected));
    let mut shard = example();
    (shard.heading.shard, shard.heading.shards) = (2, 3);
    assert_eq!(shard.entries_for(1, 2), Err(DatabaseError::Shard { shard: 2, shards: 3 }));
}

#[test]
fn another_file_is_not_taken_for_a_database() {
    assert!(matches!(Database::decode(b"<?xml version=\"1.0\"?>"), Err(DatabaseError::Magic { .. })));
}

#[test]
fn another_version_is_named() {
    let mut bytes = example().encode();
    bytes[8] = 1;
    let refusal = Database::decode(&bytes).expect_err("refused");
    assert_eq!(refusal, DatabaseError::Layout { what: "format version", expected: 2, got: 1 });
}

#[test]
fn numbers_that_no_trajectory_has_are_refused() {
    let refused = |change: &dyn Fn(&mut Trajectory), part: &str| {
        let mut database = example();
        let PoseOutcome::Solved(entry) = &mut database.records[3].outcome else { panic!("solved") };
        change(&mut entry.trajectory);
        let bytes = database.encode();
        let refusal = Database::decode(&bytes).expect_err("refused");
        assert!(matches!(refusal, DatabaseError::Value { .. }), "{refusal}");
        assert!(refusal.to_string().contains("record 3") && refusal.to_string().contains(part), "{refusal}");
        assert_eq!(Database::recover(&bytes).expect("the rest is good").0.records.len(), 3);
    };
    for t_f in [0.0, -1.0, 1e9, f64::NAN, f64::INFINITY] {
        refused(
            &|t| t.t_f = t_f,
            &format!("t_F of record 3: expected more than 0 and at most 60 s, got {t_f}"),
        );
    }
    refused(&|t| t.x[0][3] = f64::INFINITY, "expected finite numbers, got inf");
    refused(&|t| t.x[KNOTS - 1][8] = f64::NAN, "expected finite numbers, got NaN");
    refused(&|t| t.u[50][2] = f64::NAN, "expected finite numbers, got NaN");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn a_flipped_bit_is_found(place in any::<prop::sample::Index>(), bit in 0u8..8) {
        let mut bytes = example().encode();
        let at = place.index(bytes.len());
        bytes[at] ^= 1 << bit;
        prop_assert!(Database::decode(&bytes).is_err(), "bit {bit} of byte {at}");
    }

    #[test]
    fn a_truncated_file_is_found(place in any::<prop::sample::Index>()) {
        let bytes = example().encode();
        prop_assert!(Database::decode(&bytes[..place.index(bytes.len())]).is_err());
    }

    #[test]
    fn an_appended_file_is_found(extra in prop::collection::vec(any::<u8>(), 1..100)) {
        let mut bytes = example().encode();
        bytes.extend(extra);
        let found = matches!(Database::decode(&bytes), Err(DatabaseError::Length { .. }));
        prop_assert!(found);
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(Database::decode(&bytes).is_err());
        prop_assert!(Database::recover(&bytes).is_err());
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
        let (recovered, length) = Database::recover(&bytes[..cut]).expect("the header is whole");
        let whole = ends.iter().filter(|end| **end <= cut).count() - 1;
        prop_assert_eq!((recovered.records.len(), length), (whole, ends[whole]));
    }
}
