//! A plan that replaces the running one takes over at its activation, in the motion that there is, without a step in torque. Every other one is
//! dropped, and the running plan goes on.

mod common;

use common::{Arm, PERIOD_NS, at_rest, config, message, rest_pose, resting, swing};
use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};
use upswing_trajectory::{Plan, UnmetCriterion};
use upswingd::controller::Controller;
use upswingd::plan::{PlanRefusal, accept};
use upswingd::step::{StepInput, StepOutput, StepRequest};
use upswingd::supervisor::RequestRefusal;

/// An arm that tracks a plan with the id 7, at rest for a second.
struct Tracking {
    config: Config,
    controller: Controller,
    arm: Arm,
    seq: u64,
}

impl Tracking {
    fn new() -> Self {
        let config = config();
        let x = at_rest(&rest_pose(&config));
        let (controller, arm) = (Controller::new(&config), Arm::new(&config, x));
        let mut tracking = Self { config, controller, arm, seq: 0 };
        let plan = tracking.rest(0.0);
        tracking.cycle(None);
        tracking.cycle(Some(StepRequest::Enable));
        tracking.cycles(400);
        tracking.cycle(Some(StepRequest::Load(Box::new(plan))));
        assert_eq!(tracking.cycle(Some(StepRequest::Start(7))).answer, Some(Ok(())));
        tracking.cycles(100);
        tracking
    }

    /// A plan with the id 7 that stays for a second in the pose of the start, joint 1 `off` rad from it.
    fn rest(&self, off: f64) -> Plan {
        let mut q = rest_pose(&self.config);
        q[0] += off;
        resting(&self.config, &at_rest(&q), 1.0)
    }

    /// A plan with the id 9 that replaces plan 7 `cycles` cycles after the next one.
    fn replacement(&self, off: f64, cycles: u64) -> Plan {
        let activation_ns = Some((self.seq + 1 + cycles) * PERIOD_NS);
        Plan { id: 9, activation_ns, replaces: Some(7), ..self.rest(off) }
    }

    fn cycle(&mut self, request: Option<StepRequest>) -> StepOutput {
        let measurement = self.arm.measure();
        self.seq = measurement.seq;
        let output = self.controller.step(StepInput::new(measurement, 0, request));
        self.arm.advance(&output.command);
        output
    }

    fn load(&mut self, plan: Plan) -> StepOutput {
        self.cycle(Some(StepRequest::Load(Box::new(plan))))
    }

    fn cycles(&mut self, count: u64) {
        (0..count).for_each(|_| drop(self.cycle(None)));
    }
}

fn retired(output: &StepOutput) -> Vec<u64> {
    output.retired.iter().flatten().map(|plan| plan.id).collect()
}

#[test]
fn at_the_cycle_of_its_activation() {
    let mut tracking = Tracking::new();
    let plan = tracking.replacement(0.0, 5);
    assert_eq!(tracking.load(plan).answer, Some(Ok(())));
    for _ in 0..4 {
        assert_eq!(tracking.cycle(None).record.telemetry.plan_id, 7);
    }
    let output = tracking.cycle(None);
    let telemetry = output.record.telemetry;
    assert_eq!((telemetry.mode(), telemetry.plan_id, telemetry.t_plan), (Ok(Mode::Track), 9, 0.0));
    assert_eq!((output.record.dropped, retired(&output)), (None, vec![7]));
}

#[test]
fn without_a_step_in_torque() {
    let mut tracking = Tracking::new();
    let mut plan = tracking.replacement(0.04, 1);
    // Stiff enough for more torque than the limit of its rate allows in a cycle.
    plan.gains.as_mut_slice().iter_mut().for_each(|k| *k *= 20.0);
    let most = tracking.config.robot.limits.tau_max
        * (tracking.config.daemon.limits.torque_rate.warn * PERIOD_NS as f64 * 1e-9);
    let mut last = tracking.load(plan).command.tau;
    let mut fastest = 0.0_f64;
    for _ in 0..40 {
        let output = tracking.cycle(None);
        assert_eq!((tracking.controller.mode(), output.record.trip), (Mode::Track, None));
        for (i, most) in most.iter().enumerate() {
            let share = (output.command.tau[i] - last[i]).abs() / most;
            assert!(share <= 1.0 + 1e-9, "joint {}: {share} of the largest change", i + 1);
            fastest = fastest.max(share);
        }
        last = output.command.tau;
        if output.record.telemetry.plan_id == 9 && output.record.telemetry.flags & Telemetry::LIMITED == 0 {
            break;
        }
    }
    assert!(fastest > 0.99, "the limit acted: {fastest}");
}

#[test]
fn only_if_the_measured_state_is_its_own() {
    let mut tracking = Tracking::new();
    let plan = tracking.replacement(0.06, 2);
    assert_eq!(tracking.load(plan).answer, Some(Ok(())));
    tracking.cycle(None);
    let output = tracking.cycle(None);
    let dropped = output.record.dropped.expect("dropped");
    assert_eq!((dropped.id, output.record.telemetry.plan_id, retired(&output)), (9, 7, vec![9]));
    assert!(matches!(dropped.reason, RequestRefusal::StartMismatch { joint: 0, velocity: false, .. }));
    assert_eq!(tracking.cycle(None).record.dropped, None);
    assert_eq!(tracking.controller.mode(), Mode::Track);
}

#[test]
fn only_if_it_is_in_time() {
    let mut tracking = Tracking::new();
    let late = |ns| Plan { activation_ns: ns, ..tracking.replacement(0.0, 0) };
    let (now, never) = ((tracking.seq + 1) * PERIOD_NS, late(None));
    let plan = late(Some(now - 1));
    let output = tracking.load(plan);
    assert_eq!(output.answer, Some(Err(RequestRefusal::AfterActivation { late: 1e-9 })));
    assert_eq!((output.record.telemetry.plan_id, retired(&output)), (7, vec![9]));
    let output = tracking.load(never);
    assert!(matches!(output.answer, Some(Err(RequestRefusal::AfterActivation { .. }))));
    // In the cycle of its activation it is.
    let plan = tracking.replacement(0.0, 0);
    assert_eq!(tracking.load(plan).record.telemetry.plan_id, 9);
}

#[test]
fn only_if_the_plan_that_it_names_is_running() {
    let mut tracking = Tracking::new();
    let of_another = Plan { replaces: Some(8), ..tracking.replacement(0.0, 1) };
    let output = tracking.load(of_another);
    assert_eq!(output.answer, Some(Err(RequestRefusal::NotRunning { replaced: 8, running: 7 })));
    assert_eq!(retired(&output), [9]);
    // Two for the same one: the newer replaces the one that waits; a third one for a plan that is replaced by then is dropped.
    let (first, second) = (tracking.replacement(0.0, 3), tracking.replacement(0.0, 2));
    tracking.load(first);
    let output = tracking.load(Plan { id: 10, ..second });
    assert_eq!((output.answer, retired(&output)), (Some(Ok(())), vec![9]));
    tracking.cycle(None);
    assert_eq!(tracking.cycle(None).record.telemetry.plan_id, 10);
    let third = tracking.replacement(0.0, 1);
    let output = tracking.load(third);
    assert_eq!(output.answer, Some(Err(RequestRefusal::NotRunning { replaced: 7, running: 10 })));
}

#[test]
fn only_while_a_plan_is_tracked() {
    let mut tracking = Tracking::new();
    let plan = tracking.replacement(0.0, 3);
    tracking.load(plan);
    assert_eq!(retired(&tracking.cycle(Some(StepRequest::Stop))), [9]);
    let plan = tracking.replacement(0.0, 3);
    let output = tracking.load(plan);
    assert_eq!(output.answer, Some(Err(RequestRefusal::NotRunning { replaced: 7, running: 0 })));
    tracking.cycles(8000);
    assert_eq!(tracking.controller.mode(), Mode::Hold);
    // The plan that was started is there for the next start; one that replaced it would begin in the middle of a motion.
    assert_eq!(tracking.cycle(Some(StepRequest::Start(7))).answer, Some(Ok(())));
    let plan = tracking.replacement(0.0, 0);
    assert_eq!(tracking.load(plan).record.telemetry.plan_id, 9);
    let output = tracking.cycle(Some(StepRequest::Stop));
    assert_eq!(retired(&output), [9]);
    tracking.cycles(8000);
    assert_eq!(tracking.cycle(Some(StepRequest::Start(9))).answer, Some(Err(RequestRefusal::NoPlan)));
}

/// A disturbed motion may be faster than plans from rest may be, up to the rated limits.
#[test]
fn within_the_rated_limits() {
    let mut config = config();
    let (up, _) = swing(&config, &rest_pose(&config));
    config.robot.planning.qd_max *= 0.9;
    let refused = |plan: &Plan, config: &Config| accept(&message(plan), config).err();
    let too_fast = |refusal| matches!(refusal, Some(PlanRefusal::Criterion(UnmetCriterion::Limit { .. })));
    assert!(too_fast(refused(&up, &config)));
    let replacement = Plan { activation_ns: Some(1), replaces: Some(7), ..*up };
    assert_eq!(refused(&replacement, &config), None);
    config.robot.limits.qd_max *= 0.4;
    assert!(too_fast(refused(&replacement, &config)));
}
