//! The blackboard operations of the real-time thread, and the conversions of its payloads, use no heap.

mod common;

use allocation_counter::measure;
use upswing_ipc::{Command, CycleVectors, Measurement, Telemetry, TempDomain};
use upswing_model::{ActuatedVector, JointVector, State};

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

#[test]
fn conversions_do_not_use_the_heap_either_way() {
    let chain = common::chain(&[true, false, true]);
    let (order, sizes) = (chain.order(), chain.sizes());
    let q = JointVector::from_fn(sizes, |i| i as f64);
    let tau = ActuatedVector::repeat(sizes, 1.0);
    let x = State::new(&q, &q);
    let vectors = CycleVectors { x, x_d: x, u_d: tau, u: tau, tau, tau_measured: tau };
    let heap = measure(|| {
        assert_eq!(Measurement::new(order, &q, &tau).vectors(order), Ok((q, tau)));
        assert_eq!(Command::new(&tau).torque(sizes), Ok(tau));
        assert_eq!(Telemetry::new(order, &vectors).vectors(order), Ok(vectors));
        assert!(Measurement::default().vectors(order).is_err());
    });
    assert_eq!((heap.count_total, heap.count_current), (0, 0));
}
