//! A plan that was damaged anywhere is recognized, and an undamaged one passes through shared memory.

mod common;

use common::wait_for;
use proptest::prelude::*;
use upswing_ipc::{PlanMessage, TempDomain};

/// A sealed plan without a zero byte pattern that a truncation could reproduce.
fn plan(id: u64) -> Box<PlanMessage> {
    let mut plan = PlanMessage::boxed_zeroed();
    let mut next = id as f64;
    let mut number = || {
        next += 1.0 / 3.0;
        next
    };
    plan.id = id;
    plan.fingerprint = 0x0123_4567_89ab_cdef;
    plan.t_f = number();
    plan.x.iter_mut().flatten().for_each(|v| *v = number());
    plan.u.iter_mut().flatten().for_each(|v| *v = number());
    plan.f.iter_mut().flatten().for_each(|v| *v = number());
    plan.k.iter_mut().flatten().flatten().for_each(|v| *v = number());
    plan.k_final.iter_mut().flatten().for_each(|v| *v = number());
    plan.seal();
    plan
}

fn bytes_of(plan: &mut PlanMessage) -> &mut [u8] {
    // SAFETY: plain numbers without padding; every bit pattern is a valid plan.
    unsafe { std::slice::from_raw_parts_mut(std::ptr::from_mut(plan).cast(), size_of::<PlanMessage>()) }
}

#[test]
fn sealed_plans_are_intact_and_unsealed_ones_are_not() {
    let mut plan = plan(1);
    assert!(plan.is_intact());
    assert_eq!(plan.checksum, plan.checksum_of());
    plan.id += 1;
    assert!(!plan.is_intact());
    plan.seal();
    assert!(plan.is_intact());
    assert!(!PlanMessage::boxed_zeroed().is_intact(), "memory that nobody wrote is not a plan");
}

#[test]
fn a_flip_in_every_region_is_found() {
    let mut plan = plan(2);
    let size = size_of::<PlanMessage>();
    let edges = (0..64).chain(size - 64..size);
    // A step that is coprime to 8 meets every byte of a number.
    for at in edges.chain((0..size).step_by(331)) {
        bytes_of(&mut plan)[at] ^= 1;
        assert!(!plan.is_intact(), "byte {at}");
        bytes_of(&mut plan)[at] ^= 1;
    }
    assert!(plan.is_intact());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_flip_anywhere_is_found(at in 0..size_of::<PlanMessage>(), mask in 1..=u8::MAX) {
        let mut plan = plan(3);
        bytes_of(&mut plan)[at] ^= mask;
        prop_assert!(!plan.is_intact());
    }

    #[test]
    fn any_truncation_is_found(from in 0..size_of::<PlanMessage>()) {
        let mut plan = plan(4);
        bytes_of(&mut plan)[from..].fill(0);
        prop_assert!(!plan.is_intact());
    }

    #[test]
    fn any_shift_is_found(from in 0..size_of::<PlanMessage>() / 2, by in 1..1000_usize) {
        let mut plan = plan(5);
        let bytes = bytes_of(&mut plan);
        bytes.copy_within(from + by.., from);
        prop_assert!(!plan.is_intact());
    }
}

#[test]
fn plans_arrive_intact_also_late_and_from_a_restarted_planner() {
    let domain = TempDomain::new("plan").unwrap();
    let daemon = domain.join("daemon").unwrap();
    let early = daemon.subscriber::<PlanMessage>().unwrap();
    for id in 1..=3 {
        let planner = domain.join("planner").unwrap();
        let publisher = planner.publisher::<PlanMessage>().unwrap();
        publisher.publish(&plan(id)).unwrap();
        let received = wait_for("the plan", || early.receive().unwrap());
        let copy = received.boxed_copy();
        assert!(copy.is_intact());
        assert_eq!(copy.id, id);

        let late = daemon.subscriber::<PlanMessage>().unwrap();
        assert!(late.receive().unwrap().is_none());
        publisher.deliver_history().unwrap();
        let received = wait_for("the history", || late.receive().unwrap());
        assert!(received.is_intact());
        assert_eq!(received.id, id);
    }
}

#[test]
fn a_slow_subscriber_keeps_the_newest_plans() {
    let domain = TempDomain::new("newest").unwrap();
    let node = domain.join("both").unwrap();
    let subscriber = node.subscriber::<PlanMessage>().unwrap();
    let publisher = node.publisher::<PlanMessage>().unwrap();
    for id in 1..=10 {
        publisher.publish(&plan(id)).unwrap();
    }
    let mut ids = Vec::new();
    while let Some(received) = subscriber.receive().unwrap() {
        ids.push(received.id);
    }
    assert_eq!(ids, [9, 10]);
}
