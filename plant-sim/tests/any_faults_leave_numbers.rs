//! For any faults, pushes and commands the state stays finite, torques stay within their limits, and a repeated run gives
//! the same result.

mod common;

use common::{settings, sizes, torque};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::Command;
use upswing_model::ActuatedVector;
use upswing_plant::Plant;

#[derive(Clone, Debug)]
enum Event {
    Cycles(u8, Option<Command>),
    Fault(Fault),
    Clear,
    Push(Push),
    Reset,
}

fn command() -> impl Strategy<Value = Option<Command>> {
    let number = prop_oneof![8 => -400.0..400.0, 1 => Just(f64::NAN), 1 => any::<f64>()];
    // A command in five is for another chain.
    let command = (prop::collection::vec(number, sizes().actuated()), 0_u64..3, 0_u64..5).prop_map(
        |(tau, brake, other)| Command {
            brake: brake / 2,
            joints: 9 + u64::from(other == 0),
            ..torque(&ActuatedVector::from_slice(sizes(), &tau).unwrap())
        },
    );
    prop::option::weighted(0.9, command)
}

fn event() -> impl Strategy<Value = Event> {
    let amount = prop_oneof![Just(0.0), (0_u8..80).prop_map(f64::from), any::<f64>()];
    let fault = (0..FaultKind::all().len(), 0_u64..400, any::<u64>(), 0_usize..11, amount);
    let impulse = prop::array::uniform3(prop_oneof![4 => -1.0..1.0, 1 => any::<f64>()]);
    prop_oneof![
        4 => (any::<u8>(), command()).prop_map(|(n, command)| Event::Cycles(n, command)),
        2 => fault.prop_map(|(kind, from, cycles, joint, amount)| {
            Event::Fault(Fault { kind: FaultKind::all()[kind], from, cycles: cycles % 100, joint, amount })
        }),
        1 => Just(Event::Clear),
        1 => (0_u64..400, 0_u64..50, impulse)
            .prop_map(|(from, cycles, impulse)| Event::Push(Push { from, cycles, impulse })),
        1 => Just(Event::Reset),
    ]
}

/// Measurements and states of all cycles as bit patterns.
fn run(scenario: &str, events: &[Event]) -> Vec<u64> {
    let mut config = settings();
    config.use_scenario(scenario).unwrap();
    let limits = config.robot.limits;
    let mut plant = Plant::new(&config).unwrap();
    let start = (*plant.position(), *plant.velocity());
    let mut seen = Vec::new();
    for event in events {
        match event {
            Event::Cycles(n, command) => {
                for _ in 0..*n {
                    plant.step(command.as_ref());
                    let measured = plant.measure();
                    let state = || plant.position().iter().chain(plant.velocity().iter());
                    assert!(state().all(|v| v.is_finite()));
                    assert!(measured.seq <= plant.seq(), "nothing is measured before its time");
                    for i in 0..sizes().actuated() {
                        assert!(measured.tau_measured[i].abs() <= limits.tau_max[i]);
                    }
                    seen.extend(state().chain(&measured.q).map(|v| v.to_bits()));
                    seen.extend([measured.seq, measured.t_ns, measured.status]);
                }
            }
            // The plant may refuse an event.
            Event::Fault(fault) => _ = plant.set_fault(fault),
            Event::Clear => plant.clear_faults(),
            Event::Push(push) => _ = plant.push(push),
            Event::Reset => _ = plant.reset(&start.0, &start.1),
        }
    }
    seen
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn in_any_order(
        events in prop::collection::vec(event(), 1..20),
        scenario in prop::sample::select(vec!["everyday", "joint-stops", "late-brakes", "torque-offset"]),
    ) {
        prop_assert_eq!(run(scenario, &events), run(scenario, &events));
    }
}
