//! A cycle has the same bits on a CPU with wide registers and on one without: commands and records of a swing-up, up to the balance.

mod common;

use common::{Arm, at_rest, config, rest_pose, swing};
use upswing_ipc::Mode;
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};

#[test]
fn of_every_cycle_of_a_swing_up() {
    let config = config();
    let q = rest_pose(&config);
    let (plan, _) = swing(&config, &q);
    let (mut wide, mut arm) = (Controller::new(&config), Arm::new(&config, at_rest(&q)));
    let mut baseline = wide.clone();
    let requests =
        || [StepRequest::Enable, StepRequest::Load(plan.clone()), StepRequest::Start(plan.id)].into_iter();
    let (mut of_wide, mut of_baseline) = (requests(), requests());
    let mut cycles = 0;
    while wide.mode() != Mode::Balance {
        let measurement = arm.measure();
        let output = wide.step(StepInput::new(measurement, 0, of_wide.next()));
        let other = baseline.step_baseline(StepInput::new(measurement, 0, of_baseline.next()));
        // The text of a number is exact.
        assert_eq!(format!("{:?}", output.command), format!("{:?}", other.command), "cycle {cycles}");
        assert_eq!(format!("{:?}", output.record), format!("{:?}", other.record), "cycle {cycles}");
        arm.advance(&output.command);
        cycles += 1;
    }
    assert!(cycles > 10_000, "only {cycles} cycles");
}
