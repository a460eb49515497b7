//! Batches of telemetry reach every subscriber, in order, and a slow one loses the oldest.

use std::sync::Barrier;
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_ipc::{StepBatch, Telemetry, TelemetryBatch, TempDomain};

#[test]
fn a_batch_holds_what_was_pushed_and_no_more() {
    let mut batch = TelemetryBatch::boxed_zeroed();
    assert!(batch.used().is_empty());
    for seq in 1..=batch.records.len() as u64 {
        assert!(batch.push(Telemetry { seq, ..Telemetry::default() }));
    }
    assert!(!batch.push(Telemetry::default()), "full");
    assert_eq!(batch.used().len(), batch.records.len());
    assert_eq!(batch.used().last().unwrap().seq, batch.records.len() as u64);
    batch.clear();
    assert!(batch.used().is_empty());
    batch.count = u64::MAX;
    assert_eq!(batch.used().len(), batch.records.len(), "a garbled count stays within the records");
    assert!(!batch.push(Telemetry::default()));
}

#[test]
fn every_subscriber_gets_every_cycle_in_order() {
    let domain = TempDomain::new("telemetry").unwrap();
    let node = domain.join("daemon").unwrap();
    let peer = domain.join("monitor").unwrap();
    let publisher = node.publisher::<TelemetryBatch>().unwrap();
    let subscribers =
        [peer.subscriber::<TelemetryBatch>().unwrap(), node.subscriber::<TelemetryBatch>().unwrap()];

    let batches = 300;
    let mut expected = [0; 2];
    let mut batch = TelemetryBatch::boxed_zeroed();
    let mut seq = 0;
    for _ in 0..batches {
        batch.clear();
        for _ in 0..5 {
            seq += 1;
            assert!(batch.push(Telemetry { seq, t_ns: 125_000 * seq, ..Telemetry::default() }));
        }
        publisher.publish(&batch).unwrap();
        for (subscriber, expected) in subscribers.iter().zip(&mut expected) {
            while let Some(received) = subscriber.receive().unwrap() {
                for record in received.used() {
                    *expected += 1;
                    assert_eq!((record.seq, record.t_ns), (*expected, 125_000 * *expected));
                }
            }
        }
    }
    assert_eq!(expected, [seq; 2]);
}

#[test]
fn a_slow_subscriber_loses_the_oldest_and_never_stops_the_publisher() {
    let domain = TempDomain::new("slow").unwrap();
    let node = domain.join("daemon").unwrap();
    let publisher = node.publisher::<TelemetryBatch>().unwrap();
    let subscriber = node.subscriber::<TelemetryBatch>().unwrap();
    let mut batch = TelemetryBatch::boxed_zeroed();
    let published = 1000;
    for seq in 1..=published {
        batch.clear();
        assert!(batch.push(Telemetry { seq, ..Telemetry::default() }));
        publisher.publish(&batch).unwrap();
    }
    let mut seqs = Vec::new();
    while let Some(received) = subscriber.receive().unwrap() {
        seqs.push(received.used()[0].seq);
    }
    assert!(!seqs.is_empty() && seqs.len() < 1000, "{}", seqs.len());
    assert!(seqs.is_sorted());
    assert_eq!(*seqs.last().unwrap(), published);

    let late = node.subscriber::<TelemetryBatch>().unwrap();
    publisher.deliver_history().unwrap();
    assert!(late.receive().unwrap().is_none(), "telemetry has no history");
}

#[test]
fn subscribers_that_hold_all_they_may_do_not_stop_the_publisher() {
    let domain = TempDomain::new("held").unwrap();
    let (node, peer) = (domain.join("daemon").unwrap(), domain.join("monitor").unwrap());
    let publisher = node.publisher::<TelemetryBatch>().unwrap();
    let batch = TelemetryBatch::boxed_zeroed();
    let mut held = Vec::new();
    // Each one holds other samples, and its buffer is full of newer ones.
    for _ in 0..8 {
        let subscriber = peer.subscriber::<TelemetryBatch>().unwrap();
        (0..2).for_each(|_| publisher.publish(&batch).unwrap());
        let samples: Vec<_> = (0..2).map(|_| subscriber.receive().unwrap().unwrap()).collect();
        held.push((subscriber, samples));
        (0..600).for_each(|_| publisher.publish(&batch).unwrap());
    }
    assert!(peer.subscriber::<TelemetryBatch>().is_err(), "there are as many as there may be");
    // Some go and others come, some drop what they hold and take other samples.
    for i in 0..3000 {
        publisher.publish(&batch).unwrap();
        if i % 100 == 0 {
            let (subscriber, samples) = &mut held[i / 100 % 8];
            samples.truncate(1);
            samples.push(subscriber.receive().unwrap().unwrap());
        }
        if i % 700 == 0 {
            held.remove(3);
            held.push((peer.subscriber().unwrap(), Vec::new()));
        }
    }
}

#[test]
fn subscribers_that_receive_all_the_time_do_not_stop_the_publisher() {
    let domain = TempDomain::new("busy").unwrap();
    let publisher = domain.join("daemon").unwrap().publisher::<StepBatch>().unwrap();
    let batch = StepBatch::boxed_zeroed();
    let (ready, done) = (Barrier::new(9), AtomicBool::new(false));
    std::thread::scope(|threads| {
        for _ in 0..8 {
            threads.spawn(|| {
                let subscriber = domain.join("recorder").unwrap().subscriber::<StepBatch>().unwrap();
                let mut held = Vec::new();
                ready.wait();
                while !done.load(Ordering::Acquire) {
                    held.truncate(1);
                    held.extend(subscriber.receive().unwrap());
                    std::thread::yield_now();
                }
            });
        }
        ready.wait();
        let published = (0..20_000).try_for_each(|_| publisher.publish(&batch));
        done.store(true, Ordering::Release);
        published.unwrap();
    });
}
