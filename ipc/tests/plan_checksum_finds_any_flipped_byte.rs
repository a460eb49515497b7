//! A plan that was damaged anywhere is recognized, and an undamaged one passes through shared memory.

mod common;

use common::{SIZES, plan, wait_for};
use proptest::prelude::*;
use upswing_ipc::{PlanHeader, PlanMessage, TempDomain};

/// Number of bytes of a plan.
const SIZE: usize = size_of::<PlanHeader>() + 8 * PlanMessage::length(SIZES.0, SIZES.1);

/// The plan whose bytes `spoil` has changed.
fn spoilt(plan: &PlanMessage, spoil: impl FnOnce(&mut [u8])) -> PlanMessage {
    let mut bytes: Vec<u8> = plan.words().flat_map(u64::to_ne_bytes).collect();
    assert_eq!(bytes.len(), SIZE);
    spoil(&mut bytes);
    let words: Vec<u64> = bytes.chunks_exact(8).map(|b| u64::from_ne_bytes(b.try_into().unwrap())).collect();
    PlanMessage::from_words(&words).unwrap()
}

#[test]
fn sealed_plans_are_intact_and_unsealed_ones_are_not() {
    let mut plan = plan(1);
    assert!(plan.is_intact());
    assert_eq!(plan.header.checksum, plan.checksum());
    plan.header.id += 1;
    assert!(!plan.is_intact());
    plan.seal();
    assert!(plan.is_intact());
    let nothing = PlanMessage { header: PlanHeader::default(), values: vec![0.0; plan.values.len()] };
    assert!(!nothing.is_intact(), "memory that nobody wrote is not a plan");
}

#[test]
fn a_flip_in_every_region_is_found() {
    let plan = plan(2);
    let edges = (0..64).chain(SIZE - 64..SIZE);
    // A step that is coprime to 8 meets every byte of a number.
    for at in edges.chain((0..SIZE).step_by(331)) {
        assert!(!spoilt(&plan, |bytes| bytes[at] ^= 1).is_intact(), "byte {at}");
    }
    assert!(spoilt(&plan, |_| ()).is_intact());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_flip_anywhere_is_found(at in 0..SIZE, mask in 1..=u8::MAX) {
        prop_assert!(!spoilt(&plan(3), |bytes| bytes[at] ^= mask).is_intact());
    }

    #[test]
    fn any_truncation_is_found(from in 0..SIZE) {
        prop_assert!(!spoilt(&plan(4), |bytes| bytes[from..].fill(0)).is_intact());
    }

    #[test]
    fn any_shift_is_found(from in 0..SIZE / 2, by in 1..1000_usize) {
        prop_assert!(!spoilt(&plan(5), |bytes| bytes.copy_within(from + by.., from)).is_intact());
    }
}

#[test]
fn plans_arrive_intact_also_late_and_from_a_restarted_planner() {
    let domain = TempDomain::new("plan").unwrap();
    let daemon = domain.join("daemon").unwrap();
    let early = daemon.subscriber::<PlanMessage>().unwrap();
    for id in 1..=3 {
        let planner = domain.join("planner").unwrap();
        let publisher = planner.plan_publisher(SIZES.0, SIZES.1).unwrap();
        publisher.publish(&plan(id)).unwrap();
        let received = wait_for("the plan", || early.receive().unwrap());
        assert_eq!(received.copied().unwrap(), plan(id));
        assert_eq!(received.header().id, id);

        let late = daemon.subscriber::<PlanMessage>().unwrap();
        assert!(late.receive().unwrap().is_none());
        publisher.deliver_history().unwrap();
        let received = wait_for("the history", || late.receive().unwrap());
        assert_eq!(received.copied().unwrap(), plan(id));
    }
}

#[test]
fn a_slow_subscriber_keeps_the_newest_plans() {
    let domain = TempDomain::new("newest").unwrap();
    let node = domain.join("both").unwrap();
    let subscriber = node.subscriber::<PlanMessage>().unwrap();
    let publisher = node.plan_publisher(SIZES.0, SIZES.1).unwrap();
    for id in 1..=10 {
        publisher.publish(&plan(id)).unwrap();
    }
    let mut ids = Vec::new();
    while let Some(received) = subscriber.receive().unwrap() {
        ids.push(received.header().id);
    }
    assert_eq!(ids, [9, 10]);
}
