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
use std::time::Duration;
use upswing_config::Config;
use upswing_ipc::{
    Clock, Command, Measurement, Reader, Telemetry, WriterEntry, is_lost, monotonic_ns, sleep_until,
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

/// How long one look for a measurement lasts, ns; then the thread sees whether there is something else to do.
const LOOK_NS: u64 = 10_000_000;
/// On lockstep, by the time already waited, ns: up to these it spins, then naps ever longer.
const SPIN_NS: u64 = 10_000;
const SHORTEST_NAPS_NS: u64 = 60_000;
const SHORT_NAPS_NS: u64 = 5_000_000;
const SHORTEST_NAP_NS: u64 = 5_000;
const SHORT_NAP_NS: u64 = 25_000;
const LONG_NAP_NS: u64 = 500_000;
/// On paced it sleeps until this share of a period before the next measurement is due; a nap is then this share of a
/// period, and of the time already waited.
const EARLY_SHARE: u64 = 16;
const NAP_SHARE: u64 = 8;
/// Longest time that one nap counts for, ns: a machine that has no time for this thread has none for the plant either.
const LONGEST_NAP_NS: u64 = 1_000_000;

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
    command: WriterEntry<Command>,
    reader: Option<Reader<Measurement>>,
    /// The newest measurement.
    measurement: Measurement,
    requests: Consumer<NumberedRequest>,
    readers: Consumer<Reader<Measurement>>,
    replies: Producer<Reply>,
    records: Producer<CycleRecord>,
    shared: Arc<SharedFlags>,
    period_ns: u64,
    /// How long the newest measurement has been waited for, not counting when this thread could not run, ns.
    waited_ns: u64,
    overruns: u64,
    /// Cycles in a row that ended late.
    late: u64,
    /// Bits of [`upswing_ipc::Degradation`].
    degraded: u64,
    command_seq: u64,
    /// Whether the plant has changed or restarted since the last step.
    restarted: bool,
    /// Cycles without a measurement, in the step in which the plant counts as lost; otherwise 0.
    lost_cycles: u64,
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
            command,
            reader: None,
            measurement: Measurement::default(),
            requests,
            readers,
            replies,
            records,
            shared: Arc::clone(&shared),
            period_ns: config.daemon.cycle.period.nanos(),
            waited_ns: 0,
            overruns: 0,
            late: 0,
            degraded: 0,
            command_seq: 0,
            restarted: false,
            lost_cycles: 0,
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

    /// Runs until it is told to exit; then closes the brakes. `degraded`: what the system refused, for the records.
    pub fn run(mut self, degraded: u64) {
        self.degraded = degraded;
        let mut deadline = None;
        let mut lost = false;
        while !self.shared.exit.load(Ordering::Acquire) {
            self.shared.beats.fetch_add(1, Ordering::Relaxed);
            self.adopt_reader();
            let clock = self.clock();
            // Requests wait for the next measurement, in order of arrival: on lockstep, where time may stand still for
            // as long as it likes, and before the first one of a plant, which may be on lockstep.
            let stands_still =
                clock == Some(Clock::Lockstep) || (self.reader.is_some() && self.measurement.seq == 0);
            self.shared.stands_still.store(stands_still, Ordering::Release);
            self.shared.real_time.store(clock == Some(Clock::Wall), Ordering::Relaxed);
            if clock == Some(Clock::Wall) {
                let planned = deadline.unwrap_or_else(monotonic_ns);
                sleep_until(planned);
                deadline = Some(self.wall_cycle(planned));
                self.waited_ns = 0;
                continue;
            }
            deadline = None;
            if self.wait_for_measurement(clock) {
                (self.waited_ns, lost) = (0, false);
                self.answer_measurement();
                continue;
            }
            if stands_still {
                continue;
            }
            let lives = self.shared.plant_lives.load(Ordering::Relaxed);
            let newly_lost =
                !lost && self.measurement.seq > 0 && is_lost(lives, Duration::from_nanos(self.waited_ns));
            if newly_lost {
                lost = true;
                self.lost_cycles = self.waited_ns / self.period_ns;
            }
            // The sender of a request may know of a plant that was handed over just before.
            if newly_lost || (!self.requests.is_empty() && self.readers.is_empty()) {
                self.compute(monotonic_ns());
            }
        }
        let last = self.reader.as_ref().map_or(0, |reader| reader.read().seq);
        self.command.write(Command {
            seq: self.command_seq + 1,
            t_ns: monotonic_ns(),
            measurement_seq: last,
            brake: 1,
            ..Command::default()
        });
    }

    /// The clock of the plant, once it has shown one.
    fn clock(&self) -> Option<Clock> {
        if self.measurement.period_ns == 0 { None } else { self.measurement.clock().ok() }
    }

    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn adopt_reader(&mut self) {
        while let Ok(reader) = self.readers.pop() {
            self.restarted |= self.reader.is_some();
            self.measurement = reader.read();
            // Its seq must count as new.
            self.measurement.seq = 0;
            // The finder of the service thread has the old one open: this only counts down.
            self.reader = Some(reader);
            self.waited_ns = 0;
        }
    }

    /// Computes the cycle planned for `planned` (CLOCK_MONOTONIC, ns) on the wall clock; returns when the next one
    /// is planned: a whole number of periods later, so that a late cycle does not shift all others.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn wall_cycle(&mut self, planned: u64) -> u64 {
        let started = monotonic_ns();
        if let Some(reader) = &self.reader {
            self.measurement = reader.read();
        }
        let read = monotonic_ns();
        let (mut record, computed) = self.compute_timed(planned);
        let written = monotonic_ns();
        let telemetry = &mut record.telemetry;
        telemetry.wake_ns = started.saturating_sub(planned);
        telemetry.read_ns = read - started;
        telemetry.compute_ns = computed - read;
        telemetry.write_ns = written - computed;
        let periods = written.saturating_sub(planned) / self.period_ns;
        self.publish(record, periods > 0);
        planned + (periods + 1) * self.period_ns
    }

    /// Computes the cycle that answers the measurement just read, on the paced and lockstep clocks.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn answer_measurement(&mut self) {
        let clock = self.clock();
        let started = monotonic_ns();
        let (mut record, computed) = self.compute_timed(started);
        let written = monotonic_ns();
        // On lockstep equal runs give equal records: no times.
        if clock != Some(Clock::Lockstep) {
            let telemetry = &mut record.telemetry;
            telemetry.compute_ns = computed - started;
            telemetry.write_ns = written - computed;
        }
        let late = clock == Some(Clock::Paced) && written - started > self.period_ns;
        self.publish(record, late);
    }

    /// A step between cycles, without a new measurement, to answer a request or to notice that the plant is lost.
    #[cfg_attr(rtsan, sanitize(realtime = "nonblocking"))]
    fn compute(&mut self, now: u64) {
        let (record, _) = self.compute_timed(now);
        self.publish(record, false);
    }

    /// Steps the controller and writes the command; the record, and the time between the two.
    fn compute_timed(&mut self, now: u64) -> (CycleRecord, u64) {
        // A request is taken only if its replies have room.
        let next = if self.replies.slots() >= REPLIES_PER_REQUEST { self.requests.pop().ok() } else { None };
        let (number, request) = next.map_or((0, None), |next| (next.number, Some(next.request)));
        let output = self.controller.step(StepInput {
            late_cycles: self.late,
            lost_cycles: std::mem::take(&mut self.lost_cycles),
            restarted: std::mem::take(&mut self.restarted),
            ..StepInput::new(self.measurement, now, request)
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
        // Where the plant waits for the answer a slow machine does no harm.
        self.late = if overrun && self.clock() == Some(Clock::Wall) { self.late + 1 } else { 0 };
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

    /// Waits until the plant shows a measurement with another number, at most [`LOOK_NS`]; whether it did.
    fn wait_for_measurement(&mut self, clock: Option<Clock>) -> bool {
        let begin = monotonic_ns();
        let Some(reader) = &self.reader else {
            sleep_until(begin + LONG_NAP_NS);
            return false;
        };
        let mut last = begin;
        // The plant keeps its period: until the next measurement is due there is nothing to look for.
        if clock == Some(Clock::Paced) && self.waited_ns == 0 {
            sleep_until(begin + self.period_ns - self.period_ns / EARLY_SHARE);
        }
        loop {
            let measurement = reader.read();
            if measurement.seq != self.measurement.seq {
                self.measurement = measurement;
                return true;
            }
            // What is there before the first measurement tells the clock.
            self.measurement = measurement;
            let now = monotonic_ns();
            self.waited_ns += (now - last).min(LONGEST_NAP_NS);
            last = now;
            if now - begin > LOOK_NS || self.shared.exit.load(Ordering::Relaxed) {
                return false;
            }
            let nap = match (clock, self.waited_ns) {
                (Some(Clock::Paced), waited) => {
                    (waited / NAP_SHARE).clamp(self.period_ns / NAP_SHARE, LONG_NAP_NS)
                }
                (_, ..SPIN_NS) => 0,
                (_, ..SHORTEST_NAPS_NS) => SHORTEST_NAP_NS,
                (_, ..SHORT_NAPS_NS) => SHORT_NAP_NS,
                _ => LONG_NAP_NS,
            };
            if nap == 0 {
                std::hint::spin_loop();
            } else {
                sleep_until(now + nap);
            }
        }
    }
}
