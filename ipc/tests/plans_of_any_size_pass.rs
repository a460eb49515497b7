//! Plans of any chain and any number of intervals pass through shared memory and files; lengths that do not fit are refused.

mod common;

use common::{SIZES, chain, chains, plan};
use upswing_ipc::{DamagedPlan, IpcError, OtherChain, PlanMessage, TempDomain};
use upswing_model::{ActuatedVector, Sizes, State};
use upswing_trajectory::{Gains, INTERVALS, Plan, Trajectory};

/// A plan whose numbers all differ.
fn plan_of(sizes: Sizes, intervals: usize) -> Plan {
    let mut last = 0.0;
    let mut number = || {
        last += 1.0;
        last
    };
    let knots = intervals + 1;
    let x = (0..knots).map(|_| State::from_fn(sizes, |_| number())).collect();
    let u = (0..knots).map(|_| ActuatedVector::from_fn(sizes, |_| number())).collect();
    let f = (0..knots).map(|_| State::from_fn(sizes, |_| number())).collect();
    let gains = (0..Gains::entries(sizes, intervals)).map(|_| number()).collect();
    Plan {
        id: 5,
        fingerprint: 6,
        activation_ns: Some(7),
        replaces: Some(5),
        trajectory: Trajectory { t_f: 2.0, x, u },
        f,
        gains: Gains::from_slab(sizes, intervals, gains).unwrap(),
    }
}

#[test]
fn a_plan_is_the_same_after_it_has_passed() {
    let domain = TempDomain::new("pass").unwrap();
    let node = domain.join("both").unwrap();
    let subscriber = node.subscriber::<PlanMessage>().unwrap();
    for (chain, intervals) in chains().into_iter().zip([20, 100, 37].into_iter().cycle()) {
        let plan = plan_of(chain.sizes(), intervals);
        let message = PlanMessage::new(&plan, chain.order());
        let publisher = node.plan_publisher(chain.sizes(), intervals).unwrap();
        publisher.publish(&message).unwrap();
        let received = subscriber.receive().unwrap().unwrap().copied().unwrap();
        assert_eq!(received.plan(chain.order()), Ok(plan));
        let words: Vec<u64> = received.words().collect();
        assert_eq!(PlanMessage::from_words(&words), Some(message));
    }
}

#[test]
fn rows_over_the_state_have_the_chains_order() {
    // q = [q_A, q_U]: the joint 2 of the chain, then 1.
    let chain = chain(&[false, true]);
    let plan = plan_of(chain.sizes(), 20);
    let message = PlanMessage::new(&plan, chain.order());
    assert_eq!(message.values[..4], [2.0, 1.0, 4.0, 3.0], "x_0");
    let first = 21 * (4 + 1 + 4);
    let row = plan.gains.knot(0).as_slice();
    assert_eq!(message.values[first..first + 4], [row[1], row[0], row[3], row[2]], "K_0");
}

#[test]
fn the_largest_plan_passes_and_a_larger_one_than_announced_does_not() {
    let domain = TempDomain::new("large").unwrap();
    let node = domain.join("both").unwrap();
    let chain = chains().into_iter().find(|chain| chain.sizes() == Sizes::new(16, 15).unwrap()).unwrap();
    let subscriber = node.subscriber::<PlanMessage>().unwrap();
    let most = *INTERVALS.end();
    let plan = plan_of(chain.sizes(), most);
    let message = PlanMessage::new(&plan, chain.order());
    {
        let publisher = node.plan_publisher(chain.sizes(), most - 1).unwrap();
        let error = publisher.publish(&message).unwrap_err();
        assert!(matches!(error, IpcError::Send { service: "plan", .. }), "{error}");
        assert!(subscriber.receive().unwrap().is_none());
        let shorter = PlanMessage::new(&plan_of(chain.sizes(), 20), chain.order());
        publisher.publish(&shorter).unwrap();
        assert_eq!(subscriber.receive().unwrap().unwrap().copied(), Ok(shorter));
    }
    let publisher = node.plan_publisher(chain.sizes(), most).unwrap();
    publisher.publish(&message).unwrap();
    assert_eq!(subscriber.receive().unwrap().unwrap().copied(), Ok(message));
}

#[test]
fn a_header_that_does_not_fit_is_refused_before_the_numbers_are_read() {
    let domain = TempDomain::new("lies").unwrap();
    let node = domain.join("both").unwrap();
    let publisher = node.plan_publisher(SIZES.0, 2 * SIZES.1).unwrap();
    let subscriber = node.subscriber::<PlanMessage>().unwrap();
    let refusal = |spoil: &dyn Fn(&mut PlanMessage)| {
        let mut message = plan(1);
        spoil(&mut message);
        message.seal();
        publisher.publish(&message).unwrap();
        let sample = subscriber.receive().unwrap().unwrap();
        assert_eq!(sample.header(), message.header);
        let refusal = sample.copied().unwrap_err();
        assert_eq!(message.plan(chain(&[true, false, true]).order()), Err(refusal), "in a file, too");
        refusal
    };
    let length = plan(1).values.len();
    let longer = PlanMessage::length(SIZES.0, SIZES.1 + 1);
    let expect = |expected, got| DamagedPlan::Length { expected, got };
    assert_eq!(refusal(&|p| p.header.intervals += 1), expect(longer, length));
    assert_eq!(refusal(&|p| p.values.truncate(length - 1)), expect(length, length - 1));
    assert_eq!(refusal(&|p| p.values.push(0.0)), expect(length, length + 1));
    assert_eq!(refusal(&|p| p.values.clear()), expect(length, 0));
    for (joints, actuated, intervals) in [
        (3, 2, 19),
        (3, 2, 1001),
        (3, 2, u64::MAX),
        (17, 2, 25),
        (3, 3, 25),
        (3, 0, 25),
        (0, 0, 25),
        (u64::MAX, u64::MAX - 1, 25),
        (256 + 3, 256 + 2, 25),
    ] {
        let lie = |p: &mut PlanMessage| {
            (p.header.joints, p.header.actuated, p.header.intervals) = (joints, actuated, intervals);
        };
        assert_eq!(refusal(&lie), DamagedPlan::Sizes { joints, actuated, intervals });
    }
}

#[test]
fn a_plan_for_another_chain_or_without_an_id_is_refused() {
    let message = plan(3);
    let four = chain(&[true, false, true, true]);
    let other = OtherChain { payload: "plan", joints: 3, actuated: 2, expected: four.sizes() };
    assert_eq!(message.plan(four.order()), Err(DamagedPlan::Chain(other)));
    let three = chain(&[true, false, true]);
    assert!(message.plan(three.order()).is_ok());
    let mut nameless = message.clone();
    nameless.header.id = 0;
    assert!(matches!(nameless.plan(three.order()), Err(DamagedPlan::Checksum { .. })));
    nameless.seal();
    assert_eq!(nameless.plan(three.order()), Err(DamagedPlan::Id));
    assert_eq!(PlanMessage::from_words(&message.words().take(7).collect::<Vec<_>>()), None);
    let short: Vec<u64> = message.words().take(20).collect();
    let short = PlanMessage::from_words(&short).unwrap();
    assert!(matches!(short.plan(three.order()), Err(DamagedPlan::Length { .. })));
}
