//! Measuring and stepping use no heap, on no path.

mod common;

use common::{settings, torque};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::Command;
use upswing_plant::Plant;

/// Counts the heap calls of the current thread.
struct Counting;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: passes everything on to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller keeps the contract.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn heap_calls(work: impl FnOnce()) -> u64 {
    let before = CALLS.get();
    work();
    CALLS.get() - before
}

#[test]
fn the_counter_counts() {
    assert_eq!(heap_calls(|| drop(std::hint::black_box(Box::new(1)))), 2);
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
    let calls = heap_calls(|| {
        for command in commands.iter().cycle().take(100) {
            plant.step(command.as_ref());
            std::hint::black_box(plant.measure());
        }
        assert!(plant.reset(&q, &qd).is_ok());
    });
    assert_eq!(calls, 0);
}
