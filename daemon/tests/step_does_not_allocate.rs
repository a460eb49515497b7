//! A cycle of the controller neither allocates nor frees, in every mode.

mod common;

use allocation_counter::measure;
use common::{Arm, PERIOD_NS, at_rest, config, rest_plan, upright_pose};
use upswing_ipc::Mode;
use upswing_trajectory::Plan;
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};

#[test]
fn in_any_mode() {
    let config = config();
    let x = at_rest(&upright_pose());
    let mut arm = Arm::new(&config, x);
    let mut controller = Controller::new(&config);
    let mut plans = [rest_plan(&config, &x, 0.01), rest_plan(&config, &x, 0.01)].into_iter();
    // While the second one is tracked, a third one replaces it.
    let replacement = Plan {
        id: 9,
        activation_ns: Some(140 * PERIOD_NS),
        replaces: Some(7),
        ..*rest_plan(&config, &x, 0.01)
    };
    let mut replacement = Some(Box::new(replacement));
    let mut garbage = Vec::with_capacity(4);
    let mut seen = Vec::with_capacity(8);
    for k in 0..4000_u64 {
        let mut measurement = arm.measure();
        let request = match k {
            1 => Some(StepRequest::Start(7)),
            2 => Some(StepRequest::Enable),
            100 | 101 => plans.next().map(StepRequest::Load),
            102 => Some(StepRequest::Start(7)),
            120 => replacement.take().map(StepRequest::Load),
            400 => Some(StepRequest::Stop),
            _ => None,
        };
        if k == 3900 {
            measurement.q[0] = f64::NAN;
        }
        let mut output = None;
        let heap = measure(|| output = Some(controller.step(StepInput::new(measurement, 0, request))));
        assert_eq!((heap.count_total, heap.count_current), (0, 0), "cycle {k} in {}", controller.mode());
        let output = output.expect("it ran");
        if !seen.contains(&controller.mode()) {
            seen.push(controller.mode());
        }
        garbage.extend(output.retired.into_iter().flatten());
        arm.advance(&output.command);
    }
    let expected = [Mode::Idle, Mode::Hold, Mode::Track, Mode::Balance, Mode::Stop, Mode::Fault];
    assert_eq!(seen, expected);
    let ids: Vec<_> = garbage.iter().map(|plan| plan.id).collect();
    assert_eq!(ids, [7, 7, 9], "the plans that another one replaced, and that one after its end");
    let heap = measure(|| drop(garbage));
    assert!(heap.count_current < 0, "the counter counts");
}
