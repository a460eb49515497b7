//! An operator who interrupts while a system waits for its drives gets it back at once, with closed brakes; an enable without an
//! interrupt waits until the drives are ready, and is accepted.

use std::sync::atomic::AtomicBool;
use upswing_ipc::{Clock, Mode, Readiness};
use upswing_rig::session::SessionError;
use upswing_tests::{START, System};

#[test]
fn and_without_an_interrupt_the_enable_is_accepted() {
    let mut system = System::start(Clock::Paced, START);
    let interrupted = system.session.enable(&AtomicBool::new(true));
    assert!(matches!(interrupted, Err(SessionError::Interrupted)), "{interrupted:?}");
    assert_eq!(system.status().mode(), Ok(Mode::Idle));
    let enabled = system.session.enable(&AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((enabled.accepted, enabled.readiness()), (1, Ok(Readiness::Ready)));
    system.end();
}
