//! A stop at any moment of a swing-up or swing-down brings the arm to rest within its limits, and no detector fires.

mod common;

use common::{Arm, at_rest, config, rest_pose, swing};
use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::State;
use upswing_trajectory::Plan;
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};

/// Cycles between two stops: 25 ms.
const STEP: usize = 200;
/// Longest stop, cycles: 1.5 s.
const LONGEST: usize = 12_000;
/// In so many cycles at most the torque gets from that of the plan to that of the stop: 2 ms.
const BEGINNING: usize = 16;

fn start(config: &Config, plan: &Plan, q: State) -> (Controller, Arm) {
    let (mut controller, mut arm) = (Controller::new(config), Arm::new(config, q));
    for request in
        [StepRequest::Enable, StepRequest::Load(Box::new(plan.clone())), StepRequest::Start(plan.id)]
    {
        let output = controller.step(StepInput::new(arm.measure(), 0, Some(request)));
        assert_eq!(output.answer, Some(Ok(())));
        arm.advance(&output.command);
    }
    (controller, arm)
}

fn stop(config: &Config, mut controller: Controller, mut arm: Arm, at: usize) {
    let limits = &config.robot.limits;
    let fastest = arm.x.qd_a().abs();
    let mut request = Some(StepRequest::Stop);
    for cycle in 0..LONGEST {
        let output = controller.step(StepInput::new(arm.measure(), 0, request.take()));
        arm.advance(&output.command);
        let (mode, flags) = (controller.mode(), output.record.telemetry.flags);
        assert!(
            matches!(mode, Mode::Stop | Mode::Hold),
            "stop at cycle {at}: {mode}, {:?}",
            controller.trip()
        );
        let limited = flags & Telemetry::LIMITED != 0;
        assert!(cycle < BEGINNING || !limited, "stop at cycle {at}: {:?}", output.command.tau);
        for (i, (q, qd)) in arm.x.q_a().iter().copied().zip(arm.x.qd_a().iter().copied()).enumerate() {
            assert!((limits.q_min[i]..=limits.q_max[i]).contains(&q), "cycle {at}: joint {} at {q}", i + 1);
            // No faster than when it began, but for the two milliseconds in which the torque of the plan fades.
            assert!(qd.abs() <= fastest[i] + 0.1, "cycle {at}: joint {} at {qd} rad/s", i + 1);
        }
        if mode == Mode::Hold {
            return;
        }
    }
    panic!("stop at cycle {at}: still moves after {LONGEST} cycles: {:?}", arm.x.qd_a());
}

#[test]
fn of_a_swing_up_and_of_a_swing_down() {
    let config = config();
    let q = rest_pose(&config);
    let (up, down) = swing(&config, &q);
    let top = *up.trajectory.end();
    for (plan, x_0) in [(up, at_rest(&q)), (down, top)] {
        let (mut controller, mut arm) = start(&config, &plan, x_0);
        let cycles = (plan.trajectory.t_f / common::PERIOD) as usize;
        for at in 0..cycles {
            if at % STEP == 0 {
                stop(&config, controller.clone(), arm.clone(), at);
            }
            let output = controller.step(StepInput::new(arm.measure(), 0, None));
            assert_eq!(controller.mode(), Mode::Track);
            arm.advance(&output.command);
        }
    }
}
