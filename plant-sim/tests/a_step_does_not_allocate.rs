//! The measurement and the step of the plant never allocate.

mod common;

use allocation_counter::measure;
use common::{brake, equal_torques, settings};
use upswing_config::{Fault, FaultKind, Push};
use upswing_plant::Plant;

#[test]
fn no_kind_of_cycle_uses_the_heap() {
    let mut config = settings();
    config.use_scenario("everyday").unwrap();
    config
        .plant
        .faults
        .extend(FaultKind::all().iter().map(|kind| Fault { amount: 3.0, ..Fault::new(*kind, 10, 40) }));
    config.plant.pushes.push(Push { from: 5, cycles: 50, impulse: [0.01; 3] });
    let mut plant = Plant::new(&config).unwrap();
    let (q, qd) = (*plant.position(), *plant.velocity());
    let commands = [
        Some(equal_torques(1.0)),
        Some(equal_torques(1e3)),
        None,
        Some(equal_torques(f64::NAN)),
        Some(brake()),
    ];
    let heap = measure(|| {
        for command in commands.iter().cycle().take(100) {
            plant.step(command.as_ref());
            std::hint::black_box(plant.measure());
        }
        assert!(plant.reset(&q, &qd).is_ok());
    });
    assert_eq!((heap.count_total, heap.count_current), (0, 0));
    let heap = measure(|| drop(plant));
    assert!(heap.count_current < 0, "the counter counts");
}
