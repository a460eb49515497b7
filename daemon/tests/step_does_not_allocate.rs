//! A cycle of the controller neither allocates nor frees, in every mode.

mod common;

use common::{Arm, at_rest, config, rest_plan, upright_pose};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use upswing_ipc::Mode;
use upswingd::controller::{Controller, Order};
use upswingd::supervisor::Request;

struct Counting;

thread_local! {
    static CALLS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: all calls go to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn in_any_mode() {
    let config = config();
    let x = at_rest(&upright_pose());
    let mut arm = Arm::new(&config, x);
    let mut controller = Controller::new(&config);
    let mut plans = [rest_plan(&config, &x, 0.01), rest_plan(&config, &x, 0.01)].into_iter();
    let mut garbage = Vec::with_capacity(4);
    let mut seen = Vec::with_capacity(8);
    for k in 0..4000_u64 {
        let mut measurement = arm.measure();
        let order = match k {
            1 => Some(Order::Do(Request::Start)),
            2 => Some(Order::Do(Request::Enable)),
            100 | 101 => plans.next().map(Order::Load),
            102 => Some(Order::Do(Request::Start)),
            400 => Some(Order::Do(Request::Stop)),
            _ => None,
        };
        if k == 3900 {
            measurement.q[0] = f64::NAN;
        }
        let before = CALLS.get();
        let output = controller.step(&measurement, 0, order);
        assert_eq!(CALLS.get() - before, 0, "cycle {k} in {}", controller.mode());
        if !seen.contains(&controller.mode()) {
            seen.push(controller.mode());
        }
        garbage.extend(output.garbage);
        arm.advance(&output.command);
    }
    let expected = [Mode::Idle, Mode::Hold, Mode::Track, Mode::Balance, Mode::Stop, Mode::Fault];
    assert_eq!(seen, expected);
    assert_eq!(garbage.len(), 1, "the plan that another one replaced");
    let before = CALLS.get();
    drop(Box::new(1));
    assert_eq!(CALLS.get() - before, 2, "the counter counts");
}
