//! Bytes from another process become text or an enumeration only if they are valid.

use proptest::prelude::*;
use std::str::FromStr;
use upswing_ipc::{
    Clock, ControlKind, ControlRequest, Degradation, ManoeuvreRequest, Mode, Name, NoName, PlannerKind,
    PlannerStatus, PlantKind, Readiness, Text, TextError, UnknownClock, UnknownCode,
};
use upswing_model::MOST_JOINTS;

fn text_of(len: u64, bytes: &[u8]) -> Text {
    let mut text = Text { len, ..Text::default() };
    text.bytes[..bytes.len()].copy_from_slice(bytes);
    text
}

#[test]
fn a_length_beyond_the_end_is_refused() {
    for got in [Text::CAPACITY as u64 + 1, 1 << 32, u64::MAX] {
        let text = text_of(got, b"ab");
        assert_eq!(text.as_str(), Err(TextError::Length { got }));
        assert!(text.to_string().contains(&got.to_string()), "printing it says what is wrong");
    }
}

#[test]
fn bytes_that_are_no_utf8_are_refused() {
    assert_eq!(text_of(4, b"ok\xff\xff").as_str(), Err(TextError::Encoding { valid_up_to: 2 }));
    assert_eq!(text_of(1, "ü".as_bytes()).as_str(), Err(TextError::Encoding { valid_up_to: 0 }));
}

#[test]
fn long_text_is_cut_at_a_character() {
    let text = Text::new(&"€".repeat(200));
    assert_eq!(text.as_str(), Ok("€".repeat(Text::CAPACITY / 3).as_str()));
    assert_eq!(Text::new("").as_str(), Ok(""));
    assert_eq!(format!("{:>5}|{:?}", Text::new("hi"), Text::new("hi")), "   hi|\"hi\"");
}

proptest! {
    #[test]
    fn text_returns_the_longest_beginning_that_fits(original in ".{0,300}") {
        let text = Text::new(&original);
        let kept = text.as_str().unwrap();
        prop_assert!(original.starts_with(kept));
        let next = original[kept.len()..].chars().next().map_or(usize::MAX, char::len_utf8);
        prop_assert!(kept.len().saturating_add(next) > Text::CAPACITY);
    }

    #[test]
    fn no_bytes_make_text_panic(len in prop_oneof![0..300_u64, any::<u64>()], bytes in prop::collection::vec(any::<u8>(), Text::CAPACITY)) {
        let text = text_of(len, &bytes);
        let _ = (text.as_str(), text.to_string(), format!("{text:?}"));
    }
}

macro_rules! codes_are_checked {
    ($($name:ident: $count:literal $what:literal),+ $(,)?) => {$(
        assert_eq!($name::ALL.len(), $count);
        for (code, &variant) in $name::ALL.iter().enumerate() {
            assert_eq!(variant.code(), code as u64);
            assert_eq!($name::try_from(code as u64), Ok(variant));
            assert!(!variant.to_string().is_empty());
        }
        for got in [$count, 1 << 32, u64::MAX] {
            assert_eq!($name::try_from(got), Err(UnknownCode { what: $what, got, max: $count - 1 }));
        }
    )+};
}

#[test]
fn a_name_fits_or_is_refused() {
    let longest = "n".repeat(Name::CAPACITY);
    assert_eq!(Name::new(&longest).unwrap().as_str(), longest);
    assert_eq!(Name::new("swing-up").unwrap().to_string(), "swing-up");
    for name in [String::new(), format!("{longest}n")] {
        assert_eq!(Name::new(&name), Err(NoName { got: name }));
    }
    for (bytes, name) in [([0xff; Name::CAPACITY], ""), ([0; Name::CAPACITY], "")] {
        assert_eq!(Name { bytes }.as_str(), name);
    }
}

#[test]
fn given_values_end_with_the_array() {
    let manoeuvre = ManoeuvreRequest::new("move", &[0.5; MOST_JOINTS + 1]).unwrap();
    assert_eq!(manoeuvre.given(), [0.5; MOST_JOINTS]);
    for number in [MOST_JOINTS as u64 + 1, u64::MAX] {
        assert_eq!(ManoeuvreRequest { number, ..manoeuvre }.given(), [0.5; MOST_JOINTS]);
    }
}

#[test]
fn only_known_codes_become_variants() {
    codes_are_checked! {
        Clock: 3 "clock",
        Mode: 6 "mode",
        Readiness: 4 "readiness",
        ControlKind: 6 "control request",
        Degradation: 5 "degradation",
        PlannerKind: 2 "planner request",
        PlannerStatus: 7 "planner status",
        PlantKind: 6 "plant request",
    }
    let error = ControlRequest { kind: 99, plan_id: 0 }.kind().unwrap_err();
    assert!(error.to_string().starts_with("unknown control request code 99: expected 0..=5"), "{error}");
}

#[test]
fn unknown_bits_of_a_degradation_say_nothing() {
    let bits = Degradation::Cpu.bit() | Degradation::Memory.bit() | 1 << 63;
    assert_eq!(Degradation::of(bits).collect::<Vec<_>>(), [Degradation::Memory, Degradation::Cpu]);
}

#[test]
fn codes_that_others_rely_on_stay() {
    assert_eq!((Clock::Wall.code(), Clock::Paced.code(), Clock::Lockstep.code()), (0, 1, 2));
    assert_eq!((PlannerKind::Plan.code(), PlannerKind::Status.code()), (0, 1));
    assert_eq!((Mode::Idle.code(), Mode::Fault.code()), (0, 5));
}

#[test]
fn clocks_are_parsed_by_name() {
    for &clock in Clock::ALL {
        assert_eq!(Clock::from_str(&clock.to_string()), Ok(clock));
    }
    assert_eq!("Wall".parse::<Clock>(), Err(UnknownClock { got: "Wall".into() }));
}
