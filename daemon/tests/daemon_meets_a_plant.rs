//! The whole daemon over shared memory, with a plant that does not move.

mod common;

use common::{config, measurement, rest_payload, rest_pose};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};
use upswing_config::process::Failure;
use upswing_ipc::{
    Client, Clock, Command, ControlCommand, ControlRequest, ControlResponse, Domain, Finder, Measurement,
    Mode, Node, Reader, Telemetry, Writer,
};
use upswing_model::JointVector;
use upswingd::service::serve;

/// Far beyond anything that is waited for here.
const LONG: Duration = Duration::from_secs(30);

fn new_domain() -> Domain {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    let name = format!("daemon-{}-{}", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed));
    Domain::new(&name).unwrap()
}

struct Daemon {
    thread: JoinHandle<Result<(), Failure>>,
    shutdown: Arc<AtomicBool>,
}

impl Daemon {
    fn start(domain: &Domain) -> Self {
        let shutdown = Arc::new(AtomicBool::new(false));
        let (domain, flag) = (domain.clone(), Arc::clone(&shutdown));
        Self { thread: spawn(move || serve(&config(), &domain, &flag)), shutdown }
    }

    fn end(self) -> Result<(), Failure> {
        self.shutdown.store(true, Ordering::Release);
        self.thread.join().unwrap()
    }
}

struct Plant {
    writer: Writer<Measurement>,
    finder: Finder<Command>,
    commands: Option<Reader<Command>>,
    clock: Clock,
    q: JointVector,
    seq: u64,
}

impl Plant {
    fn new(node: &Node, clock: Clock) -> Self {
        let q = rest_pose(&config());
        Self {
            writer: node.measurement_writer().unwrap(),
            finder: node.command_finder(),
            commands: None,
            clock,
            q,
            seq: 0,
        }
    }

    fn publish(&self) {
        let mut next = measurement(self.seq, &self.q);
        next.clock = self.clock.code();
        self.writer.write(next);
    }

    fn command(&mut self) -> Command {
        let begin = Instant::now();
        while self.commands.is_none() {
            assert!(begin.elapsed() < LONG, "no daemon");
            self.commands = self.finder.poll().unwrap();
            sleep(Duration::from_millis(1));
        }
        self.commands.as_ref().unwrap().read()
    }

    /// One cycle; `None` if `give_up` before the answer.
    fn exchange_unless(&mut self, give_up: impl Fn() -> bool) -> Option<Command> {
        self.seq += 1;
        self.publish();
        let begin = Instant::now();
        loop {
            let command = self.command();
            if command.measurement_seq == self.seq {
                return Some(command);
            }
            if give_up() {
                return None;
            }
            assert!(begin.elapsed() < LONG, "no answer to measurement {}", self.seq);
            std::thread::yield_now();
        }
    }

    fn exchange(&mut self) -> Command {
        self.exchange_unless(|| false).unwrap()
    }
}

/// A plant that runs in a thread of its own until `stop`.
fn running_plant(domain: &Domain, clock: Clock, stop: &Arc<AtomicBool>) -> JoinHandle<()> {
    let (domain, stop) = (domain.clone(), Arc::clone(stop));
    spawn(move || {
        let node = domain.connect("plant").unwrap();
        let mut plant = Plant::new(&node, clock);
        while !stop.load(Ordering::Acquire) {
            if clock == Clock::Wall {
                plant.seq += 1;
                plant.publish();
                sleep(Duration::from_micros(100));
            } else {
                plant.exchange_unless(|| stop.load(Ordering::Acquire));
            }
        }
    })
}

fn ask(client: &Client<ControlRequest>, command: ControlCommand) -> ControlResponse {
    client.call(&ControlRequest::new(command), LONG).unwrap()
}

/// Repeats a request until its answer pleases.
fn ask_until(
    client: &Client<ControlRequest>,
    command: ControlCommand,
    pleases: impl Fn(&ControlResponse) -> bool,
) -> ControlResponse {
    let begin = Instant::now();
    loop {
        if client.has_server() {
            let answer = ask(client, command);
            if pleases(&answer) {
                return answer;
            }
            assert!(begin.elapsed() < LONG, "last answer: {answer:?}");
        }
        assert!(begin.elapsed() < LONG, "no daemon");
        sleep(Duration::from_millis(2));
    }
}

#[test]
fn on_lockstep_every_measurement_gets_one_cycle_and_requests_wait_for_the_next() {
    let domain = new_domain();
    let node = domain.connect("plant").unwrap();
    let telemetry = node.telemetry_subscriber().unwrap();
    let plans = node.plan_publisher().unwrap();
    let client = node.control_client().unwrap();
    let mut plant = Plant::new(&node, Clock::Lockstep);
    let daemon = Daemon::start(&domain);
    // As far as the daemon can know by now, time stands still before the first measurement.
    let answer = ask_until(&client, ControlCommand::Stop, |answer| answer.accepted == 1);
    assert!(answer.reason.as_str().unwrap().contains("queued"), "{}", answer.reason);
    assert_eq!(plant.exchange().brake, 1);
    ask_until(&client, ControlCommand::Status, |answer| {
        answer.reason.as_str().unwrap().contains("stop is not")
    });

    let answer = ask(&client, ControlCommand::Enable);
    assert_eq!((answer.accepted, answer.mode()), (1, Ok(Mode::Idle)), "{}", answer.reason);
    assert!(answer.reason.as_str().unwrap().contains("queued"), "{}", answer.reason);
    let q = plant.q;
    let mut payload = rest_payload(&config(), &common::at_rest(&q), 1.0);
    plans.publish(&payload).unwrap();
    ask_until(&client, ControlCommand::Status, |answer| answer.plan_id == 7);
    payload.fingerprint = 1;
    payload.seal();
    plans.publish(&payload).unwrap();
    ask_until(&client, ControlCommand::Status, |answer| {
        answer.reason.as_str().unwrap().contains("fingerprint")
    });
    ask(&client, ControlCommand::Start);

    let modes: Vec<u64> = (2..=40).map(|_| plant.exchange().brake).collect();
    assert!(modes.iter().all(|brake| *brake == 0), "enable took effect at measurement 2");
    let answer = ask_until(&client, ControlCommand::Status, |answer| answer.seq == 40);
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
    assert_eq!(seen, [Mode::Idle, Mode::Hold, Mode::Hold, Mode::Track, Mode::Track], "one order per cycle");
    assert!(records.iter().all(|r| [r.wake_ns, r.read_ns, r.compute_ns, r.write_ns] == [0; 4]));

    daemon.shutdown.store(true, Ordering::Release);
    while !daemon.thread.is_finished() {
        plant.exchange_unless(|| daemon.thread.is_finished());
    }
    daemon.end().unwrap();
    assert_eq!(plant.command().brake, 1);
    drop((plant, client, plans, telemetry, node));
    domain.remove_if_unused().unwrap();
}

#[test]
fn a_plant_that_stops_or_restarts_is_a_fault() {
    for clock in [Clock::Paced, Clock::Wall] {
        let domain = new_domain();
        let node = domain.connect("operator").unwrap();
        let client = node.control_client().unwrap();
        let daemon = Daemon::start(&domain);
        let stop = Arc::new(AtomicBool::new(false));
        let plant = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlCommand::Enable, |answer| answer.accepted == 1);
        ask_until(&client, ControlCommand::Status, |answer| answer.mode() != Ok(Mode::Idle));
        stop.store(true, Ordering::Release);
        let answer = ask_until(&client, ControlCommand::Status, |answer| answer.mode() == Ok(Mode::Fault));
        assert!(answer.reason.as_str().unwrap().contains("no new measurement"), "{clock}: {}", answer.reason);
        let answer = ask(&client, ControlCommand::Enable);
        assert_eq!(answer.accepted, 0);
        assert!(answer.reason.as_str().unwrap().contains("fault"), "{}", answer.reason);
        assert_eq!(ask(&client, ControlCommand::Reset).mode(), Ok(Mode::Idle));
        plant.join().unwrap();

        // The next one is found, and has to be enabled again.
        let stop = Arc::new(AtomicBool::new(false));
        let plant = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlCommand::Enable, |answer| answer.accepted == 1);
        let third = running_plant(&domain, clock, &stop);
        ask_until(&client, ControlCommand::Status, |answer| answer.mode() == Ok(Mode::Fault));
        stop.store(true, Ordering::Release);
        daemon.end().unwrap();
        plant.join().unwrap();
        third.join().unwrap();
        drop((client, node));
        domain.remove_if_unused().unwrap();
    }
}

#[test]
fn a_second_daemon_is_refused() {
    let domain = new_domain();
    let node = domain.connect("operator").unwrap();
    let client = node.control_client().unwrap();
    let first = Daemon::start(&domain);
    ask_until(&client, ControlCommand::Status, |_| true);
    let refusal = Daemon::start(&domain).end().unwrap_err();
    assert!(matches!(&refusal, Failure::Failed(text) if text.contains("has a daemon already")), "{refusal}");
    first.end().unwrap();
    drop((client, node));
    domain.remove_if_unused().unwrap();
}
