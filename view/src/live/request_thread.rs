//! Thread that makes the requests of an operator, so that they do not delay the views of the system.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use upswing_ipc::operator::{AcceptedRequest, Operator, OperatorError, OperatorRequest};
use upswing_ipc::{ControlResponse, Node};

/// Time between two requests for the daemon's status.
const PERIOD: Duration = Duration::from_millis(200);

/// Reason why a request of the operator had no effect. Shared, because the view and the sender of the request get it.
#[derive(Clone, Debug, thiserror::Error)]
pub enum OperatorRequestError {
    /// Daemon or planner refused the request, or did not respond.
    #[error(transparent)]
    Operator(#[from] Arc<OperatorError>),
    /// A plan for an earlier request is not complete yet.
    #[error("a plan is being made already; stop withdraws it")]
    Busy,
}

/// Result of a request.
pub type RequestResult = Result<AcceptedRequest, OperatorRequestError>;

/// What the request thread reports to the view.
pub(super) enum LiveUpdate {
    /// Whether daemon, planner and plant are running.
    Processes([bool; 3]),
    /// State of the daemon; `None` if it does not respond.
    Status(Option<Box<ControlResponse>>),
    /// A request was sent.
    Sent(OperatorRequest),
    /// A request was answered.
    Answered(OperatorRequest, RequestResult),
}

struct PendingRequest {
    request: OperatorRequest,
    reply: Sender<RequestResult>,
}

/// Sends requests to the request thread; usable from any thread.
#[derive(Clone)]
pub struct RequestSender(Sender<PendingRequest>);

impl RequestSender {
    /// Sends a request. Its result arrives in the returned receiver and as an event of the view.
    pub fn ask(&self, request: OperatorRequest) -> Receiver<RequestResult> {
        let (reply, answer) = channel();
        // If the request thread has ended, `reply` is dropped with the request, and the receiver reports that.
        let _ = self.0.send(PendingRequest { request, reply });
        answer
    }
}

/// Handle of the request thread; dropping it ends the thread.
pub(super) struct RequestThread {
    requests: RequestSender,
    updates: Receiver<LiveUpdate>,
    thread: Option<JoinHandle<()>>,
    closing: Arc<AtomicBool>,
}

impl RequestThread {
    pub fn open(node: &Node) -> Result<Self, OperatorError> {
        let (requests_in, requests) = channel();
        let (updates_in, updates) = channel();
        let (node, closing) = (node.clone(), Arc::new(AtomicBool::new(false)));
        let closed = Arc::clone(&closing);
        // Ports stay in the thread that opened them, so the thread reports whether it could open them.
        let (opened, is_open) = channel();
        let thread = std::thread::spawn(move || {
            let (work, result) = match RequestWorker::new(node, updates_in) {
                Ok(work) => (Some(work), Ok(())),
                Err(e) => (None, Err(e)),
            };
            let _ = opened.send(result);
            if let Some(mut work) = work {
                work.run(&requests, &closed);
            }
        });
        let Ok(opened) = is_open.recv() else {
            // The thread panicked; without this error, the system would seem not to run.
            let panic = thread.join().err();
            std::panic::resume_unwind(
                panic.unwrap_or_else(|| Box::new("the request thread ended at its start")),
            );
        };
        opened?;
        Ok(Self { requests: RequestSender(requests_in), updates, thread: Some(thread), closing })
    }

    pub fn request_sender(&self) -> RequestSender {
        self.requests.clone()
    }

    pub fn updates(&self) -> impl Iterator<Item = LiveUpdate> + '_ {
        self.updates.try_iter()
    }
}

impl Drop for RequestThread {
    /// Withdraws a manoeuvre that is being planned.
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A manoeuvre that is being planned, in a thread of its own.
struct Planning {
    thread: JoinHandle<()>,
    withdrawn: Arc<AtomicBool>,
}

struct RequestWorker {
    node: Node,
    operator: Operator,
    plant: upswing_ipc::Client<upswing_ipc::PlantRequest>,
    updates: Sender<LiveUpdate>,
    planning: Option<Planning>,
}

impl RequestWorker {
    fn new(node: Node, updates: Sender<LiveUpdate>) -> Result<Self, OperatorError> {
        let operator = Operator::new(&node)?;
        // Opens the port, so that a failure is reported at the start.
        operator.has_planner()?;
        Ok(Self { operator, plant: node.client()?, node, updates, planning: None })
    }

    fn run(&mut self, requests: &Receiver<PendingRequest>, closing: &AtomicBool) {
        let mut looked: Option<Instant> = None;
        while !closing.load(Ordering::Acquire) {
            if looked.is_none_or(|t| t.elapsed() >= PERIOD) {
                self.look();
                looked = Some(Instant::now());
            }
            match requests.recv_timeout(PERIOD) {
                Ok(pending) => {
                    self.serve(pending);
                    looked = None;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        self.withdraw();
    }

    fn look(&mut self) {
        let status = self.operator.status();
        let planner = self.operator.has_planner().is_ok_and(|present| present);
        let present = [status.is_ok(), planner, self.plant.has_server()];
        let _ = self.updates.send(LiveUpdate::Processes(present));
        let _ = self.updates.send(LiveUpdate::Status(status.ok().map(Box::new)));
    }

    /// A manoeuvre gets a thread of its own, so that a stop never waits for a plan.
    fn serve(&mut self, PendingRequest { request, reply }: PendingRequest) {
        let _ = self.updates.send(LiveUpdate::Sent(request));
        let updates = self.updates.clone();
        let answer = move |result: RequestResult| {
            let _ = updates.send(LiveUpdate::Answered(request, result.clone()));
            let _ = reply.send(result);
        };
        match request {
            OperatorRequest::Hold
            | OperatorRequest::Stop
            | OperatorRequest::Enable
            | OperatorRequest::Reset => {
                if let Some(planning) = &self.planning {
                    planning.withdrawn.store(true, Ordering::Release);
                }
                let done = self.operator.request(request, &AtomicBool::new(false));
                answer(done.map_err(|e| Arc::new(e).into()));
            }
            OperatorRequest::Manoeuvre(_)
                if self.planning.as_ref().is_some_and(|p| !p.thread.is_finished()) =>
            {
                answer(Err(OperatorRequestError::Busy));
            }
            OperatorRequest::Manoeuvre(_) => {
                let (node, withdrawn) = (self.node.clone(), Arc::new(AtomicBool::new(false)));
                let flag = Arc::clone(&withdrawn);
                let plan = move || Operator::new(&node)?.request(request, &flag);
                let thread = std::thread::spawn(move || answer(plan().map_err(|e| Arc::new(e).into())));
                self.planning = Some(Planning { thread, withdrawn });
            }
        }
    }

    fn withdraw(&mut self) {
        if let Some(planning) = self.planning.take() {
            planning.withdrawn.store(true, Ordering::Release);
            let _ = planning.thread.join();
        }
    }
}
