//! The blackboard operations of the real-time thread use no heap.

use allocation_counter::measure;
use upswing_ipc::{Command, Measurement, TempDomain};

#[test]
fn neither_writing_nor_reading_nor_dropping_entries_uses_the_heap() {
    let domain = TempDomain::new("heap").unwrap();
    let node = domain.join("both").unwrap();
    let (measurement_in, _measurement_ports) = node.writer::<Measurement>().unwrap().split();
    let mut measurements = node.finder::<Measurement>();
    let measurement_out = measurements.poll().unwrap().unwrap();
    let (command_in, _command_ports) = node.writer::<Command>().unwrap().split();
    let mut commands = node.finder::<Command>();
    let command_out = commands.poll().unwrap().unwrap();

    let heap = measure(|| {
        for seq in 1..=10_000 {
            measurement_in.write(Measurement { seq, ..Measurement::default() });
            let measurement_seq = measurement_out.read().seq;
            command_in.write(Command { seq, measurement_seq, ..Command::default() });
            assert_eq!(command_out.read().measurement_seq, seq);
        }
    });
    assert_eq!((heap.count_total, heap.count_current), (0, 0));
    let heap = measure(|| drop((measurement_in, measurement_out, command_in, command_out)));
    assert_eq!((heap.count_total, heap.count_current), (0, 0));
    let heap = measure(|| drop((measurements, commands)));
    assert!(heap.count_current < 0, "the counter counts");
}
