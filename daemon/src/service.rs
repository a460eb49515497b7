//! The other thread: answers requests, checks plans, publishes telemetry, hands over plants. It never waits for other
//! processes: those who stop the arm wait for it.

use crate::controller::{Order, Record};
use crate::journal::Journal;
use crate::loads::Loads;
use crate::os::{self, Refused};
use crate::plan;
use crate::realtime::{Cycle, Ends, Report, Ticket};
use crate::recovery::{Recovery, RecoveryAction};
use crate::supervisor::{Refusal, Request, is_braked};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};
use tracing::{info, warn};
use upswing_config::{Config, RealtimeMode};
use upswing_ipc::operator::{Manoeuvre, PublishedPlan, request_plan};
use upswing_ipc::{
    Command, ControlCommand, ControlRequest, ControlResponse, Degradation, Domain, IpcError, Measurement,
    Mode, Node, Plan, PlannerRequest, Reader, Search, Text,
};
use upswing_process::Failure;
use upswing_process::notify::Notifier;

/// Pause of the loop.
const PAUSE: Duration = Duration::from_millis(1);
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
    // Before any memory is claimed: too little of it ends a process without a word.
    Domain::check_limits().map_err(failed)?;
    // Before anything is mapped, so that nothing of it faults later.
    let (_prepared, refused) = os::prepare_process();
    let node = domain.connect("daemon").map_err(failed)?;
    // The only server of its kind, so it also keeps a second daemon out.
    let server = node.server::<ControlRequest>().map_err(|e| match e {
        IpcError::Taken { .. } => Failure::Failed(format!("domain `{domain}` has a daemon already ({e})")),
        e => failed(e),
    })?;
    // The ports outlive the entry in the real-time thread, which is joined below.
    let (command, _ports) = node.writer::<Command>().map_err(failed)?.split();
    let (cycle, ends) = Cycle::new(config, command);
    let mut desk = Desk::new(config, &node, ends)?;
    let thread = start_thread(config, cycle, refused, &mut desk)?;
    info!("daemon ready in domain `{domain}`, model {:016x}", config.model.fingerprint());

    let result = desk.work(&server, shutdown, &thread);
    desk.manager.stopping();
    desk.ends.shared.exit.store(true, Ordering::Release);
    let joined = thread.join();
    desk.closing.store(true, Ordering::Release);
    if let Some(asker) = desk.asker.take() {
        let _ = asker.join();
    }
    desk.fetch();
    let flushed = desk.journal.flush(desk.dropped());
    desk.complain_of(flushed);
    joined.map_err(|_| Failure::Failed("the real-time thread panicked".into())).and(result)
}

/// Starts the real-time thread; it has its priority and CPU when this returns. `refused`: what the system refused so far.
fn start_thread(
    config: &Config,
    cycle: Cycle,
    mut refused: Vec<Refused>,
    desk: &mut Desk<'_>,
) -> Result<JoinHandle<()>, Failure> {
    let settings = config.daemon.realtime;
    let (tell, told) = mpsc::channel();
    let body = move || {
        refused.extend(os::prepare_thread(&settings));
        let degraded = refused.iter().fold(0, |bits, refused| bits | refused.what.bit());
        let go = refused.is_empty() || settings.mode == RealtimeMode::Warn;
        let heard = tell.send((os::thread_id(), degraded, refused));
        drop(tell);
        if go && heard.is_ok() {
            cycle.run(degraded);
        }
    };
    let thread = Builder::new()
        .name("realtime".into())
        .spawn(body)
        .map_err(|e| Failure::Failed(format!("cannot start the real-time thread: {e}")))?;
    let (tid, degraded, refused) =
        told.recv().map_err(|_| Failure::Failed("the real-time thread did not start".into()))?;
    desk.degraded = degraded;
    desk.threads = [(tid, settings.priority), (os::thread_id(), settings.priority.saturating_sub(1).max(1))];
    if degraded != 0 {
        let reasons = refused.into_iter().map(|refused| refused.why).collect::<Vec<_>>().join(", ");
        if settings.mode == RealtimeMode::Strict {
            return Err(Failure::Failed(format!(
                "realtime.mode is strict, but the system refuses {reasons}"
            )));
        }
        warn!("degraded, cycles may be late: the system refuses {reasons}");
    }
    desk.journal.watch(tid);
    Ok(thread)
}

fn failed(e: IpcError) -> Failure {
    Failure::Failed(e.to_string())
}

/// What the thread knows and has to hand.
struct Desk<'a> {
    config: &'a Config,
    node: Node,
    ends: Ends,
    plants: Search<Measurement>,
    /// Whether a plant was found, and one that the real-time thread has no room for yet.
    found: bool,
    waiting: Option<Reader<Measurement>>,
    /// The real-time thread and this one, with their priorities where time is real, and whether they have them.
    threads: [(u32, u8); 2],
    prioritised: bool,
    journal: Journal<'a>,
    manager: Notifier,
    /// The heartbeat of the real-time thread as the manager knows it.
    beats: u64,
    /// The mode it was told last.
    mode_told: Option<Mode>,
    recovery: Recovery,
    /// Asks the planner for a recovery.
    asker: Option<JoinHandle<Result<PublishedPlan, String>>>,
    /// Tells it that nobody waits any more.
    closing: Arc<AtomicBool>,
    /// Bits of [`upswing_ipc::Degradation`].
    degraded: u64,
    tickets: u64,
    /// Number of the ticket that somebody waits for (0: nobody), and its answer.
    awaited: u64,
    answer: Option<Result<(), Refusal>>,
    loads: Loads,
    last_refusal: String,
    last_complaint: String,
}

impl<'a> Desk<'a> {
    fn new(config: &'a Config, node: &Node, ends: Ends) -> Result<Self, Failure> {
        Ok(Self {
            config,
            node: node.clone(),
            ends,
            plants: Search::start(node)
                .map_err(|e| Failure::Failed(format!("cannot start a thread: {e}")))?,
            found: false,
            waiting: None,
            threads: [(0, 1); 2],
            prioritised: false,
            journal: Journal::new(&config.daemon, node).map_err(failed)?,
            manager: Notifier::new(),
            beats: 0,
            mode_told: None,
            recovery: Recovery::new(config.daemon.recovery),
            asker: None,
            closing: Arc::default(),
            degraded: 0,
            tickets: 0,
            awaited: 0,
            answer: None,
            loads: Loads::default(),
            last_refusal: String::new(),
            last_complaint: String::new(),
        })
    }

    /// The loop, until the process may end.
    fn work(
        &mut self,
        server: &upswing_ipc::Server<ControlRequest>,
        shutdown: &AtomicBool,
        thread: &JoinHandle<()>,
    ) -> Result<(), Failure> {
        let plans = self.node.subscriber::<Plan>().map_err(failed)?;
        let mut shutdown_begin = None;
        while !thread.is_finished() {
            self.look();
            self.set_priorities();
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
            self.hear_planner();
            let tended = self.journal.tend(self.dropped());
            self.complain_of(tended);
            self.tell_manager();
            if shutdown.load(Ordering::Acquire) && self.may_exit(&mut shutdown_begin) {
                return Ok(());
            }
            sleep(PAUSE);
        }
        Err(Failure::Failed("the real-time thread ended".into()))
    }

    /// Hands over a plant that was found, until there is room for it.
    fn look(&mut self) {
        self.ends.shared.plant_lives.store(self.plants.lives(), Ordering::Relaxed);
        match self.plants.take() {
            Ok(Some(reader)) => {
                info!("found a plant, started at {} ns", reader.epoch());
                // Its memory is mapped now, not in the real-time thread.
                reader.read();
                (self.found, self.waiting) = (true, Some(reader));
            }
            Ok(None) => {}
            Err(e) => self.complain(e.to_string()),
        }
        if let Some(reader) = self.waiting.take()
            && let Err(rtrb::PushError::Full(reader)) = self.ends.readers.push(reader)
        {
            self.waiting = Some(reader);
            self.complain("the real-time thread does not take the measurements of a new plant".into());
        }
    }

    /// Real-time priority where time is real, and only there: the plant of another clock waits, and so does the real-time
    /// thread, beside which other programs want to run. This thread has it too, below: an operator's stop does not wait for
    /// them.
    fn set_priorities(&mut self) {
        let wanted = self.ends.shared.real_time.load(Ordering::Relaxed);
        if wanted == self.prioritised || self.degraded & Degradation::Scheduler.bit() != 0 {
            return;
        }
        self.prioritised = wanted;
        for (thread, priority) in self.threads {
            if let Err(e) = os::set_priority(thread, wanted.then_some(priority)) {
                self.complain(format!("cannot change the priority of thread {thread}: {e}"));
            }
        }
    }

    /// Tells the service manager about the real-time thread: a heartbeat only while it has one.
    fn tell_manager(&mut self) {
        let beats = self.ends.shared.beats.load(Ordering::Relaxed);
        if beats != self.beats {
            self.beats = beats;
            self.manager.alive();
        }
        let good = |record: &Record| record.telemetry.measurement_seq > 0 && record.telemetry.fault == 0;
        if self.journal.newest.as_ref().is_some_and(good) {
            self.manager.ready();
        } else if self.mode_told.is_none() {
            self.manager.status("waits for a plant");
            return;
        }
        let mode = self.journal.mode();
        if self.mode_told.replace(mode) != Some(mode) {
            let remark = Some(self.journal.remark()).filter(|text| !text.is_empty());
            self.manager.status(&remark.map_or(mode.to_string(), |remark| format!("{mode}: {remark}")));
        }
    }

    /// Whether a process that shall end may do so: the brakes hold, or waiting is no use.
    fn may_exit(&mut self, begin: &mut Option<Instant>) -> bool {
        if is_braked(self.journal.mode()) {
            return true;
        }
        let begin = *begin.get_or_insert_with(|| {
            info!("shutting down");
            self.manager.stopping();
            self.recovery.yield_to_operator();
            if self.order(Order::Do(Request::Shutdown)).is_none() {
                self.complain("the real-time thread does not take the order to shut down".into());
            }
            Instant::now()
        });
        let why = if self.journal.sign_of_life.max(begin).elapsed() > SIGN_OF_LIFE {
            "the plant is gone, or stands still"
        } else if begin.elapsed() > SHUTDOWN {
            "the arm does not come to rest"
        } else {
            return false;
        };
        warn!("closing the brakes: {why}");
        true
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
            Ok(ControlCommand::Start) => Request::Start(request.plan_id),
            Ok(ControlCommand::Stop) => Request::Stop,
            Ok(ControlCommand::Reset) => Request::Reset,
            Err(unknown) => return self.respond(false, &unknown.to_string()),
        };
        self.recovery.yield_to_operator();
        let asked = self.ask(request);
        // A loss that was found meanwhile is the operator's, too.
        self.recovery.yield_to_operator();
        match asked {
            Ok(remark) => {
                if matches!(request, Request::Enable | Request::Start(_) | Request::Reset) {
                    self.journal.forget_warnings();
                }
                self.respond(true, remark)
            }
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
        while request == Request::Enable && !self.found && begin.elapsed() < ANSWER {
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
        let accepted = self.at_normal_priority(|| plan::accept(payload, self.config));
        let result = accepted.map_err(|refusal| refusal.to_string()).and_then(|plan| {
            let number = self.order(Order::Load(plan));
            number.ok_or_else(|| "too many orders wait for the next cycle".into())
        });
        match result {
            Ok(number) => {
                info!("plan {} loaded, t_F = {:.3} s", payload.id, payload.t_f);
                self.loads.ordered(number, payload.id);
                self.last_refusal.clear();
            }
            Err(reason) => {
                warn!("plan {} refused: {reason}", payload.id);
                self.last_refusal = format!("plan {}: {reason}", payload.id);
            }
        }
    }

    /// Does work of some milliseconds, in which others of this CPU (the plant's process may be one) get their turn.
    fn at_normal_priority<T>(&self, work: impl FnOnce() -> T) -> T {
        let [_, (thread, priority)] = self.threads;
        // It had the priority, so it may have it again.
        let set = |priority| self.prioritised && os::set_priority(thread, priority).is_ok();
        set(None);
        let done = work();
        set(Some(priority));
        done
    }

    /// What there is to say about the state: the cause of a fault or stop, the last refusal.
    fn remark(&self) -> String {
        let refusal =
            Some(&self.last_refusal).filter(|text| !text.is_empty()).map(|text| format!("refused {text}"));
        let recovery = self.recovery.is_active().then(|| "waits for the next swing-up".to_owned());
        let parts = [Some(self.journal.remark()), recovery, refusal];
        parts.into_iter().flatten().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
    }

    fn respond(&self, accepted: bool, reason: &str) -> ControlResponse {
        let response = self.journal.respond();
        // The daemon takes the next step by itself.
        let recovers = self.recovery.is_active() && !is_braked(self.journal.mode());
        let next = if recovers { Text::new("wait for the recovery") } else { response.next };
        ControlResponse {
            accepted: u64::from(accepted),
            plan_id: self.loads.newest(),
            degraded: self.degraded,
            reason: Text::new(reason),
            next,
            ..response
        }
    }

    fn dropped(&self) -> u64 {
        self.ends.shared.dropped.load(Ordering::Relaxed)
    }

    /// Takes in all that came from the real-time thread.
    fn fetch(&mut self) {
        // Reports first: the record that belongs to a report is in its ring before the report is.
        while let Ok(report) = self.ends.reports.pop() {
            match report {
                Report::Answer { number, result } if number == self.awaited => self.answer = Some(result),
                Report::Answer { number, result } => {
                    let plan = self.loads.answered(number, result.is_ok());
                    if let Err(refusal) = result {
                        let order = plan.map_or("queued order".into(), |plan| format!("plan {plan}"));
                        warn!("{order} refused: {refusal}");
                        self.last_refusal = format!("{order}: {refusal}");
                    }
                }
                Report::Garbage(plan) => drop(plan),
            }
        }
        while let Ok(record) = self.ends.records.pop() {
            let action = self.recovery.note(&record, self.loads.newest());
            let noted = self.journal.note(record, self.dropped());
            self.complain_of(noted);
            match action {
                Some(RecoveryAction::AskPlanner) => self.ask_planner(),
                Some(RecoveryAction::Start(plan_id)) => {
                    info!("recovery: swinging up again");
                    if self.order(Order::Do(Request::Start(plan_id))).is_none() {
                        self.complain("too many orders wait for the next cycle".into());
                    }
                }
                None => {}
            }
        }
    }

    /// Asks for a plan in a thread of its own: it may take a second.
    fn ask_planner(&mut self) {
        info!("recovery: the pendulum rests, asking for a plan");
        let (node, patience) = (self.node.clone(), self.config.daemon.recovery.patience);
        let closing = Arc::clone(&self.closing);
        let ask = move || {
            let planner = node.client::<PlannerRequest>().map_err(|e| e.to_string())?;
            let wanted = || !closing.load(Ordering::Acquire);
            let plan = request_plan(&planner, Manoeuvre::SwingUp, patience, wanted);
            plan.map(|plan| PublishedPlan::from(&plan)).map_err(|e| e.to_string())
        };
        match Builder::new().name("recovery".into()).spawn(ask) {
            Ok(thread) => self.asker = Some(thread),
            Err(e) => {
                self.recovery.planned(None);
                self.complain(format!("recovery: cannot start a thread: {e}"));
            }
        }
    }

    /// Takes the answer of the planner, once it is there.
    fn hear_planner(&mut self) {
        let Some(asker) = self.asker.take_if(|asker| asker.is_finished()) else { return };
        let answer = asker.join().unwrap_or_else(|_| Err("the asking thread panicked".into()));
        match answer {
            Ok(plan) => self.recovery.planned(Some(plan)),
            Err(reason) => {
                self.recovery.planned(None);
                self.last_refusal = format!("a plan for the recovery: {reason}");
                warn!("recovery given up: {reason}");
            }
        }
    }

    /// Logs a trouble that persists once.
    fn complain(&mut self, trouble: String) {
        if trouble != self.last_complaint {
            warn!("{trouble}");
            self.last_complaint = trouble;
        }
    }

    fn complain_of(&mut self, result: Result<(), IpcError>) {
        if let Err(e) = result {
            self.complain(e.to_string());
        }
    }
}
