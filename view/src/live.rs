//! A running system as an operator sees it: one [`View`] for the terminal, the web page and the metrics.

mod request_thread;
mod status;
mod view;
mod view_builder;

pub use request_thread::{OperatorRequestError, RequestResult, RequestSender};
pub use status::{DaemonStatus, LatencyPercentiles};
pub use view::{CycleView, EventView, JointView, PlanView, Severity, View};
pub use view_builder::ViewBuilder;

use request_thread::RequestThread;
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::OperatorError;
use upswing_ipc::{IpcError, Node, PlanMessage, Subscriber, Telemetry, TelemetryBatch};

/// Time without telemetry after which the newest cycle no longer counts as the present state.
const SILENCE: Duration = Duration::from_secs(1);

/// Client of a system, which need not be running yet. The client stays in the thread that opened it.
pub struct Live {
    telemetry: Subscriber<TelemetryBatch>,
    plans: Subscriber<PlanMessage>,
    request_thread: RequestThread,
    builder: ViewBuilder,
    begin: Instant,
    /// When the newest telemetry arrived.
    heard: Instant,
}

impl Live {
    /// Opens the services of the node's domain.
    ///
    /// # Errors
    /// [`OperatorError::Ipc`]
    pub fn open(node: &Node, config: &Config) -> Result<Self, OperatorError> {
        Ok(Self {
            telemetry: node.subscriber()?,
            plans: node.subscriber()?,
            request_thread: RequestThread::open(node)?,
            builder: ViewBuilder::new(config, node.domain().name()),
            begin: Instant::now(),
            heard: Instant::now(),
        })
    }

    /// Takes all data that have arrived since the last call; `each` is called with every cycle.
    ///
    /// # Errors
    /// [`IpcError`]
    pub fn poll(&mut self, mut each: impl FnMut(&Telemetry)) -> Result<(), IpcError> {
        self.builder.now(self.begin.elapsed().as_secs_f64());
        while let Some(batch) = self.telemetry.receive()? {
            self.heard = Instant::now();
            for record in batch.used() {
                // A copy: the daemon could still write to the shared memory.
                let record = *record;
                self.builder.cycle(&record);
                each(&record);
            }
        }
        if self.heard.elapsed() > SILENCE {
            self.builder.silence();
        }
        while let Some(plan) = self.plans.receive()? {
            self.builder.plan(plan.copied());
        }
        for update in self.request_thread.updates() {
            self.builder.update(update);
        }
        Ok(())
    }

    /// Returns the current state of the system.
    pub fn view(&self) -> View {
        self.builder.view()
    }

    /// Polls until cycles and status have arrived, or for 1.5 s: then a first view is as complete as it can be.
    ///
    /// # Errors
    /// [`IpcError`]
    pub fn settle(&mut self) -> Result<(), IpcError> {
        /// Time for two reports of the request thread, and for telemetry of a slow daemon.
        const PATIENCE: Duration = Duration::from_millis(1500);
        let complete = |view: &View| view.cycle.is_some() && view.status.is_some();
        while self.begin.elapsed() < PATIENCE && !complete(&self.view()) {
            self.poll(|_| ())?;
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    /// A sender of requests, also for other threads.
    pub fn request_sender(&self) -> RequestSender {
        self.request_thread.request_sender()
    }
}
