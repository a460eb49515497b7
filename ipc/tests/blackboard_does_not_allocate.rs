//! What the real-time thread calls uses no heap.

use allocation_counter::{AllocationInfo, measure};
use upswing_ipc::{Command, Measurement, OwnDomain};

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
fn neither_writing_nor_reading_nor_dropping_entries_uses_the_heap() {
    let domain = OwnDomain::new("heap").unwrap();
    let node = domain.connect("both").unwrap();
    let (measurement_in, _measurement_ports) = node.writer::<Measurement>().unwrap().split();
    let mut measurements = node.finder::<Measurement>();
    let measurement_out = measurements.poll().unwrap().unwrap();
    let (command_in, _command_ports) = node.writer::<Command>().unwrap().split();
    let mut commands = node.finder::<Command>();
    let command_out = commands.poll().unwrap().unwrap();

    assert!(uses_no_heap(|| {
        for seq in 1..=10_000 {
            measurement_in.write(Measurement { seq, ..Measurement::default() });
            let measurement_seq = measurement_out.read().seq;
            command_in.write(Command { seq, measurement_seq, ..Command::default() });
            assert_eq!(command_out.read().measurement_seq, seq);
        }
    }));
    assert!(uses_no_heap(|| drop((measurement_in, measurement_out, command_in, command_out))));
}
