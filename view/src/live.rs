//! A running system as an operator sees it: the same [`View`] for the terminal, the page and the metrics.

mod desk;
mod status;
mod view;
mod watch;

pub use desk::{Asker, Reply};
pub use status::{Status, Times};
pub use view::{Cycle, Event, Joint, Kind, PlanView, View};
pub use watch::Watch;

use desk::Desk;
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::OperatorError;
use upswing_ipc::{IpcError, Node, Plan, Subscriber, Telemetry, TelemetryBatch};

/// Without a cycle for so long nothing is known of the present one.
const SILENCE: Duration = Duration::from_secs(1);

/// A connection to a system, which need not run yet; stays in its thread.
pub struct Live {
    telemetry: Subscriber<TelemetryBatch>,
    plans: Subscriber<Plan>,
    desk: Desk,
    watch: Watch,
    begin: Instant,
    /// When the newest cycle came.
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
            desk: Desk::open(node)?,
            watch: Watch::new(config, node.domain().name()),
            begin: Instant::now(),
            heard: Instant::now(),
        })
    }

    /// Takes in all that came since the last call, and shows `each` cycle.
    ///
    /// # Errors
    /// [`IpcError`]
    pub fn poll(&mut self, mut each: impl FnMut(&Telemetry)) -> Result<(), IpcError> {
        self.watch.now(self.begin.elapsed().as_secs_f64());
        while let Some(batch) = self.telemetry.receive()? {
            self.heard = Instant::now();
            for record in batch.used() {
                // A copy: the daemon's process could still write into what is shared.
                let record = *record;
                self.watch.cycle(&record);
                each(&record);
            }
        }
        if self.heard.elapsed() > SILENCE {
            self.watch.silence();
        }
        while let Some(plan) = self.plans.receive()? {
            self.watch.plan(&plan.boxed_copy());
        }
        for news in self.desk.news() {
            self.watch.news(news);
        }
        Ok(())
    }

    /// What there is to see.
    pub fn view(&self) -> View {
        self.watch.view()
    }

    /// Polls until the daemon answered once, or said nothing for a while; a first view is complete then.
    ///
    /// # Errors
    /// [`IpcError`]
    pub fn settle(&mut self) -> Result<(), IpcError> {
        /// Two answers of the desk, and telemetry of a daemon that is slow.
        const PATIENCE: Duration = Duration::from_millis(1500);
        let complete = |view: &View| view.cycle.is_some() && view.status.is_some();
        while self.begin.elapsed() < PATIENCE && !complete(&self.view()) {
            self.poll(|_| ())?;
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    /// Where requests can be made, also from other threads.
    pub fn asker(&self) -> Asker {
        self.desk.asker()
    }
}
