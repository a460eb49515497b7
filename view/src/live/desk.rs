//! Makes requests while the picture goes on.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use upswing_ipc::operator::{Accepted, Operator, OperatorError, Request};
use upswing_ipc::{ControlResponse, Node};

/// Time between two requests for the daemon's status.
const PERIOD: Duration = Duration::from_millis(200);

/// What became of a request, for people.
pub type Reply = Result<Accepted, String>;

/// What the desk has found out.
pub(super) enum News {
    /// Whether there are daemon, planner and plant.
    Present([bool; 3]),
    /// The daemon's status; `None`: no answer.
    Status(Option<Box<ControlResponse>>),
    /// A request was made.
    Asked(Request),
    /// A request was answered.
    Answer(Request, Reply),
}

struct Order {
    request: Request,
    reply: Sender<Reply>,
}

/// Makes requests; for any thread.
#[derive(Clone)]
pub struct Asker(Sender<Order>);

impl Asker {
    /// Asks; the answer comes through the returned end, and is an event of the view.
    pub fn ask(&self, request: Request) -> Receiver<Reply> {
        let (reply, answer) = channel();
        // Where the desk is gone, the other end of `reply` goes with the order, and the receiver sees it.
        let _ = self.0.send(Order { request, reply });
        answer
    }
}

/// The thread that asks.
pub(super) struct Desk {
    asker: Asker,
    news: Receiver<News>,
    thread: Option<JoinHandle<()>>,
    closing: Arc<AtomicBool>,
}

impl Desk {
    pub fn open(node: &Node) -> Result<Self, OperatorError> {
        let (orders_in, orders) = channel();
        let (news_in, news) = channel();
        let (node, closing) = (node.clone(), Arc::new(AtomicBool::new(false)));
        let closed = Arc::clone(&closing);
        // Ends of services stay in the thread that made them, so it says whether it could.
        let (opened, is_open) = channel();
        let thread = std::thread::spawn(move || {
            let (work, result) = match Work::new(node, news_in) {
                Ok(work) => (Some(work), Ok(())),
                Err(e) => (None, Err(e)),
            };
            let _ = opened.send(result);
            if let Some(mut work) = work {
                work.run(&orders, &closed);
            }
        });
        let Ok(opened) = is_open.recv() else {
            // It panicked: a desk of which nothing is ever heard would look like a system that is not there.
            let panic = thread.join().err();
            std::panic::resume_unwind(panic.unwrap_or_else(|| Box::new("the desk ended at its start")));
        };
        opened?;
        Ok(Self { asker: Asker(orders_in), news, thread: Some(thread), closing })
    }

    pub fn asker(&self) -> Asker {
        self.asker.clone()
    }

    pub fn news(&self) -> impl Iterator<Item = News> + '_ {
        self.news.try_iter()
    }
}

impl Drop for Desk {
    /// Withdraws what is being planned.
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A plan that is being made.
struct Planning {
    thread: JoinHandle<()>,
    withdrawn: Arc<AtomicBool>,
}

struct Work {
    node: Node,
    operator: Operator,
    plant: upswing_ipc::Client<upswing_ipc::PlantRequest>,
    news: Sender<News>,
    planning: Option<Planning>,
}

impl Work {
    fn new(node: Node, news: Sender<News>) -> Result<Self, OperatorError> {
        Ok(Self { operator: Operator::new(&node)?, plant: node.client()?, node, news, planning: None })
    }

    fn run(&mut self, orders: &Receiver<Order>, closing: &AtomicBool) {
        let mut looked: Option<Instant> = None;
        while !closing.load(Ordering::Acquire) {
            if looked.is_none_or(|t| t.elapsed() >= PERIOD) {
                self.look();
                looked = Some(Instant::now());
            }
            match orders.recv_timeout(PERIOD) {
                Ok(order) => {
                    self.serve(order);
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
        let _ = self.news.send(News::Present(present));
        let _ = self.news.send(News::Status(status.ok().map(Box::new)));
    }

    /// Plans are made beside, so that a stop is never kept waiting.
    fn serve(&mut self, Order { request, reply }: Order) {
        let _ = self.news.send(News::Asked(request));
        let news = self.news.clone();
        let answer = move |result: Reply| {
            let _ = news.send(News::Answer(request, result.clone()));
            let _ = reply.send(result);
        };
        match request {
            Request::Hold | Request::Stop | Request::Enable | Request::Reset => {
                if let Some(planning) = &self.planning {
                    planning.withdrawn.store(true, Ordering::Release);
                }
                let done = self.operator.request(request, &AtomicBool::new(false));
                answer(done.map_err(|e| e.to_string()));
            }
            Request::Manoeuvre(_) if self.planning.as_ref().is_some_and(|p| !p.thread.is_finished()) => {
                answer(Err("a plan is being made already; stop withdraws it".into()));
            }
            Request::Manoeuvre(_) => {
                let (node, withdrawn) = (self.node.clone(), Arc::new(AtomicBool::new(false)));
                let flag = Arc::clone(&withdrawn);
                let plan = move || Operator::new(&node)?.request(request, &flag);
                let thread = std::thread::spawn(move || answer(plan().map_err(|e| e.to_string())));
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
