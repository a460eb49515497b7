//! A plan that ends upright leads to Balance, one that ends hanging to Hold; each may start at the end of the other.

mod common;

use common::{Arm, PERIOD, at_rest, config, rest_pose, swing};
use upswing_ipc::{Mode, Telemetry};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};
use upswingd::supervisor::RequestRefusal;

/// Largest angle from the plan at its end, rad: the velocity filter lags.
const CLOSE: f64 = 0.05;

struct Loop {
    arm: Arm,
    controller: Controller,
}

impl Loop {
    fn cycle(&mut self, request: Option<StepRequest>) -> (Telemetry, Option<Result<(), RequestRefusal>>) {
        let output = self.controller.step(StepInput::new(self.arm.measure(), 0, request));
        self.arm.advance(&output.command);
        (output.record.telemetry, output.answer)
    }

    fn ask(&mut self, request: StepRequest) {
        assert_eq!(self.cycle(Some(request)).1, Some(Ok(())));
    }

    fn run(&mut self, seconds: f64) {
        (0..(seconds / PERIOD) as usize).for_each(|_| {
            self.cycle(None);
        });
    }
}

#[test]
fn up_down_and_up_again() {
    let config = config();
    let q = rest_pose(&config);
    let (up, down) = swing(&config, &q);
    let mut system = Loop { arm: Arm::new(&config, at_rest(&q)), controller: Controller::new(&config) };
    system.ask(StepRequest::Enable);

    system.ask(StepRequest::Load(up.clone()));
    system.ask(StepRequest::Start(up.id));
    system.run(up.trajectory.t_f + 1.0);
    assert_eq!(system.controller.mode(), Mode::Balance);

    // The same plan again starts elsewhere, and is refused without a change.
    system.ask(StepRequest::Load(up.clone()));
    let (record, answer) = system.cycle(Some(StepRequest::Start(up.id)));
    assert!(matches!(answer, Some(Err(RequestRefusal::StartMismatch { .. }))), "{answer:?}");
    assert_eq!((record.mode, record.plan_id), (Mode::Balance.code(), up.id));

    system.ask(StepRequest::Load(down.clone()));
    system.ask(StepRequest::Start(down.id));
    assert_eq!(system.controller.mode(), Mode::Track);
    system.run(down.trajectory.t_f + 0.2);
    assert_eq!(system.controller.mode(), Mode::Hold);
    let off = system.arm.x.q() - q;
    assert!(off.amax() < CLOSE, "{off:?}");

    // Held is the end of the plan, not where the arm happened to be.
    let (record, _) = system.cycle(None);
    let record = record.vectors(config.model.order()).unwrap();
    assert_eq!(record.x_d.q_a(), down.trajectory.end().q_a());

    system.run(1.0);
    system.ask(StepRequest::Load(up.clone()));
    system.ask(StepRequest::Start(up.id));
    system.run(up.trajectory.t_f + 0.5);
    assert_eq!(system.controller.mode(), Mode::Balance);
}
