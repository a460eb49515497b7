//! A plant that does not move, and an operator, for tests of the whole daemon over shared memory.

use super::{config, measurement, rest_pose};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};
use upswing_ipc::{
    Client, Clock, Command, ControlKind, ControlRequest, ControlResponse, Domain, Finder, Measurement, Node,
    Reader, Writer, monotonic_ns,
};
use upswing_model::JointVector;

/// Far beyond anything that is waited for here.
pub const LONG: Duration = Duration::from_secs(30);

pub struct Plant {
    pub writer: Writer<Measurement>,
    pub finder: Finder<Command>,
    pub commands: Option<Reader<Command>>,
    pub clock: Clock,
    pub q: JointVector,
    pub seq: u64,
}

impl Plant {
    pub fn new(node: &Node, clock: Clock) -> Self {
        let q = rest_pose(&config());
        Self {
            writer: node.writer::<Measurement>().unwrap(),
            finder: node.finder::<Command>(),
            commands: None,
            clock,
            q,
            seq: 0,
        }
    }

    pub fn publish(&self) {
        let mut next = measurement(self.seq, &self.q);
        next.clock = self.clock.code();
        if self.clock == Clock::Wall {
            next.t_ns = monotonic_ns();
        }
        self.writer.write(next);
    }

    pub fn command(&mut self) -> Command {
        let begin = Instant::now();
        while self.commands.is_none() {
            assert!(begin.elapsed() < LONG, "no daemon");
            self.commands = self.finder.poll().unwrap();
            sleep(Duration::from_millis(1));
        }
        self.commands.as_ref().unwrap().read()
    }

    /// One cycle; `None` if `give_up` before the answer.
    pub fn exchange_unless(&mut self, give_up: impl Fn() -> bool) -> Option<Command> {
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

    pub fn exchange(&mut self) -> Command {
        self.exchange_unless(|| false).unwrap()
    }
}

/// A plant that runs in a thread of its own until `stop`.
pub fn running_plant(domain: &Domain, clock: Clock, stop: &Arc<AtomicBool>) -> JoinHandle<()> {
    let (domain, stop) = (domain.clone(), Arc::clone(stop));
    spawn(move || {
        let node = domain.join("plant").unwrap();
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

pub fn ask(client: &Client<ControlRequest>, command: ControlKind) -> ControlResponse {
    client.call(&ControlRequest::new(command), LONG).unwrap()
}

/// Repeats a request until its answer pleases.
pub fn ask_until(
    client: &Client<ControlRequest>,
    command: ControlKind,
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
