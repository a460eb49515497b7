//! A database file reads back exactly; any flipped bit, truncation or appended byte is found and named.

use proptest::prelude::*;
use upswing_model::{ActuatedVector, State};
use upswing_trajectory::{Database, DatabaseError, Entry, KNOTS, Trajectory};

fn example() -> Database {
    let entry = |seed: f64| Entry {
        cost: 2.5 + seed,
        trajectory: Trajectory {
            t_f: 2.0 + seed,
            x: (0..KNOTS).map(|k| State::from_fn(|i, _| (k as f64 * 0.1 + i as f64 + seed).sin())).collect(),
            u: (0..KNOTS).map(|k| ActuatedVector::from_fn(|i, _| (k as f64 - i as f64) * seed)).collect(),
        },
    };
    Database { model: 0x1234, problem: 0x5678, entries: vec![entry(0.25), entry(-0.5)] }
}

#[test]
fn what_was_written_is_read() {
    let database = example();
    assert_eq!(Database::decode(&database.encode()), Ok(database));
}

#[test]
fn an_empty_file_says_how_to_get_one() {
    assert_eq!(Database::decode(&[]), Err(DatabaseError::Empty));
    let none = Database { entries: Vec::new(), ..example() };
    assert_eq!(Database::decode(&none.encode()), Err(DatabaseError::Empty));
}

#[test]
fn another_file_is_not_taken_for_a_database() {
    assert!(matches!(Database::decode(b"<?xml version=\"1.0\"?>"), Err(DatabaseError::Magic { .. })));
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
    }
}
