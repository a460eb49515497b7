//! Time advances in lockstep although faults hold measurements back: the harness continues, and no executed cycle is lost.

use upswing_ipc::{Clock, Mode};
use upswing_tests::{START, System};

#[test]
fn also_in_the_last_cycle() {
    let mut system = System::start(Clock::Lockstep, START);
    system.bring_to(Mode::Hold);
    let last = system.session.records.last().expect("a record").measurement_seq;
    system.inject(&format!("drop-measurement --from {} --cycles 8", last + 93));
    system.advance(100);
    let records = &system.session.records;
    assert_eq!(
        records.last().expect("a record").measurement_seq,
        last + 92,
        "the last one that came through"
    );
    system.advance(100);
    let records = &system.session.records;
    assert_eq!(records.last().expect("a record").measurement_seq, last + 200);
    assert!(records.windows(2).all(|pair| pair[1].seq == pair[0].seq + 1), "cycles are lost");
    assert_eq!(records.last().and_then(|record| record.mode().ok()), Some(Mode::Hold));
    system.end();
}
