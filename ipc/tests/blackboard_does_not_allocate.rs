//! What the real-time thread calls uses no heap.

mod common;

use common::TestDomain;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use upswing_ipc::{Command, Measurement};

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
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract.
        unsafe { System.realloc(memory, layout, size) }
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
fn neither_writing_nor_reading_nor_dropping_entries_uses_the_heap() {
    let domain = TestDomain::new("heap");
    let node = domain.connect("both").unwrap();
    let (measurement_in, _measurement_ports) = node.measurement_writer().unwrap().split();
    let mut measurements = node.measurement_finder();
    let measurement_out = measurements.poll().unwrap().unwrap();
    let (command_in, _command_ports) = node.command_writer().unwrap().split();
    let mut commands = node.command_finder();
    let command_out = commands.poll().unwrap().unwrap();

    let in_cycles = heap_calls(|| {
        for seq in 1..=10_000 {
            let before = measurement_out.snapshot();
            measurement_in.write(Measurement { seq, ..Measurement::default() });
            assert!(measurement_out.is_new(&before));
            let measurement_seq = measurement_out.read().seq;
            command_in.write(Command { seq, measurement_seq, ..Command::default() });
            assert_eq!(command_out.read().measurement_seq, seq);
        }
    });
    assert_eq!(in_cycles, 0);

    let dropping = heap_calls(|| drop((measurement_in, measurement_out, command_in, command_out)));
    assert_eq!(dropping, 0);
}
