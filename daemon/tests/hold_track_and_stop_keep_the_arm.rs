//! Hold, Track and Stop in closed loop with a simulated arm.

mod common;

use common::{Arm, at_rest, config, rest_plan, rest_pose, swing, upright_pose};
use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::{ActuatedVector, JointVector, State};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};
use upswingd::supervisor::is_braked;

/// One second.
const SECOND: usize = 8000;

struct Loop {
    arm: Arm,
    controller: Controller,
}

impl Loop {
    fn cycle(&mut self, request: Option<StepRequest>) -> Telemetry {
        let output = self.controller.step(StepInput::new(self.arm.measure(), 0, request));
        assert!(output.answer.is_none_or(|answer| answer.is_ok()), "{:?}", output.answer);
        self.arm.advance(&output.command);
        output.record.telemetry
    }

    fn ask(&mut self, request: StepRequest) -> Telemetry {
        self.cycle(Some(request))
    }
}

fn enabled() -> (Loop, State) {
    enabled_at(&rest_pose(&config()))
}

fn enabled_at(q: &JointVector) -> (Loop, State) {
    enabled_with(&config(), q)
}

fn enabled_with(config: &Config, q: &JointVector) -> (Loop, State) {
    let x = at_rest(q);
    let mut system = Loop { arm: Arm::new(config, x), controller: Controller::new(config) };
    assert_eq!(system.ask(StepRequest::Enable).mode, Mode::Hold.code());
    (system, x)
}

#[test]
fn hold_keeps_the_pose() {
    let (mut system, x) = enabled();
    for _ in 0..SECOND {
        let record = system.cycle(None);
        assert_eq!(record.mode, Mode::Hold.code());
        assert!((system.arm.x.q() - x.q()).amax() < 1e-3);
    }
}

#[test]
fn hold_returns_after_a_push() {
    let (mut system, x) = enabled();
    system.arm.x.qd_a_mut().fill(0.1);
    (0..SECOND).for_each(|_| {
        system.cycle(None);
    });
    let off = (system.arm.x - x).q_a().amax();
    assert!(off < 5e-3, "{off} rad off");
}

#[test]
fn a_plan_that_stands_is_tracked_and_then_balanced() {
    let (mut system, x) = enabled_at(&upright_pose());
    let config = config();
    system.cycle(Some(StepRequest::Load(rest_plan(&config, &x, 0.05))));
    let first = system.ask(StepRequest::Start(7));
    assert_eq!((first.mode, first.plan_id, first.t_plan), (Mode::Track.code(), 7, 0.0));
    for k in 1..800 {
        let record = system.cycle(None);
        let t = k as f64 * common::PERIOD;
        let expected = if t < 0.05 - 1e-9 { Mode::Track } else { Mode::Balance };
        assert_eq!((record.mode, record.plan_id), (expected.code(), 7), "cycle {k}");
        assert!((record.t_plan - t).abs() < 1e-9);
        assert!((system.arm.x.q() - x.q()).amax() < 1e-3);
    }
    let held = system.ask(StepRequest::Hold);
    assert_eq!((held.mode, held.plan_id), (Mode::Hold.code(), 0));
    assert_eq!(system.ask(StepRequest::Start(7)).plan_id, 7, "the plan is still loaded");
}

#[test]
fn stop_decelerates_as_set_and_then_holds() {
    let mut config = config();
    // The arm gets its speed out of nowhere: a blow, which the estimate of disturbances would answer.
    config.daemon.disturbance.bandwidth = 0.0;
    let (mut system, _) = enabled_with(&config, &rest_pose(&config));
    system.arm.x.qd_a_mut().fill(0.5);
    // The filter needs some T_1 to see the velocity.
    let mut record = system.ask(StepRequest::Hold);
    for _ in 0..200 {
        record = system.ask(StepRequest::Hold);
    }
    assert!(record.qd[0] > 0.3, "{}", record.qd[0]);
    let mut cycles = 0;
    record = system.ask(StepRequest::Stop);
    while record.mode == Mode::Stop.code() {
        assert!(record.u_d.iter().all(|u_d| u_d.abs() <= 6.0));
        cycles += 1;
        assert!(cycles < 2 * SECOND, "still {:?}", record.qd);
        record = system.cycle(None);
    }
    assert_eq!(record.mode, Mode::Hold.code(), "{:?}", system.controller.trip());
    assert!(system.arm.x.qd_a().amax() < 0.02);
}

#[test]
fn shutdown_comes_to_rest_before_the_brakes_close() {
    let (mut system, _) = enabled();
    system.arm.x.qd_a_mut()[0] = 0.3;
    (0..100).for_each(|_| {
        system.cycle(None);
    });
    system.ask(StepRequest::Shutdown);
    assert!(!is_braked(system.controller.mode()));
    let mut cycles = 0;
    while !is_braked(system.controller.mode()) {
        system.cycle(None);
        cycles += 1;
        assert!(cycles < 2 * SECOND);
    }
    assert_eq!(system.controller.mode(), Mode::Idle);
    assert!(system.arm.x.qd_a().amax() < 0.02);
    let output = system.controller.step(StepInput::new(system.arm.measure(), 0, Some(StepRequest::Enable)));
    assert!(output.answer.unwrap().is_err(), "nothing starts any more");
}

#[test]
fn a_pendulum_that_turned_over_hangs_at_zero_again() {
    let config = config();
    let q = rest_pose(&config);
    let mut controller = Controller::new(&config);
    controller.step(StepInput::new(common::measurement(1, &q), 0, Some(StepRequest::Enable)));
    let (mut turning, turn) = (q, std::f64::consts::TAU);
    let mut seq = 1;
    // A turn and a half, at 10 rad/s.
    while turning[7] < q[7] + 1.5 * turn {
        turning[7] += 10.0 * common::PERIOD;
        seq += 1;
        let output = controller.step(StepInput::new(common::measurement(seq, &turning), 0, None));
        assert_eq!(output.record.telemetry.mode, Mode::Hold.code(), "{:?}", controller.trip());
        let shown = output.record.telemetry.q[7];
        assert!(shown.abs() < 0.5 * turn + 0.51, "{shown}");
        assert!(((turning[7] - shown) / turn).fract().abs() < 1e-9, "only whole turns go");
        let speed = output.record.telemetry.qd[7];
        assert!(seq < 1000 || (speed - 10.0).abs() < 0.2, "{speed} rad/s");
    }
    // Plans count the turns as the controller does.
    turning[7] = q[7] + turn;
    (1..2000).for_each(|_| {
        seq += 1;
        controller.step(StepInput::new(common::measurement(seq, &turning), 0, None));
    });
    for request in
        [StepRequest::Reset, StepRequest::Enable, StepRequest::Load(rest_plan(&config, &at_rest(&q), 1.0))]
    {
        seq += 1;
        let _ = controller.step(StepInput::new(common::measurement(seq, &turning), 0, Some(request))).answer;
    }
    seq += 1;
    let output =
        controller.step(StepInput::new(common::measurement(seq, &turning), 0, Some(StepRequest::Start(7))));
    assert_eq!((output.answer, controller.mode()), (Some(Ok(())), Mode::Track));
}

#[test]
fn known_friction_is_added_at_the_speed_of_the_reference() {
    let ideal = config();
    let mut with_friction = ideal.clone();
    with_friction.robot.friction.viscous.fill(0.2);
    with_friction.robot.friction.coulomb.copy_from_slice(&[0.3, 0.2, 0.1, 0.2, 0.03, 0.1, 0.1]);
    let q = rest_pose(&ideal);
    let (plan, _) = swing(&ideal, &q);
    let mut arm = Arm::new(&ideal, at_rest(&q));
    let mut controllers = [Controller::new(&ideal), Controller::new(&with_friction)];
    let (mut tracked, mut largest) = (0, 0.0_f64);
    for cycle in 0..3 * SECOND {
        let measurement = arm.measure();
        // Both see the arm that the first one moves.
        let [(free, command), (known, _)] = controllers.each_mut().map(|controller| {
            let request = match cycle {
                0 => Some(StepRequest::Enable),
                1 => Some(StepRequest::Load(plan.clone())),
                2 => Some(StepRequest::Start(plan.id)),
                _ => None,
            };
            let output = controller.step(StepInput::new(measurement, 0, request));
            (output.record.telemetry, output.command)
        });
        arm.advance(&command);
        assert_eq!((free.mode, free.qd_d), (known.mode, known.qd_d), "cycle {cycle}");
        let mode = free.mode();
        let [free_vectors, known] = [free, known].map(|record| record.vectors(ideal.model.order()).unwrap());
        let expected = with_friction.robot.friction.torque(&free_vectors.x_d.qd_a());
        let added: ActuatedVector = known.tau - free_vectors.tau;
        if (mode == Ok(Mode::Track) && free.t_plan > 0.01) || mode == Ok(Mode::Balance) {
            assert!((added - expected).amax() < 1e-9, "cycle {cycle}: {added:?} instead of {expected:?}");
            tracked += 1;
            largest = largest.max(expected.amax());
        }
    }
    assert!(tracked > 2 * SECOND && largest > 0.3, "{tracked} cycles, at most {largest} N m");
}
