//! Measuring and stepping use no heap, on no path.

mod common;

use allocation_counter::{AllocationInfo, measure};
use common::{settings, torque};
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::Command;
use upswing_plant::Plant;

/// Whether `work` neither allocates nor frees.
fn uses_no_heap(work: impl FnOnce()) -> bool {
    let AllocationInfo { count_total: allocated, count_current: kept, .. } = measure(work);
    (allocated, kept) == (0, 0)
}

#[test]
fn the_counter_counts() {
    let boxed = std::hint::black_box(Box::new(1));
    assert!(!uses_no_heap(|| drop(boxed)));
    assert!(!uses_no_heap(|| std::mem::forget(std::hint::black_box(Box::new(1)))));
}

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
        Some(torque([1.0; _])),
        Some(torque([1e3; _])),
        None,
        Some(torque([f64::NAN; _])),
        Some(Command { brake: 1, ..Command::default() }),
    ];
    assert!(uses_no_heap(|| {
        for command in commands.iter().cycle().take(100) {
            plant.step(command.as_ref());
            std::hint::black_box(plant.measure());
        }
        assert!(plant.reset(&q, &qd).is_ok());
    }));
}
