//! The other thread: finds the plant, answers requests, checks plans, publishes telemetry.

use crate::controller::{Order, Record};
use crate::os;
use crate::plan;
use crate::realtime::{Cycle, Ends, Report, Ticket};
use crate::supervisor::{Refusal, Request, is_braked};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};
use tracing::{error, info, warn};
use upswing_config::process::Failure;
use upswing_config::{Config, RealtimeMode};
use upswing_ipc::{
    ControlCommand, ControlRequest, ControlResponse, Domain, Finder, IpcError, Measurement, Mode, Node, Plan,
    Publisher, TELEMETRY_BATCH, TelemetryBatch, Text,
};

/// Pause of the loop.
const PAUSE: Duration = Duration::from_millis(1);
/// How often it looks for a new plant.
const LOOK: Duration = Duration::from_millis(30);
/// Oldest telemetry that waits for a batch to fill.
const FLUSH: Duration = Duration::from_millis(5);
/// How long a request waits for the real-time thread; and where time stands still (lockstep), where the answer cannot
/// come before the plant is told to advance.
const ANSWER: Duration = Duration::from_millis(200);
const ANSWER_IN_STANDSTILL: Duration = Duration::from_millis(20);
/// How long a shutdown waits for the arm to come to rest; and for a sign of life of the plant.
const SHUTDOWN: Duration = Duration::from_secs(3);
const SIGN_OF_LIFE: Duration = Duration::from_millis(200);

/// Runs the daemon in `domain` until `shutdown` is raised, then brings the arm to rest and closes the brakes.
///
/// # Errors
/// [`Failure::Failed`] if the domain cannot be used, if it has a daemon already, or if real-time scheduling is refused
/// where the settings insist on it.
pub fn serve(config: &Config, domain: &Domain, shutdown: &AtomicBool) -> Result<(), Failure> {
    // Before anything is mapped, so that nothing of it faults later.
    let memory = os::lock_memory();
    let node = domain.connect("daemon").map_err(failed)?;
    // The only server of its kind, so it also keeps a second daemon out.
    let server = node.control_server().map_err(|e| match e {
        IpcError::Taken { .. } => Failure::Failed(format!("domain `{domain}` has a daemon already ({e})")),
        e => failed(e),
    })?;
    // The ports outlive the entry in the real-time thread, which is joined below.
    let (command, _ports) = node.command_writer().map_err(failed)?.split();
    let (cycle, ends) = Cycle::new(config, command);
    let mut desk = Desk::new(config, &node, ends)?;
    let thread = start_thread(config, cycle, memory, &mut desk)?;
    info!("daemon ready in domain `{domain}`, model {:016x}", config.model.fingerprint());

    let result = desk.work(&node, &server, shutdown, &thread);
    desk.ends.shared.exit.store(true, Ordering::Release);
    let joined = thread.join();
    desk.fetch();
    desk.flush();
    joined.map_err(|_| Failure::Failed("the real-time thread panicked".into())).and(result)
}

/// Starts the real-time thread; it has its priority and CPU when this returns.
fn start_thread(
    config: &Config,
    cycle: Cycle,
    memory: Result<(), String>,
    desk: &mut Desk<'_>,
) -> Result<JoinHandle<()>, Failure> {
    let settings = config.daemon.realtime;
    let (tell, told) = mpsc::channel();
    let body = move || {
        let refused: Vec<String> =
            [memory, os::make_realtime(&settings)].into_iter().filter_map(Result::err).collect();
        let go = refused.is_empty() || settings.mode == RealtimeMode::Warn;
        let heard = tell.send(refused.join(", "));
        drop(tell);
        if go && heard.is_ok() {
            cycle.run();
        }
    };
    let thread = Builder::new()
        .name("realtime".into())
        .spawn(body)
        .map_err(|e| Failure::Failed(format!("cannot start the real-time thread: {e}")))?;
    let refused = told.recv().map_err(|_| Failure::Failed("the real-time thread did not start".into()))?;
    desk.degraded = !refused.is_empty();
    if desk.degraded {
        if settings.mode == RealtimeMode::Strict {
            return Err(Failure::Failed(format!(
                "realtime.mode is strict, but the system refuses {refused}"
            )));
        }
        warn!("degraded, cycles may be late: the system refuses {refused}");
    }
    Ok(thread)
}

fn failed(e: IpcError) -> Failure {
    Failure::Failed(e.to_string())
}

/// What the thread knows and has to hand.
struct Desk<'a> {
    config: &'a Config,
    ends: Ends,
    plants: Finder<Measurement>,
    next_look: Instant,
    telemetry: Publisher<TelemetryBatch>,
    batch: Box<TelemetryBatch>,
    /// When the batch got its first record.
    batch_begin: Instant,
    /// The newest record.
    newest: Option<Record>,
    /// When a record last told of a new measurement.
    sign_of_life: Instant,
    degraded: bool,
    tickets: u64,
    /// Number of the ticket that somebody waits for (0: nobody), and its answer.
    awaited: u64,
    answer: Option<Result<(), Refusal>>,
    /// Id of the plan given to the controller last, 0: none.
    loaded: u64,
    last_refusal: String,
    last_complaint: String,
}

impl<'a> Desk<'a> {
    fn new(config: &'a Config, node: &Node, ends: Ends) -> Result<Self, Failure> {
        Ok(Self {
            config,
            ends,
            plants: node.measurement_finder(),
            next_look: Instant::now(),
            telemetry: node.telemetry_publisher().map_err(failed)?,
            batch: TelemetryBatch::boxed_zeroed(),
            batch_begin: Instant::now(),
            newest: None,
            sign_of_life: Instant::now(),
            degraded: false,
            tickets: 0,
            awaited: 0,
            answer: None,
            loaded: 0,
            last_refusal: String::new(),
            last_complaint: String::new(),
        })
    }

    /// The loop, until the process may end.
    fn work(
        &mut self,
        node: &Node,
        server: &upswing_ipc::Server<ControlRequest>,
        shutdown: &AtomicBool,
        thread: &JoinHandle<()>,
    ) -> Result<(), Failure> {
        let plans = node.plan_subscriber().map_err(failed)?;
        let mut shutdown_begin = None;
        while !thread.is_finished() {
            if self.next_look <= Instant::now() {
                self.look();
            }
            match plans.receive() {
                // A copy: the planner could change the plan while it is being checked.
                Ok(Some(sample)) => self.load(&sample.boxed_copy()),
                Ok(None) => {}
                Err(e) => self.complain(e.to_string()),
            }
            if let Err(e) = server.poll(|request| self.handle(request)) {
                self.complain(e.to_string());
            }
            self.fetch();
            if self.batch.count > 0 && self.batch_begin.elapsed() >= FLUSH {
                self.flush();
            }
            if shutdown.load(Ordering::Acquire) && self.may_exit(&mut shutdown_begin) {
                return Ok(());
            }
            sleep(PAUSE);
        }
        Err(Failure::Failed("the real-time thread ended".into()))
    }

    /// Looks for a plant that started after the one found last.
    fn look(&mut self) {
        self.next_look = Instant::now() + LOOK;
        match self.plants.poll() {
            Ok(Some(reader)) => {
                info!("found a plant, started at {} ns", reader.epoch());
                if self.ends.readers.push(reader).is_err() {
                    self.complain(
                        "the real-time thread does not take the measurements of a new plant".into(),
                    );
                }
            }
            Ok(None) => {}
            Err(e) => self.complain(e.to_string()),
        }
    }

    /// Whether a process that shall end may do so: the brakes hold, or waiting is no use.
    fn may_exit(&mut self, begin: &mut Option<Instant>) -> bool {
        if is_braked(self.mode()) {
            return true;
        }
        let begin = *begin.get_or_insert_with(|| {
            info!("shutting down");
            if self.order(Order::Do(Request::Shutdown)).is_none() {
                self.complain("the real-time thread does not take the order to shut down".into());
            }
            Instant::now()
        });
        let silence = self.sign_of_life.max(begin).elapsed();
        if silence > SIGN_OF_LIFE {
            warn!("closing the brakes: the plant is gone, or stands still");
        } else if begin.elapsed() > SHUTDOWN {
            warn!("closing the brakes: the arm does not come to rest");
        }
        silence > SIGN_OF_LIFE || begin.elapsed() > SHUTDOWN
    }

    fn mode(&self) -> Mode {
        self.newest.and_then(|record| record.telemetry.mode().ok()).unwrap_or(Mode::Idle)
    }

    /// Answers a request of the operator.
    fn handle(&mut self, request: &ControlRequest) -> ControlResponse {
        let request = match request.command() {
            Ok(ControlCommand::Status) => {
                self.fetch();
                return self.respond(true, &self.remark());
            }
            Ok(ControlCommand::Enable) => Request::Enable,
            Ok(ControlCommand::Hold) => Request::Hold,
            Ok(ControlCommand::Start) => Request::Start,
            Ok(ControlCommand::Stop) => Request::Stop,
            Ok(ControlCommand::Reset) => Request::Reset,
            Err(unknown) => return self.respond(false, &unknown.to_string()),
        };
        match self.ask(request) {
            Ok(remark) => self.respond(true, remark),
            Err(reason) => {
                warn!("{request} refused: {reason}");
                self.last_refusal = format!("{request}: {reason}");
                self.respond(false, &reason)
            }
        }
    }

    /// Orders `request` and waits for the answer of the real-time thread: a remark, or the reason of the refusal.
    fn ask(&mut self, request: Request) -> Result<&'static str, String> {
        let begin = Instant::now();
        // Who starts a plant and enables at once means that plant.
        while request == Request::Enable && self.plants.epoch().is_none() && begin.elapsed() < ANSWER {
            self.look();
            sleep(PAUSE);
        }
        self.awaited = self.order(Order::Do(request)).ok_or("too many orders wait for the next cycle")?;
        self.answer = None;
        let begin = Instant::now();
        loop {
            self.fetch();
            match self.answer.take() {
                Some(Ok(())) => {
                    self.last_refusal.clear();
                    return Ok("");
                }
                Some(Err(refusal)) => return Err(refusal.to_string()),
                None => {}
            }
            let stands_still = self.ends.shared.stands_still.load(Ordering::Acquire);
            if stands_still && begin.elapsed() > ANSWER_IN_STANDSTILL {
                self.awaited = 0;
                return Ok("queued until the next cycle");
            }
            if begin.elapsed() > ANSWER {
                self.awaited = 0;
                return Err("the real-time thread does not answer; the request may still take effect".into());
            }
            sleep(Duration::from_micros(50));
        }
    }

    /// Hands an order to the real-time thread: the number of its ticket, or `None` if it takes no more.
    fn order(&mut self, order: Order) -> Option<u64> {
        self.tickets += 1;
        self.ends.orders.push(Ticket { number: self.tickets, order }).ok()?;
        Some(self.tickets)
    }

    fn load(&mut self, payload: &Plan) {
        let result =
            plan::accept(payload, self.config).map_err(|refusal| refusal.to_string()).and_then(|plan| {
                self.order(Order::Load(plan))
                    .map(|_| ())
                    .ok_or_else(|| "too many orders wait for the next cycle".into())
            });
        match result {
            Ok(()) => {
                info!("plan {} loaded, t_F = {:.3} s", payload.id, payload.t_f);
                self.loaded = payload.id;
                self.last_refusal.clear();
            }
            Err(reason) => {
                warn!("plan {} refused: {reason}", payload.id);
                self.last_refusal = format!("plan {}: {reason}", payload.id);
            }
        }
    }

    /// What there is to say about the state: the cause of a fault or stop, the last refusal.
    fn remark(&self) -> String {
        let trip = self.newest.and_then(|record| record.trip).map(|trip| format!("gave up: {trip}"));
        let refusal =
            Some(&self.last_refusal).filter(|text| !text.is_empty()).map(|text| format!("refused {text}"));
        trip.into_iter().chain(refusal).collect::<Vec<_>>().join("; ")
    }

    fn respond(&self, accepted: bool, reason: &str) -> ControlResponse {
        let record = self.newest;
        let telemetry = record.map(|record| record.telemetry).unwrap_or_default();
        ControlResponse {
            accepted: u64::from(accepted),
            mode: self.mode().code(),
            fault: telemetry.fault,
            plan_id: self.loaded,
            running_plan: telemetry.plan_id,
            seq: telemetry.seq,
            degraded: u64::from(self.degraded),
            overruns: record.map_or(0, |record| record.overruns),
            reason: Text::new(reason),
        }
    }

    /// Takes in all that came from the real-time thread.
    fn fetch(&mut self) {
        // Reports first: the record that belongs to a report is in its ring before the report is.
        while let Ok(report) = self.ends.reports.pop() {
            match report {
                Report::Answer { number, result } if number == self.awaited => self.answer = Some(result),
                Report::Answer { result: Err(refusal), .. } => {
                    warn!("queued order refused: {refusal}");
                    self.last_refusal = format!("queued order: {refusal}");
                }
                Report::Answer { .. } => {}
                Report::Garbage(plan) => drop(plan),
            }
        }
        while let Ok(record) = self.ends.records.pop() {
            self.note(record);
        }
    }

    fn note(&mut self, record: Record) {
        let before = self.mode();
        let (last_seq, last_measured) =
            self.newest.map_or((0, 0), |r| (r.telemetry.seq, r.telemetry.measurement_seq));
        self.newest = Some(record);
        if record.telemetry.measurement_seq != last_measured {
            self.sign_of_life = Instant::now();
        }
        let mode = self.mode();
        if mode != before {
            match record.trip {
                Some(trip) if mode == Mode::Fault => error!("{before} -> {mode}: {trip}"),
                Some(trip) if mode == Mode::Stop => warn!("{before} -> {mode}: {trip}"),
                _ => info!("{before} -> {mode}"),
            }
        }
        // Orders between cycles give a record too, but that is no cycle.
        if record.telemetry.seq != last_seq {
            if self.batch.count == 0 {
                self.batch_begin = Instant::now();
            }
            self.batch.push(record.telemetry);
            if self.batch.used().len() == TELEMETRY_BATCH {
                self.flush();
            }
        }
    }

    fn flush(&mut self) {
        if self.batch.count == 0 {
            return;
        }
        self.batch.dropped = self.ends.shared.dropped.load(Ordering::Relaxed);
        if let Err(e) = self.telemetry.publish(&self.batch) {
            self.complain(e.to_string());
        }
        self.batch.clear();
    }

    /// Logs a trouble that persists once.
    fn complain(&mut self, trouble: String) {
        if trouble != self.last_complaint {
            warn!("{trouble}");
            self.last_complaint = trouble;
        }
    }
}
