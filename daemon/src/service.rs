//! Service thread of the daemon, without real-time constraints: answers requests, checks plans, publishes telemetry, finds
//! plants. It never waits for other processes, so that a request to stop the arm is answered at once.

use crate::cycle_log::CycleLog;
use crate::os::{self, RefusedSetting};
use crate::plan::{self, PlanRefusal};
use crate::realtime::{NumberedRequest, RealtimeLink, RealtimeThread, Reply};
use crate::recovery::{Recovery, RecoveryAction};
use crate::sent_plans::SentPlans;
use crate::step::{CycleRecord, DroppedPlan, StepRequest};
use crate::supervisor::{RequestRefusal, is_braked};
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};
use tracing::{debug, info, warn};
use upswing_config::{Config, RealtimeMode};
use upswing_ipc::operator::{OperatorError, PublishedPlan, request_plan};
use upswing_ipc::{
    Command, ControlKind, ControlRequest, ControlResponse, Degradation, Domain, FinderThread, IpcError,
    ManoeuvreRequest, Measurement, Mode, Node, PlanHeader, PlanMessage, PlannerRequest, Reader, Text,
};
use upswing_model::Posture;
use upswing_process::Failure;
use upswing_process::notify::Notifier;

/// Pause between two passes of the loop.
const PAUSE: Duration = Duration::from_millis(1);
/// Longest wait for the real-time thread's answer to a request; and while the clock `lockstep` stands still, when the answer
/// cannot come before the plant is told to advance.
const ANSWER: Duration = Duration::from_millis(200);
const ANSWER_IN_STANDSTILL: Duration = Duration::from_millis(20);
/// Longest wait at a shutdown for the arm to come to rest; and for a new measurement of the plant.
const SHUTDOWN: Duration = Duration::from_secs(3);
const SIGN_OF_LIFE: Duration = Duration::from_millis(200);

/// Runs the daemon in `domain` until `shutdown` is set, then brings the arm to rest and closes the brakes.
///
/// # Errors
/// [`Failure::Failed`] if the domain cannot be used or already has a daemon, if the real-time thread cannot start or ends, or
/// if the system refuses real-time settings although `realtime.mode` is `strict`.
pub fn serve(config: &Config, domain: &Domain, shutdown: &AtomicBool) -> Result<(), Failure> {
    // Before any memory is claimed: too little of it later kills the process without a message.
    Domain::check_limits().map_err(Failure::failed)?;
    // Before anything is mapped, so that no page of it faults later.
    let (_prepared, refused) = os::prepare_process();
    let node = domain.join("daemon").map_err(Failure::failed)?;
    // A domain has one server of this kind, so that it also excludes a second daemon.
    let server = node.server::<ControlRequest>().map_err(|e| match e {
        IpcError::Taken { .. } => Failure::Failed(format!("domain `{domain}` has a daemon already ({e})")),
        e => Failure::failed(e),
    })?;
    // The ports outlive the entry in the real-time thread, which is joined below.
    let (command, _ports) = node.writer::<Command>().map_err(Failure::failed)?.split();
    let (realtime, link) = RealtimeThread::new(config, command);
    let mut service = ServiceThread::new(config, &node, link)?;
    let thread = start_thread(config, realtime, refused, &mut service)?;
    info!("daemon ready in domain `{domain}`, model {:016x}", config.model.fingerprint());

    let result = service.run(&server, shutdown, &thread);
    service.manager.stopping();
    service.link.shared.exit.store(true, Ordering::Release);
    let joined = thread.join();
    service.closing.store(true, Ordering::Release);
    if let Some(asker) = service.asker.take() {
        let _ = asker.join();
    }
    service.fetch();
    let flushed = service.log.flush(service.dropped());
    service.warn_of_error(flushed);
    joined.map_err(|_| Failure::Failed("the real-time thread panicked".into())).and(result)
}

/// Starts the real-time thread, and returns once its priority and CPU are set. `refused`: settings that the system has refused
/// so far.
fn start_thread(
    config: &Config,
    realtime: RealtimeThread,
    mut refused: Vec<RefusedSetting>,
    service: &mut ServiceThread<'_>,
) -> Result<JoinHandle<()>, Failure> {
    let settings = config.daemon.realtime;
    let (tell, told) = mpsc::channel();
    let body = move || {
        refused.extend(os::prepare_thread(&settings));
        let degraded = refused.iter().fold(0, |bits, refused| bits | refused.degradation().bit());
        let go = refused.is_empty() || settings.mode == RealtimeMode::Warn;
        let heard = tell.send((os::thread_id(), degraded, refused));
        drop(tell);
        if go && heard.is_ok() {
            realtime.run(degraded);
        }
    };
    let thread = Builder::new()
        .name("realtime".into())
        .spawn(body)
        .map_err(|e| Failure::Failed(format!("cannot start the real-time thread: {e}")))?;
    let (tid, degraded, refused) =
        told.recv().map_err(|_| Failure::Failed("the real-time thread did not start".into()))?;
    service.degraded = degraded;
    service.threads =
        [(tid, settings.priority), (os::thread_id(), settings.priority.saturating_sub(1).max(1))];
    if degraded != 0 {
        let reasons = refused.iter().map(RefusedSetting::to_string).collect::<Vec<_>>().join(", ");
        if settings.mode == RealtimeMode::Strict {
            return Err(Failure::Failed(format!(
                "realtime.mode is strict, but the system refuses {reasons}"
            )));
        }
        warn!("degraded, cycles may be late: the system refuses {reasons}");
    }
    service.log.watch(tid);
    Ok(thread)
}

/// Reason for which a request to the real-time thread has no effect, or no known effect.
#[derive(Debug, thiserror::Error)]
enum ControlRequestError {
    /// The controller refused the request, in words.
    #[error("{0}")]
    Refused(String),
    /// The plan fails a check.
    #[error(transparent)]
    Plan(#[from] PlanRefusal),
    /// The ring of requests to the real-time thread is full.
    #[error("too many requests wait for the next cycle")]
    TooMany,
    /// No answer came within [`ANSWER`].
    #[error("the real-time thread does not answer; the request may still take effect")]
    NoAnswer,
}

/// The service thread, with all data that it owns.
struct ServiceThread<'a> {
    config: &'a Config,
    node: Node,
    link: RealtimeLink,
    plants: FinderThread<Measurement>,
    /// Whether a plant was found.
    found: bool,
    waiting: Option<Reader<Measurement>>,
    /// Ids of the real-time thread and the service thread, with their priorities on the clock `wall`.
    threads: [(u32, u8); 2],
    prioritised: bool,
    log: CycleLog<'a>,
    manager: Notifier,
    /// Heartbeat of the real-time thread of which the service manager was last notified.
    beats: u64,
    /// Mode of which the service manager was last notified.
    mode_told: Option<Mode>,
    recovery: Recovery,
    /// Thread that asks the planner for a recovery plan.
    asker: Option<JoinHandle<Result<PublishedPlan, OperatorError>>>,
    /// Tells this thread that its answer is no longer needed.
    closing: Arc<AtomicBool>,
    /// Degradations, bits of [`upswing_ipc::Degradation`].
    degraded: u64,
    requests: u64,
    /// Number of the request whose answer an operator waits for; 0: none.
    awaited: u64,
    answer: Option<Result<(), RequestRefusal>>,
    sent_plans: SentPlans,
    last_refusal: String,
    last_complaint: String,
}

impl<'a> ServiceThread<'a> {
    fn new(config: &'a Config, node: &Node, link: RealtimeLink) -> Result<Self, Failure> {
        Ok(Self {
            config,
            node: node.clone(),
            link,
            plants: FinderThread::start(node)
                .map_err(|e| Failure::Failed(format!("cannot start a thread: {e}")))?,
            found: false,
            waiting: None,
            threads: [(0, 1); 2],
            prioritised: false,
            log: CycleLog::new(config, node).map_err(Failure::failed)?,
            manager: Notifier::new(),
            beats: 0,
            mode_told: None,
            recovery: Recovery::new(config.daemon.recovery, *config.model.order()),
            asker: None,
            closing: Arc::default(),
            degraded: 0,
            requests: 0,
            awaited: 0,
            answer: None,
            sent_plans: SentPlans::default(),
            last_refusal: String::new(),
            last_complaint: String::new(),
        })
    }

    /// Runs the loop until the process may end.
    fn run(
        &mut self,
        server: &upswing_ipc::Server<ControlRequest>,
        shutdown: &AtomicBool,
        thread: &JoinHandle<()>,
    ) -> Result<(), Failure> {
        let plans = self.node.subscriber::<PlanMessage>().map_err(Failure::failed)?;
        let mut shutdown_begin = None;
        while !thread.is_finished() {
            self.find_plant();
            self.set_priorities();
            match plans.receive() {
                // The plan is copied: the planner could change it while it is being checked.
                Ok(Some(sample)) => match sample.copied() {
                    Ok(message) => self.load(&message),
                    Err(damaged) => self.refuse_plan(sample.header().id, &damaged),
                },
                Ok(None) => {}
                Err(e) => self.warn_once(e),
            }
            if let Err(e) = server.poll(|request| self.handle(request)) {
                self.warn_once(e);
            }
            self.fetch();
            self.receive_plan();
            let published = self.log.publish_due(self.dropped());
            self.warn_of_error(published);
            self.tell_manager();
            if shutdown.load(Ordering::Acquire) && self.may_exit(&mut shutdown_begin) {
                return Ok(());
            }
            sleep(PAUSE);
        }
        Err(Failure::Failed("the real-time thread ended".into()))
    }

    /// Passes the reader of a plant that was found to the real-time thread, once there is room in its ring.
    fn find_plant(&mut self) {
        self.link.shared.plant_lives.store(self.plants.writer_is_alive(), Ordering::Relaxed);
        match self.plants.poll() {
            Ok(Some(reader)) => {
                info!("found a plant, started at {} ns", reader.epoch());
                // The first read maps its memory here, not in the real-time thread.
                reader.read();
                (self.found, self.waiting) = (true, Some(reader));
            }
            Ok(None) => {}
            Err(e) => self.warn_once(e),
        }
        if let Some(reader) = self.waiting.take()
            && let Err(rtrb::PushError::Full(reader)) = self.link.readers.push(reader)
        {
            self.waiting = Some(reader);
            self.warn_once("the real-time thread does not take the measurements of a new plant");
        }
    }

    /// Gives both threads their real-time priorities on the clock `wall`, and only there: on other clocks the plant waits for the
    /// daemon, and other programs need the CPU. The service thread has a lower priority than the real-time thread, but a real-time
    /// one: an operator's stop does not wait for other programs.
    fn set_priorities(&mut self) {
        let wanted = self.link.shared.real_time.load(Ordering::Relaxed);
        if wanted == self.prioritised || self.degraded & Degradation::Scheduler.bit() != 0 {
            return;
        }
        self.prioritised = wanted;
        for (thread, priority) in self.threads {
            if let Err(e) = os::set_priority(thread, wanted.then_some(priority)) {
                self.warn_once(format_args!("cannot change the priority of thread {thread}: {e}"));
            }
        }
    }

    /// Notifies the service manager of the real-time thread's state, with a heartbeat only if the real-time thread had one.
    fn tell_manager(&mut self) {
        let beats = self.link.shared.beats.load(Ordering::Relaxed);
        if beats != self.beats {
            self.beats = beats;
            self.manager.alive();
        }
        let good = |record: &CycleRecord| record.telemetry.measurement_seq > 0 && record.telemetry.fault == 0;
        if self.log.newest.as_ref().is_some_and(good) {
            self.manager.ready();
        } else if self.mode_told.is_none() {
            self.manager.status("waits for a plant");
            return;
        }
        let mode = self.log.mode();
        if self.mode_told.replace(mode) != Some(mode) {
            let remark = Some(self.log.remark()).filter(|text| !text.is_empty());
            self.manager.status(&remark.map_or(mode.to_string(), |remark| format!("{mode}: {remark}")));
        }
    }

    /// Whether a daemon that shuts down may exit: the brakes hold, the plant is gone, or the arm does not come to rest.
    fn may_exit(&mut self, begin: &mut Option<Instant>) -> bool {
        if is_braked(self.log.mode()) {
            return true;
        }
        let begin = *begin.get_or_insert_with(|| {
            info!("shutting down");
            self.manager.stopping();
            self.recovery.yield_to_operator();
            if self.send(StepRequest::Shutdown).is_err() {
                self.warn_once("the real-time thread does not take the request to shut down");
            }
            Instant::now()
        });
        let why = if self.log.sign_of_life.max(begin).elapsed() > SIGN_OF_LIFE {
            "the plant is gone, or stands still"
        } else if begin.elapsed() > SHUTDOWN {
            "the arm does not come to rest"
        } else {
            return false;
        };
        warn!("closing the brakes: {why}");
        true
    }

    /// Handles a request of the operator.
    fn handle(&mut self, request: &ControlRequest) -> ControlResponse {
        let request = match request.kind() {
            Ok(ControlKind::Status) => {
                self.fetch();
                return self.respond(true, &self.remark());
            }
            Ok(ControlKind::Enable) => StepRequest::Enable,
            Ok(ControlKind::Hold) => StepRequest::Hold,
            Ok(ControlKind::Start) => StepRequest::Start(request.plan_id),
            Ok(ControlKind::Stop) => StepRequest::Stop,
            Ok(ControlKind::Reset) => StepRequest::Reset,
            Err(unknown) => return self.respond(false, &unknown.to_string()),
        };
        self.recovery.yield_to_operator();
        let asked = self.ask(&request);
        // A loss of balance found meanwhile is the operator's to handle, too.
        self.recovery.yield_to_operator();
        match asked {
            Ok(remark) => {
                if matches!(request, StepRequest::Enable | StepRequest::Start(_) | StepRequest::Reset) {
                    self.log.forget_warnings();
                }
                self.respond(true, remark)
            }
            Err(reason) => {
                warn!("{request} refused: {reason}");
                self.last_refusal = format!("{request}: {reason}");
                self.respond(false, &reason.to_string())
            }
        }
    }

    /// Sends `request` and waits for the answer of the real-time thread. Returns a remark, or the reason for the refusal.
    fn ask(&mut self, request: &StepRequest) -> Result<&'static str, ControlRequestError> {
        let begin = Instant::now();
        // An enable right after the start of a plant is meant for this plant.
        while *request == StepRequest::Enable && !self.found && begin.elapsed() < ANSWER {
            self.find_plant();
            sleep(PAUSE);
        }
        self.awaited = self.send(request.clone())?;
        self.answer = None;
        let begin = Instant::now();
        loop {
            self.fetch();
            match self.answer.take() {
                Some(Ok(())) => {
                    self.last_refusal.clear();
                    return Ok("");
                }
                Some(Err(refusal)) => {
                    return Err(ControlRequestError::Refused(refusal.text(&self.config.model)));
                }
                None => {}
            }
            let stands_still = self.link.shared.stands_still.load(Ordering::Acquire);
            if stands_still && begin.elapsed() > ANSWER_IN_STANDSTILL {
                self.awaited = 0;
                return Ok("queued until the next cycle");
            }
            if begin.elapsed() > ANSWER {
                self.awaited = 0;
                return Err(ControlRequestError::NoAnswer);
            }
            sleep(Duration::from_micros(50));
        }
    }

    /// Sends a request to the real-time thread; returns the number of the request.
    fn send(&mut self, request: StepRequest) -> Result<u64, ControlRequestError> {
        self.requests += 1;
        let request = NumberedRequest { number: self.requests, request };
        self.link.requests.push(request).map_err(|_| ControlRequestError::TooMany)?;
        Ok(self.requests)
    }

    fn load(&mut self, message: &PlanMessage) {
        let PlanHeader { id, replaces, t_f, .. } = message.header;
        let accepted = self.at_normal_priority(|| plan::accept(message, self.config));
        let sent =
            accepted.map_err(ControlRequestError::from).and_then(|plan| self.send(StepRequest::Load(plan)));
        match sent {
            Ok(number) => {
                if replaces == 0 {
                    info!("plan {id} loaded, t_F = {t_f:.3} s");
                } else {
                    debug!("plan {id} waits to replace plan {replaces}, t_F = {t_f:.3} s");
                }
                self.sent_plans.sent(number, id, replaces == 0);
                self.last_refusal.clear();
            }
            Err(reason) => self.refuse_plan(id, &reason),
        }
    }

    fn refuse_plan(&mut self, id: u64, reason: &impl Display) {
        warn!("plan {id} refused: {reason}");
        self.last_refusal = format!("plan {id}: {reason}");
    }

    /// Does work of some milliseconds at normal priority, so that other processes on this CPU, perhaps the plant, can run.
    fn at_normal_priority<T>(&self, work: impl FnOnce() -> T) -> T {
        let [_, (thread, priority)] = self.threads;
        // The thread had this priority before, so the system will grant it again.
        let set = |priority| self.prioritised && os::set_priority(thread, priority).is_ok();
        set(None);
        let done = work();
        set(Some(priority));
        done
    }

    /// Message with the cause of a fault or stop, an active recovery, and the last refusal; empty if there is none.
    fn remark(&self) -> String {
        let refusal =
            Some(&self.last_refusal).filter(|text| !text.is_empty()).map(|text| format!("refused {text}"));
        let recovery = self.recovery.is_active().then(|| "waits for the next swing-up".to_owned());
        let parts = [Some(self.log.remark()), recovery, refusal];
        parts.into_iter().flatten().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
    }

    fn respond(&self, accepted: bool, reason: &str) -> ControlResponse {
        let response = self.log.respond();
        // During a recovery the daemon takes the next action itself.
        let recovers = self.recovery.is_active() && !is_braked(self.log.mode());
        let next = if recovers { Text::new("wait for the recovery") } else { response.next };
        ControlResponse {
            accepted: u64::from(accepted),
            plan_id: self.sent_plans.newest(),
            degraded: self.degraded,
            reason: Text::new(reason),
            next,
            ..response
        }
    }

    fn dropped(&self) -> u64 {
        self.link.shared.dropped.load(Ordering::Relaxed)
    }

    /// Processes all replies and records of the real-time thread.
    fn fetch(&mut self) {
        // Replies first: a record enters its ring before the reply to the same request does.
        while let Ok(reply) = self.link.replies.pop() {
            match reply {
                Reply::Answer { number, result } if number == self.awaited => self.answer = Some(result),
                Reply::Answer { number, result } => {
                    let plan = self.sent_plans.answered(number, result.is_ok());
                    if let Err(refusal) = result {
                        let refusal = refusal.text(&self.config.model);
                        let request = plan.map_or("queued request".into(), |plan| format!("plan {plan}"));
                        warn!("{request} refused: {refusal}");
                        self.last_refusal = format!("{request}: {refusal}");
                    }
                }
                Reply::Retired(plan) => drop(plan),
            }
        }
        while let Ok(record) = self.link.records.pop() {
            if let Some(DroppedPlan { id, reason }) = record.dropped {
                self.refuse_plan(id, &reason.text(&self.config.model));
            }
            let action = self.recovery.note(&record, self.sent_plans.newest());
            let noted = self.log.note(record, self.dropped());
            self.warn_of_error(noted);
            match action {
                Some(RecoveryAction::AskPlanner) => self.ask_planner(),
                Some(RecoveryAction::Start(plan_id)) => {
                    info!("recovery: swinging up again");
                    if self.send(StepRequest::Start(plan_id)).is_err() {
                        self.warn_once("too many requests wait for the next cycle");
                    }
                }
                None => {}
            }
        }
    }

    /// Asks the planner for a recovery plan in a separate thread, as the answer may take a second.
    fn ask_planner(&mut self) {
        info!("recovery: the pendulum is at rest, requesting a plan");
        let (node, patience) = (self.node.clone(), self.config.daemon.recovery.patience);
        let closing = Arc::clone(&self.closing);
        let name = self.config.first_manoeuvre(Posture::Hanging).unwrap_or_default();
        let manoeuvre = ManoeuvreRequest::new(name, &[]);
        let known_seq = self.log.respond().seq;
        let ask = move || {
            let request = PlannerRequest { known_seq, ..PlannerRequest::from_now(manoeuvre?) };
            let planner = node.client::<PlannerRequest>()?;
            let wanted = || !closing.load(Ordering::Acquire);
            Ok(PublishedPlan::from(&request_plan(&planner, &request, patience, wanted)?))
        };
        match Builder::new().name("recovery".into()).spawn(ask) {
            Ok(thread) => self.asker = Some(thread),
            Err(e) => {
                self.recovery.planned(None);
                self.warn_once(format_args!("recovery: cannot start a thread: {e}"));
            }
        }
    }

    /// Takes the answer of the planner once it has come.
    fn receive_plan(&mut self) {
        let Some(asker) = self.asker.take_if(|asker| asker.is_finished()) else { return };
        let reason = match asker.join() {
            Ok(Ok(plan)) => return self.recovery.planned(Some(plan)),
            Ok(Err(e)) => e.to_string(),
            Err(_) => "the thread that asks the planner panicked".to_owned(),
        };
        self.recovery.planned(None);
        self.last_refusal = format!("a plan for the recovery: {reason}");
        warn!("recovery failed: {reason}");
    }

    /// Logs a problem, but not again while it persists.
    fn warn_once(&mut self, trouble: impl Display) {
        let trouble = trouble.to_string();
        if trouble != self.last_complaint {
            warn!("{trouble}");
            self.last_complaint = trouble;
        }
    }

    fn warn_of_error(&mut self, result: Result<(), IpcError>) {
        if let Err(e) = result {
            self.warn_once(e);
        }
    }
}
