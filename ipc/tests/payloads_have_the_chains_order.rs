//! Payloads have the joints in the chain's order, at most as many as a chain can have, and those of another chain are refused.

mod common;

use common::{chain, chains};
use upswing_ipc::{
    Command, CycleVectors, ManoeuvreRequest, Measurement, OtherChain, PlannerKind, PlannerRequest,
    PlantRequest, PlantResponse, Telemetry,
};
use upswing_model::{ActuatedVector, JointVector, MOST_JOINTS, State};

/// Values that differ from each other and from 0.
fn numbers() -> impl FnMut(usize) -> f64 {
    let mut last = 0.5;
    move |_| {
        last += 1.0;
        last
    }
}

#[test]
fn conversions_there_and_back_change_nothing() {
    for chain in chains() {
        let (order, sizes) = (chain.order(), chain.sizes());
        let mut number = numbers();
        let mut state = || State::from_fn(sizes, &mut number);
        let (x, x_d) = (state(), state());
        let mut actuated = || ActuatedVector::from_fn(sizes, &mut number);
        let (u_d, u, tau, tau_measured) = (actuated(), actuated(), actuated(), actuated());
        let vectors = CycleVectors { x, x_d, u_d, u, tau, tau_measured };

        assert_eq!(Measurement::new(order, &x.q(), &tau).vectors(order), Ok((x.q(), tau)));
        assert_eq!(Command::new(&tau).torque(sizes), Ok(tau));
        assert_eq!(Telemetry::new(order, &vectors).vectors(order), Ok(vectors));
        let manoeuvre = ManoeuvreRequest::new("move", &[0.5, f64::INFINITY]).unwrap();
        let request = PlannerRequest::from_state(manoeuvre, order, &x);
        assert_eq!((request.kind(), request.start(order)), (Ok(PlannerKind::Plan), Ok(x)));
        assert_eq!((request.manoeuvre, request.manoeuvre.given()), (manoeuvre, &[0.5, f64::INFINITY][..]));
        assert_eq!(PlantRequest::reset_state(order, &x).state(order), Ok(x));
        assert_eq!(PlantResponse::new(order, &x, &tau).vectors(order), Ok((x, tau)));
        let telemetry = Telemetry::new(order, &vectors);
        let words: Vec<u64> = telemetry.words().collect();
        assert_eq!(Telemetry::from_words(&words), Some(telemetry));
    }
}

#[test]
fn values_follow_the_joints_from_base_to_tip_and_then_there_are_zeros() {
    // q = [q_A, q_U]: the joints 2 and 4 of the chain, then 1, 3 and 5.
    let chain = chain(&[false, true, false, true, false]);
    let (order, sizes) = (chain.order(), chain.sizes());
    let q = JointVector::from_slice(sizes, &[2.0, 4.0, 1.0, 3.0, 5.0]).unwrap();
    let tau = ActuatedVector::from_slice(sizes, &[20.0, 40.0]).unwrap();
    let measurement = Measurement::new(order, &q, &tau);
    assert_eq!((measurement.joints, measurement.actuated), (5, 2));
    assert_eq!(measurement.q[..5], [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert_eq!(measurement.q[5..], [0.0; MOST_JOINTS - 5]);
    assert_eq!(measurement.tau_measured[..2], [20.0, 40.0]);
    assert_eq!(measurement.tau_measured[2..], [0.0; MOST_JOINTS - 2]);
    let x = State::new(&q, &(q * 10.0));
    assert_eq!(PlantRequest::reset_state(order, &x).qd[..5], [10.0, 20.0, 30.0, 40.0, 50.0]);
}

#[test]
fn readers_ignore_what_follows_the_joints() {
    let chain = chain(&[true, false, true]);
    let q = JointVector::repeat(chain.sizes(), 1.0);
    let tau = ActuatedVector::repeat(chain.sizes(), 2.0);
    let mut measurement = Measurement::new(chain.order(), &q, &tau);
    measurement.q[3..].fill(f64::NAN);
    measurement.tau_measured[2..].fill(f64::NAN);
    let read = measurement.vectors(chain.order()).unwrap();
    assert_eq!(read, (q, tau));
    assert!(read.0.padded()[3..].iter().chain(&read.1.padded()[2..]).all(|v| *v == 0.0));
}

#[test]
fn other_numbers_of_joints_are_refused() {
    let chain = chain(&[true, false, true]);
    let (order, expected) = (chain.order(), chain.sizes());
    for (joints, actuated) in [(0, 0), (3, 1), (2, 2), (4, 2), (2, 3), (u64::MAX, 2), (3, u64::MAX)] {
        let refusal = |payload| OtherChain { payload, joints, actuated, expected };
        let measurement = Measurement { joints, actuated, ..Measurement::default() };
        assert_eq!(measurement.vectors(order), Err(refusal("measurement")));
        let command = Command { joints, actuated, ..Command::default() };
        assert_eq!(command.torque(expected), Err(refusal("command")));
        let telemetry = Telemetry { joints, actuated, ..Telemetry::default() };
        assert_eq!(telemetry.vectors(order), Err(refusal("telemetry")));
        assert!(telemetry.of_joints(&telemetry.q).len() <= MOST_JOINTS);
        assert!(telemetry.of_actuated(&telemetry.u).len() <= MOST_JOINTS);
        let request = PlannerRequest { joints, actuated, ..PlannerRequest::default() };
        assert_eq!(request.start(order), Err(refusal("planner request")));
        let request = PlantRequest { joints, actuated, ..PlantRequest::default() };
        assert_eq!(request.state(order), Err(refusal("plant request")));
        let response = PlantResponse { joints, actuated, ..PlantResponse::default() };
        assert_eq!(response.vectors(order), Err(refusal("plant response")));
    }
    let text =
        Command { joints: 9, actuated: 7, ..Command::default() }.torque(expected).unwrap_err().to_string();
    assert!(text.starts_with("command of 9 joints, 7 of them actuated: expected 3 and 2"), "{text}");
}

#[test]
fn the_values_in_use_are_as_many_as_joints() {
    let chain = chain(&[true, false, true]);
    let x = State::from_fn(chain.sizes(), |i| i as f64);
    let tau = ActuatedVector::repeat(chain.sizes(), 2.0);
    let vectors = CycleVectors { x, x_d: x, u_d: tau, u: tau, tau, tau_measured: tau };
    let telemetry = Telemetry::new(chain.order(), &vectors);
    assert_eq!(telemetry.of_joints(&telemetry.q), [0.0, 2.0, 1.0]);
    assert_eq!(telemetry.of_actuated(&telemetry.tau), [2.0, 2.0]);
}
