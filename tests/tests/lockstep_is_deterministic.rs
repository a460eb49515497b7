//! Equal inputs give bit-identical telemetry: every field of every cycle of two runs, from the first cycle to the
//! balance.

use upswing_ipc::{Clock, Telemetry};
use upswing_tests::{System, same_bits};

fn run() -> Vec<Telemetry> {
    let mut system = System::start(Clock::Lockstep, &[10.0, 10.0, 0.0, -100.0, 0.0, -20.0, 0.0]);
    let report = system.swing_up(2.0);
    assert!(report.success, "{report}");
    std::mem::take(&mut system.session.records)
}

#[test]
fn two_runs_give_the_same_bits() {
    let (first, second) = (run(), run());
    assert_eq!(first.len(), second.len());
    assert!(first.len() > 20_000, "only {} cycles", first.len());
    for (a, b) in first.iter().zip(&second) {
        assert!(same_bits(a, b), "cycle {}:\n{a:?}\n{b:?}", a.seq);
    }
}
