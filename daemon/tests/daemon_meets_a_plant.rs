//! The whole daemon over shared memory, with a plant that does not move.

mod common;

use common::live::{LONG, Plant, ask, ask_until, running_plant};
use common::{config, message, resting, sizes};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::{Clock, ControlKind, ControlRequest, Domain, Mode, Telemetry, TelemetryBatch, TempDomain};
use upswing_process::Failure;
use upswingd::service::serve;
use upswingd::trip::TripCause;

struct Daemon {
    thread: JoinHandle<Result<(), Failure>>,
    shutdown: Arc<AtomicBool>,
}

impl Daemon {
    fn start(domain: &Domain) -> Self {
        Self::start_with(domain, config())
    }

    fn start_with(domain: &Domain, config: Config) -> Self {
        let shutdown = Arc::new(AtomicBool::new(false));
        let (domain, flag) = (domain.clone(), Arc::clone(&shutdown));
        Self { thread: spawn(move || serve(&config, &domain, &flag)), shutdown }
    }

    fn end(self) -> Result<(), Failure> {
        self.shutdown.store(true, Ordering::Release);
        self.thread.join().unwrap()
    }
}

#[test]
fn on_lockstep_every_measurement_gets_one_cycle_and_requests_wait_for_the_next() {
    let domain = TempDomain::new("daemon").unwrap();
    let node = domain.join("plant").unwrap();
    let telemetry = node.subscriber::<TelemetryBatch>().unwrap();
    let config = config();
    let plans = node.plan_publisher(sizes(), config.planner.offline.intervals).unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let mut plant = Plant::new(&node, Clock::Lockstep);
    let daemon = Daemon::start(&domain);
    // As far as the daemon can know by now, time stands still before the first measurement.
    let answer = ask_until(&client, ControlKind::Stop, |answer| answer.accepted == 1);
    assert!(answer.reason.as_str().unwrap().contains("queued"), "{}", answer.reason);
    assert_eq!(plant.exchange().brake, 1);
    ask_until(&client, ControlKind::Status, |answer| answer.reason.as_str().unwrap().contains("stop is not"));

    let answer = ask(&client, ControlKind::Enable);
    assert_eq!((answer.accepted, answer.mode()), (1, Ok(Mode::Idle)), "{}", answer.reason);
    assert!(answer.reason.as_str().unwrap().contains("queued"), "{}", answer.reason);
    let q = plant.q;
    let mut plan = resting(&config, &common::at_rest(&q), 1.0);
    plans.publish(&message(&plan)).unwrap();
    ask_until(&client, ControlKind::Status, |answer| answer.plan_id == 7);
    plan.fingerprint = 1;
    plans.publish(&message(&plan)).unwrap();
    ask_until(&client, ControlKind::Status, |answer| answer.reason.as_str().unwrap().contains("fingerprint"));
    client.call(&ControlRequest::start(7), LONG).unwrap();

    let modes: Vec<u64> = (2..=40).map(|_| plant.exchange().brake).collect();
    assert!(modes.iter().all(|brake| *brake == 0), "enable took effect at measurement 2");
    let answer = ask_until(&client, ControlKind::Status, |answer| answer.seq == 40);
    assert_eq!((answer.mode(), answer.running_plan), (Ok(Mode::Track), 7));

    let mut records: Vec<Telemetry> = Vec::new();
    let begin = Instant::now();
    while records.len() < 40 {
        match telemetry.receive().unwrap() {
            Some(batch) => records.extend(batch.used()),
            None => sleep(Duration::from_millis(1)),
        }
        assert!(begin.elapsed() < LONG, "{} records", records.len());
    }
    let numbers: Vec<(u64, u64)> = records.iter().map(|r| (r.seq, r.measurement_seq)).collect();
    assert_eq!(numbers, (1..=40).map(|n| (n, n)).collect::<Vec<_>>());
    let mode_at = |n: usize| records[n - 1].mode().unwrap();
    let seen = [1, 2, 3, 4, 40].map(mode_at);
    assert_eq!(seen, [Mode::Idle, Mode::Hold, Mode::Hold, Mode::Track, Mode::Track], "one request per cycle");
    assert!(records.iter().all(|r| [r.wake_ns, r.read_ns, r.compute_ns, r.write_ns] == [0; 4]));

    daemon.shutdown.store(true, Ordering::Release);
    while !daemon.thread.is_finished() {
        plant.exchange_unless(|| daemon.thread.is_finished());
    }
    daemon.end().unwrap();
    assert_eq!(plant.command().brake, 1);
}

#[test]
fn a_plant_that_stops_or_restarts_is_a_fault() {
    for clock in [Clock::Paced, Clock::Wall] {
        let domain = TempDomain::new("daemon").unwrap();
        let node = domain.join("operator").unwrap();
        let client = node.client::<ControlRequest>().unwrap();
        let daemon = Daemon::start(&domain);
        let stop = Arc::new(AtomicBool::new(false));
        let plant = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlKind::Enable, |answer| answer.accepted == 1);
        ask_until(&client, ControlKind::Status, |answer| answer.mode() != Ok(Mode::Idle));
        stop.store(true, Ordering::Release);
        let answer = ask_until(&client, ControlKind::Status, |answer| answer.mode() == Ok(Mode::Fault));
        // A plant on the wall clock may be late before it stops.
        let late = clock == Clock::Wall && answer.fault == TripCause::MeasurementGap.code();
        let told = answer.reason.as_str().unwrap();
        assert!(late || told.contains("no new measurement"), "{clock}: {told}");
        let answer = ask(&client, ControlKind::Enable);
        assert_eq!(answer.accepted, 0);
        assert!(answer.reason.as_str().unwrap().contains("fault"), "{}", answer.reason);
        assert_eq!(ask(&client, ControlKind::Reset).mode(), Ok(Mode::Idle));
        plant.join().unwrap();

        // The next one is found, and has to be enabled again.
        let stop = Arc::new(AtomicBool::new(false));
        let plant = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlKind::Enable, |answer| answer.accepted == 1);
        let third = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlKind::Status, |answer| answer.mode() == Ok(Mode::Fault));
        stop.store(true, Ordering::Release);
        daemon.end().unwrap();
        plant.join().unwrap();
        third.join().unwrap();
    }
}

/// The lock of all that create and clean up, held by somebody who does not give it back.
fn hold_creation_lock(domain: &Domain) -> std::fs::File {
    let file = std::fs::File::options().write(true).open(domain.root().join("creation.lock")).unwrap();
    file.lock().unwrap();
    file
}

#[test]
fn a_lock_that_is_not_given_back_delays_no_request_and_loses_no_cycle() {
    let domain = TempDomain::new("daemon").unwrap();
    let node = domain.join("operator").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let daemon = Daemon::start(&domain);
    let mut plant = Plant::new(&node, Clock::Lockstep);
    plant.exchange();
    ask_until(&client, ControlKind::Status, |answer| answer.seq == 1);
    let telemetry = node.subscriber::<TelemetryBatch>().unwrap();
    let held = hold_creation_lock(&domain);
    // More than the ring from the real-time thread has room for; the plant waits for what is fetched every now and then.
    for _ in 0..30 {
        for _ in 0..1000 {
            plant.exchange();
        }
        let seq = plant.seq;
        ask_until(&client, ControlKind::Status, |answer| answer.seq == seq);
        while let Some(batch) = telemetry.receive().unwrap() {
            assert_eq!(batch.dropped, 0);
        }
    }
    // It ends although somebody looks for plants.
    daemon.end().unwrap();
    drop(held);
}

#[test]
fn requests_without_end_do_not_keep_it_from_ending() {
    let domain = TempDomain::new("daemon").unwrap();
    let node = domain.join("operator").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let daemon = Daemon::start(&domain);
    ask_until(&client, ControlKind::Status, |_| true);
    // Without a plant each of these takes a while; two always wait.
    let busy: Vec<_> = (0..3)
        .map(|_| {
            let domain = domain.clone();
            spawn(move || {
                let client = domain.join("operator").unwrap().client::<ControlRequest>().unwrap();
                while client.call(&ControlRequest::new(ControlKind::Enable), LONG).is_ok() {}
            })
        })
        .collect();
    ask(&client, ControlKind::Status);
    daemon.shutdown.store(true, Ordering::Release);
    let begin = Instant::now();
    while !daemon.thread.is_finished() {
        assert!(begin.elapsed() < LONG, "the daemon does not hear that it shall end");
        sleep(Duration::from_millis(1));
    }
    daemon.end().unwrap();
    busy.into_iter().for_each(|client| client.join().unwrap());
}

#[test]
fn a_second_daemon_is_refused() {
    let domain = TempDomain::new("daemon").unwrap();
    let node = domain.join("operator").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let first = Daemon::start(&domain);
    ask_until(&client, ControlKind::Status, |_| true);
    let refusal = Daemon::start(&domain).end().unwrap_err();
    assert!(matches!(&refusal, Failure::Failed(text) if text.contains("has a daemon already")), "{refusal}");
    first.end().unwrap();
}

#[test]
fn the_cycles_before_a_fault_are_kept() {
    let domain = TempDomain::new("daemon").unwrap();
    let node = domain.join("plant").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let mut plant = Plant::new(&node, Clock::Lockstep);
    let folder = tempfile::tempdir().unwrap();
    let mut config = config();
    config.daemon.recorder.directory = Some(folder.path().to_owned());
    let daemon = Daemon::start_with(&domain, config);
    plant.exchange();
    ask(&client, ControlKind::Enable);
    (0..100).for_each(|_| {
        plant.exchange();
    });
    plant.q[3] = f64::NAN;
    plant.exchange();
    let answer = ask_until(&client, ControlKind::Status, |answer| answer.mode() == Ok(Mode::Fault));
    let told = answer.reason.as_str().unwrap().to_owned();
    assert!(
        told.contains("joint `joint_4` is NaN") && told.contains(folder.path().to_str().unwrap()),
        "{told}"
    );
    let files: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let records = upswingd::flight::read(&files[0]).unwrap();
    let seqs: Vec<u64> = records.iter().map(|record| record.seq).collect();
    assert_eq!(seqs, (1..=102).collect::<Vec<_>>());
    let last = &records[101];
    assert_eq!((last.mode(), last.fault), (Ok(Mode::Fault), TripCause::NotFinite.code()));
    assert!(last.q[3].is_nan());
    assert_eq!(records[100].mode(), Ok(Mode::Hold));
    daemon.end().unwrap();
}
