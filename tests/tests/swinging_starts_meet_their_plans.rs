//! While the pendulum swings, a plan begins with the state predicted for its activation: on a running clock, across three
//! processes, the robot is in this state at the activation, and the swing-up ends balanced.

use std::time::{Duration, Instant};
use upswing_ipc::operator::{OperatorError, OperatorRequest};
use upswing_ipc::{Clock, Mode, PlanMessage, PlantRequest, Telemetry};
use upswing_model::{JointVector, State};
use upswing_rig::course::first_manoeuvre;
use upswing_rig::session::SessionError;
use upswing_tests::{START, System};

/// How far the pendulum swings, deg: joints 8 and 9.
const SWING: [f64; 2] = [22.0, -10.0];
/// Shares of the tolerances of a start that the prediction may take, angles and velocities: the filter shows velocities late,
/// and a prediction carries that on to the angles.
const SHARES: [f64; 2] = [0.6, 0.75];
/// Where planning takes long, the planner looks further ahead each time; somebody who is in no hurry asks again.
const PATIENCE: Duration = Duration::from_secs(60);

/// Largest distances of a state from the expected one, in units of the tolerances: angles, velocities.
fn distances(x: &State, expected: &State, (position, velocity): (JointVector, JointVector)) -> [f64; 2] {
    let dx = x - expected;
    [dx.q().component_div(&position).amax(), dx.qd().component_div(&velocity).amax()]
}

#[test]
fn on_a_clock_that_runs() {
    let mut system = System::start(Clock::Paced, START);
    let plans = system.session.node().subscriber::<PlanMessage>().expect("a subscriber");
    system.advance(1);
    let rest = system.session.plant_status().expect("a state");
    let order = *system.config.model.order();
    let (mut x, _) = rest.vectors(&order).expect("the joints of the robot");
    x.qd_mut().fill(0.0);
    for (q, by) in x.q_u_mut().iter_mut().zip(SWING) {
        *q += by.to_radians();
    }
    system.session.plant(&PlantRequest::reset_state(&order, &x)).expect("it is put there");
    // What was measured before the pendulum was moved by hand is of no use.
    let begin = Instant::now();
    loop {
        match system.session.request(OperatorRequest::Enable) {
            Ok(_) => break,
            Err(SessionError::Operator(OperatorError::Daemon { .. })) => {}
            Err(e) => panic!("{e}"),
        }
        assert!(begin.elapsed() < PATIENCE, "{}", system.status().reason);
        system.advance(8);
    }
    system.advance(2000);

    let begin = Instant::now();
    let response = loop {
        match system.session.start_manoeuvre(&first_manoeuvre(&system.config)) {
            Ok(response) => break response,
            Err(e) => assert!(begin.elapsed() < PATIENCE, "{e}"),
        }
    };
    assert!(response.activation_ns > 0, "the pendulum swings");
    let mut plan = None;
    while let Some(sample) = plans.receive().expect("plans") {
        plan = Some(sample).filter(|sample| sample.header().id == response.plan_id).or(plan);
    }
    let plan = plan.expect("the plan that was started").copied().expect("its numbers").plan(&order);
    let plan = plan.unwrap_or_else(|e| panic!("{e}"));
    let activation_ns = plan.activation_ns.expect("a time");
    assert_eq!(activation_ns, response.activation_ns);

    // Time is a multiple of the period: within one of them there is the cycle of the activation.
    let balanced = system.wait_until("balance", |record| record.mode() == Ok(Mode::Balance));
    let records = &system.session.records;
    let at = records.iter().find(|record| record.t_ns >= activation_ns).expect("the cycle of the activation");
    assert!(at.t_ns - activation_ns < 1_000_000, "{} records were lost", system.session.dropped());
    let tolerances = (system.config.daemon.start.position, system.config.daemon.start.velocity);
    let vectors = |record: &Telemetry| record.vectors(&order).expect("the joints of the robot");
    let predicted = distances(&vectors(at).x, plan.trajectory.start(), tolerances);
    println!("prediction off by {predicted:.4?} of the tolerances of a start");
    assert!(predicted[0] < SHARES[0] && predicted[1] < SHARES[1], "off by {predicted:.3?} of the tolerances");

    // The plan runs from its activation, not from its start.
    let first = records.iter().find(|record| record.plan_id == plan.id).expect("it was tracked");
    let since = (first.t_ns - activation_ns) as f64 * 1e-9;
    assert!((first.t_plan - since).abs() < 1e-6, "{} s instead of {since} s", first.t_plan);
    let first = vectors(first);
    assert!(distances(&first.x, &first.x_d, tolerances).iter().all(|d| *d <= 1.0));

    system.advance(16_000);
    let last = system.session.records.last().expect("a record");
    assert_eq!(last.mode(), Ok(Mode::Balance), "since cycle {}", balanced.seq);
    assert!(
        distances(&vectors(last).x, plan.trajectory.end(), tolerances).iter().all(|d| *d < 1.0),
        "{last:?}"
    );
    system.end();
}
