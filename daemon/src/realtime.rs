//! Real-time thread: waits for the next cycle, steps the controller, writes the command.
//!
//! Once started, the thread neither allocates nor frees, and its only system calls read the clock and sleep.
//! All data come and go through wait-free rings, whose other ends are in [`RealtimeLink`].

use crate::controller::Controller;
use crate::step::{CycleRecord, MOST_RETIRED, StepInput, StepRequest};
use crate::supervisor::RequestRefusal;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use upswing_config::Config;
use upswing_ipc::{
    Command, CycleStart, CycleTimes, DaemonPacing, DaemonWake, Measurement, Reader, Telemetry, WriterEntry,
    monotonic_ns,
};
use upswing_model::{ActuatedVector, Sizes};
use upswing_trajectory::Plan;

/// Capacity of the ring of records: the service thread may be one second late.
const RECORDS: usize = 8192;
/// Capacity of the ring of requests.
const REQUESTS: usize = 64;
/// Most replies to one request: an answer and the retired plans.
const REPLIES_PER_REQUEST: usize = 1 + MOST_RETIRED;
/// Capacity of the ring of readers, one for each plant that is found.
const READERS: usize = 8;

/// A request to the controller, with the number that its answer will carry.
pub struct NumberedRequest {
    /// Number, unique within this daemon.
    pub number: u64,
    /// The request.
    pub request: StepRequest,
}

/// A message from the controller to the service thread.
pub enum Reply {
    /// The answer to a request.
    Answer {
        /// Number of the request.
        number: u64,
        /// The refusal, if the request was refused.
        result: Result<(), RequestRefusal>,
    },
    /// A plan that the service thread has to free.
    Retired(Box<Plan>),
}

/// Flags and counters shared by the real-time thread and the service thread.
#[derive(Default)]
pub struct SharedFlags {
    /// Makes the real-time thread close the brakes and end.
    pub exit: AtomicBool,
    /// Whether requests wait for a measurement for an unknown time (clock `lockstep`).
    pub stands_still: AtomicBool,
    /// Whether the plant is on clock `wall`: only then does the thread need real-time priority.
    pub real_time: AtomicBool,
    /// Whether the plant found last is alive.
    pub plant_lives: AtomicBool,
    /// Records that did not fit into the ring.
    pub dropped: AtomicU64,
    /// Heartbeat of the real-time thread: incremented at least every 20 ms, with or without a plant.
    pub beats: AtomicU64,
}

/// The service thread's connection to the real-time thread.
pub struct RealtimeLink {
    /// Requests to the controller, in order of arrival.
    pub requests: Producer<NumberedRequest>,
    /// Readers of plants that were found.
    pub readers: Producer<Reader<Measurement>>,
    /// Answers to requests, and plans to be freed.
    pub replies: Consumer<Reply>,
    /// Records of the cycles.
    pub records: Consumer<CycleRecord>,
    /// Flags and counters shared by both threads.
    pub shared: Arc<SharedFlags>,
}

/// The real-time thread, with all data that it owns.
pub struct RealtimeThread {
    controller: Controller,
    pacing: DaemonPacing,
    command: WriterEntry<Command>,
    requests: Consumer<NumberedRequest>,
    readers: Consumer<Reader<Measurement>>,
    replies: Producer<Reply>,
    records: Producer<CycleRecord>,
    shared: Arc<SharedFlags>,
    overruns: u64,
    /// Degradations, bits of [`upswing_ipc::Degradation`].
    degraded: u64,
    command_seq: u64,
    sizes: Sizes,
    /// Whether the plant has changed or restarted since the last step.
    restarted: bool,
    /// Answer to the request of this cycle, with the number of the request.
    answer: Option<(u64, Result<(), RequestRefusal>)>,
    /// Plans that the controller no longer needs.
    retired: [Option<Box<Plan>>; MOST_RETIRED],
}

impl RealtimeThread {
    /// Creates the thread, not yet started, and the service thread's connection to it. Commands go to `command`.
    pub fn new(config: &Config, command: WriterEntry<Command>) -> (Self, RealtimeLink) {
        let (requests_in, requests) = RingBuffer::new(REQUESTS);
        let (readers_in, readers) = RingBuffer::new(READERS);
        let (replies, replies_out) = RingBuffer::new(REPLIES_PER_REQUEST * REQUESTS);
        let (records, records_out) = RingBuffer::new(RECORDS);
        let shared = Arc::new(SharedFlags::default());
        let thread = Self {
            controller: Controller::new(config),
            pacing: DaemonPacing::new(config.daemon.cycle.period),
            command,
            requests,
            readers,
            replies,
            records,
            shared: Arc::clone(&shared),
            overruns: 0,
            degraded: 0,
            command_seq: 0,
            sizes: config.model.sizes(),
            restarted: false,
            answer: None,
            retired: [const { None }; MOST_RETIRED],
        };
        let link = RealtimeLink {
            requests: requests_in,
            readers: readers_in,
            replies: replies_out,
            records: records_out,
            shared,
        };
        (thread, link)
    }

    /// Runs until the service thread sets `exit`, then closes the brakes. `degraded`: real-time settings that the system refused,
    /// bits of [`upswing_ipc::Degradation`], for the records.
    pub fn run(mut self, degraded: u64) {
        self.degraded = degraded;
        let shared = Arc::clone(&self.shared);
        while let Some(wake) = self.pacing.wait(&shared.exit, &shared.plant_lives) {
            match wake {
                DaemonWake::Cycle(start) => self.cycle(start),
                DaemonWake::PlantLost { cycles } => self.step_between_cycles(cycles),
                // A new plant waits in its ring: the request may be meant for this plant.
                DaemonWake::Idle if self.pacing.stands_still() || !self.readers.is_empty() => {}
                DaemonWake::Idle if !self.requests.is_empty() => self.step_between_cycles(0),
                DaemonWake::Idle => {}
            }
            shared.beats.fetch_add(1, Ordering::Relaxed);
            self.adopt_reader();
            shared.stands_still.store(self.pacing.stands_still(), Ordering::Release);
            shared.real_time.store(self.pacing.is_real_time(), Ordering::Relaxed);
        }
        self.command.write(Command {
            seq: self.command_seq + 1,
            t_ns: monotonic_ns(),
            measurement_seq: self.pacing.newest_seq(),
            brake: 1,
            ..Command::new(&ActuatedVector::zeros(self.sizes))
        });
    }

    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn adopt_reader(&mut self) {
        while let Ok(reader) = self.readers.pop() {
            // The service thread's finder holds the replaced reader open: dropping it only decrements a counter.
            self.restarted |= self.pacing.adopt(reader);
        }
    }

    /// Computes a control cycle and publishes its record.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn cycle(&mut self, start: CycleStart) {
        let (mut record, computed_ns) = self.step(start.planned_ns.unwrap_or(start.woken_ns), 0);
        let times = self.pacing.end(start, computed_ns, monotonic_ns());
        let CycleTimes { wake_ns, read_ns, compute_ns, write_ns, overrun } = times;
        record.telemetry = Telemetry { wake_ns, read_ns, compute_ns, write_ns, ..record.telemetry };
        self.publish(record, overrun);
    }

    /// Computes a step between cycles, without a new measurement, to answer a request or because the plant counts as lost
    /// after `lost_cycles` cycles without a measurement.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn step_between_cycles(&mut self, lost_cycles: u64) {
        let (record, _) = self.step(monotonic_ns(), lost_cycles);
        self.publish(record, false);
    }

    /// Steps the controller at the time `now` (CLOCK_MONOTONIC, ns) and writes the command. Returns the record, and the time at
    /// which the command was computed (ns).
    fn step(&mut self, now: u64, lost_cycles: u64) -> (CycleRecord, u64) {
        // A request is taken only if there is room for its replies.
        let next = if self.replies.slots() >= REPLIES_PER_REQUEST { self.requests.pop().ok() } else { None };
        let (number, request) = next.map_or((0, None), |next| (next.number, Some(next.request)));
        let output = self.controller.step(StepInput {
            late_cycles: self.pacing.late_cycles(),
            lost_cycles,
            restarted: std::mem::take(&mut self.restarted),
            ..StepInput::new(*self.pacing.measurement(), now, request)
        });
        let computed = monotonic_ns();
        self.command.write(output.command);
        self.command_seq = output.command.seq;
        self.answer = output.answer.map(|result| (number, result));
        self.retired = output.retired;
        (output.record, computed)
    }

    fn reply(&mut self, reply: Reply) {
        if let Err(rtrb::PushError::Full(reply)) = self.replies.push(reply) {
            // The ring is full only if the service thread has not read for many plans. Leaking a plan is better than freeing it here.
            std::mem::forget(reply);
        }
    }

    fn publish(&mut self, mut record: CycleRecord, overrun: bool) {
        if overrun {
            self.overruns += 1;
            record.telemetry.flags |= Telemetry::OVERRUN;
        }
        record.telemetry.degraded = self.degraded;
        record.overruns = self.overruns;
        if self.records.push(record).is_err() {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        // The answer follows the record: a thread that has read the answer can read the resulting state.
        if let Some((number, result)) = self.answer.take() {
            self.reply(Reply::Answer { number, result });
        }
        for plan in std::mem::take(&mut self.retired).into_iter().flatten() {
            self.reply(Reply::Retired(plan));
        }
    }
}
