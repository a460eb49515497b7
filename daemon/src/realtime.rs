//! The real-time thread: waits for the next cycle, lets the controller compute it, writes the command.
//!
//! Once started it neither allocates nor frees, and its only system calls are those that read the clock and sleep.
//! Everything comes and goes through wait-free rings ([`RealtimeLink`] holds the other ends).

use crate::controller::Controller;
use crate::step::{CycleRecord, Request, StepInput};
use crate::supervisor::Refusal;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use upswing_config::Config;
use upswing_ipc::{
    Command, CycleStart, CycleTimes, DaemonPacing, DaemonWake, Measurement, Reader, Telemetry, WriterEntry,
    monotonic_ns,
};
use upswing_trajectory::Plan;

/// Cycles that the service thread may be late to fetch: one second.
const RECORDS: usize = 8192;
/// Requests that may wait for the next cycle.
const REQUESTS: usize = 64;
/// Replies that one request can cause: an answer and two retired plans.
const REPLIES_PER_REQUEST: usize = 3;
/// Readers of restarted plants.
const READERS: usize = 8;

/// A request on its way to the controller, with the number under which it will be answered.
pub struct NumberedRequest {
    /// Unique for this daemon.
    pub number: u64,
    /// The request.
    pub request: Request,
}

/// A message from the controller to the service thread.
pub enum Reply {
    /// The answer to a request.
    Answer {
        /// Number of the request.
        number: u64,
        /// Why the request was refused, if it was.
        result: Result<(), Refusal>,
    },
    /// A plan to be freed.
    Retired(Box<Plan>),
}

/// Flags and counters that the real-time thread and the service thread share.
#[derive(Default)]
pub struct SharedFlags {
    /// Makes the real-time thread close the brakes and end.
    pub exit: AtomicBool,
    /// Whether requests wait for a measurement that may be long in coming (lockstep).
    pub stands_still: AtomicBool,
    /// Whether the plant is on clock `wall`: only then does the thread need real-time priority.
    pub real_time: AtomicBool,
    /// Whether the plant found last lives.
    pub plant_lives: AtomicBool,
    /// Records that did not fit into the ring.
    pub dropped: AtomicU64,
    /// Heartbeat of the real-time thread: moves on at least every 20 ms, whether or not there is a plant.
    pub beats: AtomicU64,
}

/// The service thread's connection to the real-time thread.
pub struct RealtimeLink {
    /// Requests to the controller, in order of arrival.
    pub requests: Producer<NumberedRequest>,
    /// Readers of newly found plants.
    pub readers: Producer<Reader<Measurement>>,
    /// Answers to requests, and plans to be freed.
    pub replies: Consumer<Reply>,
    /// One record per cycle.
    pub records: Consumer<CycleRecord>,
    /// Flags and counters that both threads share.
    pub shared: Arc<SharedFlags>,
}

/// The real-time thread with all that it owns.
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
    /// Bits of [`upswing_ipc::Degradation`].
    degraded: u64,
    command_seq: u64,
    /// Whether the plant has changed or restarted since the last step.
    restarted: bool,
    /// Answer to the request of this cycle.
    answer: Option<(u64, Result<(), Refusal>)>,
    /// Plans that the controller does not need any more.
    retired: [Option<Box<Plan>>; 2],
}

impl RealtimeThread {
    /// The thread, not yet started, and the connection of the service thread to it. Commands go to `command`.
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
            restarted: false,
            answer: None,
            retired: [None, None],
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

    /// Runs until the service thread raises `exit`; then closes the brakes. `degraded`: what the system refused of the
    /// real-time set-up, bits of [`upswing_ipc::Degradation`], for the records.
    pub fn run(mut self, degraded: u64) {
        self.degraded = degraded;
        let shared = Arc::clone(&self.shared);
        while let Some(wake) = self.pacing.wait(&shared.exit, &shared.plant_lives) {
            match wake {
                DaemonWake::Cycle(start) => self.cycle(start),
                DaemonWake::PlantLost { cycles } => self.step_between_cycles(cycles),
                // The sender of a request may know of a plant that was handed over just before.
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
            ..Command::default()
        });
    }

    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn adopt_reader(&mut self) {
        while let Ok(reader) = self.readers.pop() {
            // The finder of the service thread has the replaced reader open: dropping it only counts down.
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

    /// Steps the controller at the time `now` (CLOCK_MONOTONIC, ns) and writes the command. Returns the record, and when the
    /// command was computed.
    fn step(&mut self, now: u64, lost_cycles: u64) -> (CycleRecord, u64) {
        // A request is taken only if its replies have room.
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
            // Only if the service thread has not looked for many plans. Leaking one is better than freeing it here.
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
        // After the record: whoever sees the answer can see the state that followed.
        if let Some((number, result)) = self.answer.take() {
            self.reply(Reply::Answer { number, result });
        }
        for plan in std::mem::take(&mut self.retired).into_iter().flatten() {
            self.reply(Reply::Retired(plan));
        }
    }
}
