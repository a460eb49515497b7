//! For any input the torque is finite and within the limits, the brakes are closed exactly in Idle and Fault, and Fault is
//! left only by a reset.

mod common;

use common::{at_rest, config, measurement, rest_plan, rest_pose, sizes};
use proptest::prelude::*;
use upswing_ipc::{Measurement, Mode};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};
use upswingd::supervisor::is_braked;

#[derive(Clone, Debug)]
enum Disturbance {
    None,
    Angle(usize, f64),
    Status(u64),
    Clock(u64),
    Period(u64),
    Seq(u64),
    Repeat,
    Lost,
    Restart,
    Late(u64),
    Torque(usize, f64),
}

fn disturbances() -> impl Strategy<Value = Disturbance> {
    prop_oneof![
        30 => Just(Disturbance::None),
        4 => (0..sizes().joints(), prop_oneof![any::<f64>(), -0.01..0.01, -3.0..3.0]).prop_map(|(i, v)| Disturbance::Angle(i, v)),
        1 => any::<u64>().prop_map(Disturbance::Status),
        1 => (0_u64..5).prop_map(Disturbance::Clock),
        1 => any::<u64>().prop_map(Disturbance::Period),
        1 => any::<u64>().prop_map(Disturbance::Seq),
        4 => Just(Disturbance::Repeat),
        1 => Just(Disturbance::Lost),
        1 => Just(Disturbance::Restart),
        1 => (0_u64..40).prop_map(Disturbance::Late),
        1 => (0..sizes().actuated(), any::<f64>()).prop_map(|(i, v)| Disturbance::Torque(i, v)),
    ]
}

#[derive(Clone, Debug)]
enum Told {
    Load,
    Do(StepRequest),
}

fn told() -> impl Strategy<Value = Option<Told>> {
    use StepRequest::{Enable, Hold, Reset, Shutdown, Start, Stop};
    let any = [Enable, Hold, Stop, Reset, Start(7)].map(Told::Do).into_iter().chain([Told::Load]);
    prop_oneof![
        40 => Just(None),
        16 => Just(Some(Told::Do(Enable))),
        16 => Just(Some(Told::Do(Start(7)))),
        24 => prop::sample::select(any.collect::<Vec<_>>()).prop_map(Some),
        // Rarely, because nothing happens after it.
        1 => Just(Some(Told::Do(Shutdown))),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn and_faults_stay(steps in prop::collection::vec((disturbances(), told(), prop_oneof![4 => 1_u64..20, 1 => 20_u64..4000]), 1..60)) {
        let config = config();
        let tau_max = config.robot.limits.tau_max;
        let mut controller = Controller::new(&config);
        let mut q = rest_pose(&config);
        let plan = rest_plan(&config, &at_rest(&q), 1.0);
        let mut last = Measurement::default();
        let (mut seq, mut late_cycles) = (0_u64, 0);
        for (disturbance, told, cycles) in steps {
            seq = seq.saturating_add(cycles);
            let mut next = measurement(seq, &q);
            let (mut lost_cycles, mut restarted) = (0, false);
            match disturbance {
                Disturbance::None => {}
                Disturbance::Angle(i, v) => {
                    if v.abs() < 0.01 { q[i] += v } else { next.q[i] = v }
                }
                Disturbance::Status(status) => next.status = status,
                Disturbance::Clock(clock) => next.clock = clock,
                Disturbance::Period(period) => next.period_ns = period,
                Disturbance::Seq(other) => { seq = other; next.seq = other }
                Disturbance::Repeat => next = last,
                Disturbance::Lost => lost_cycles = 20,
                Disturbance::Restart => restarted = true,
                Disturbance::Late(cycles) => late_cycles = cycles,
                Disturbance::Torque(i, v) => next.tau_measured[i] = v,
            }
            last = next;
            let request = told.map(|told| match told {
                Told::Load => StepRequest::Load(plan.clone()),
                Told::Do(request) => request,
            });
            let reset = matches!(request, Some(StepRequest::Reset));
            let before = controller.mode();
            let input = StepInput::new(next, next.t_ns, request);
            let output = controller.step(StepInput { late_cycles, lost_cycles, restarted, ..input });
            let mode = controller.mode();
            for i in 0..tau_max.len() {
                let tau = output.command.tau[i];
                prop_assert!(tau.is_finite() && tau.abs() <= tau_max[i], "tau {tau} in {mode}");
            }
            prop_assert_eq!(output.command.brake == 1, is_braked(mode));
            prop_assert!(output.command.brake == 0 || output.command.tau.iter().all(|tau| *tau == 0.0));
            prop_assert_eq!(output.record.telemetry.mode, mode.code());
            prop_assert_eq!(output.record.telemetry.fault != 0, mode == Mode::Fault);
            if before == Mode::Fault && mode != Mode::Fault {
                prop_assert!(reset && mode == Mode::Idle);
            }
        }
    }
}
