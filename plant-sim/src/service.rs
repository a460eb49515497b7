//! The plant process: steps the plant on its clock, publishes its measurements, reads commands, and serves requests.

use crate::Plant;
use crate::commands::DaemonCommands;
use crate::requests::RequestServer;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use tracing::{info, warn};
use upswing_ipc::{
    Clock, Command, CycleBegin, Domain, IpcError, Measurement, PlantPacing, PlantWake, Presence, Writer,
};
use upswing_process::notify::Notifier;

/// Shortest time between two warnings that the deadlines moved.
const WARNING_PERIOD: Duration = Duration::from_secs(1);

#[derive(Debug, thiserror::Error)]
pub(crate) enum ServiceError {
    #[error(transparent)]
    Ipc(#[from] IpcError),
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// Runs `plant` in `domain` until `shutdown` is raised. `watchdog_cycles`: cycles without a command after which the drives
/// close the brakes.
pub(crate) fn serve(
    clock: Clock,
    watchdog_cycles: u32,
    plant: Plant,
    domain: &Domain,
    shutdown: &AtomicBool,
) -> Result<(), ServiceError> {
    let node = domain.join("plant")?;
    // The server first: it fails for a second plant before that plant disturbs the daemon.
    let requests = RequestServer::new(&node)?;
    let commands = DaemonCommands::new(&node)?;
    let writer = node.writer::<Measurement>()?;
    wake_precisely();
    let mut process = PlantService {
        pacing: PlantPacing::new(clock, plant.period(), watchdog_cycles),
        plant,
        commands,
        writer,
        published: 0,
        requests,
        manager: Notifier::new(),
        daemon: Presence::Awaited,
        moves: 0,
        warned: None,
    };
    process.run(shutdown);
    Ok(())
}

/// The plant with its connections to the other processes.
struct PlantService {
    plant: Plant,
    pacing: PlantPacing,
    commands: DaemonCommands,
    writer: Writer<Measurement>,
    /// `seq` of the newest published measurement.
    published: u64,
    requests: RequestServer,
    manager: Notifier,
    /// Presence of the daemon that was logged last.
    daemon: Presence,
    /// Number of times that the deadlines moved.
    moves: u64,
    /// Time of the last warning of moved deadlines.
    warned: Option<Instant>,
}

impl PlantService {
    fn run(&mut self, shutdown: &AtomicBool) {
        let clock = self.pacing.clock();
        let q = self.plant.position().map(|v| (v.to_degrees() * 100.0).round() / 100.0);
        info!(%clock, q_deg = ?q.as_slice(), "plant started, brakes closed");
        self.manager.ready();
        self.manager.status(&format!("clock {clock}"));
        while let Some(wake) = self.pacing.wait(&mut self.commands, self.plant.seq(), shutdown) {
            self.log_presence();
            match wake {
                PlantWake::Begin(begin) => self.publish(begin),
                PlantWake::End(command) => {
                    self.step(command.as_ref());
                    self.serve_requests();
                }
                PlantWake::Idle => self.serve_requests(),
            }
        }
        self.manager.stopping();
        info!(cycle = self.plant.completed(), "plant stopped");
    }

    /// Publishes the measurement of the cycle that begins, unless a fault withholds it from the daemon.
    fn publish(&mut self, begin: CycleBegin) {
        if begin.moved_ns > 0 {
            self.warn_of_moved_deadlines(begin.moved_ns);
        }
        let measurement = self.plant.measure();
        let new = measurement.seq != self.published;
        if new {
            self.published = measurement.seq;
            // The age of a delayed measurement or a stale time is the same on all clocks.
            let age = self.plant.time_ns().saturating_sub(measurement.t_ns);
            let t_ns = begin.deadline_ns.map_or(measurement.t_ns, |now| now.saturating_sub(age));
            self.writer.write(Measurement { t_ns, clock: self.pacing.clock().code(), ..measurement });
        }
        self.pacing.publish(new.then_some(measurement.seq));
    }

    fn step(&mut self, command: Option<&Command>) {
        let plant = &mut self.plant;
        let (before, cycle) = (plant.brakes_closed(), plant.seq());
        plant.step(command);
        match (before, plant.brakes_closed()) {
            (true, false) => info!(cycle, "brakes released"),
            (false, true) => info!(cycle, drive_fault = plant.drive_fault(), "brakes closed"),
            _ => {}
        }
    }

    fn serve_requests(&mut self) {
        self.manager.alive();
        self.requests.serve(&mut self.plant, &mut self.pacing);
    }

    fn log_presence(&mut self) {
        let (cycle, daemon) = (self.plant.seq(), self.pacing.daemon());
        if self.daemon == daemon {
            return;
        }
        self.daemon = daemon;
        match daemon {
            Presence::Awaited => {}
            Presence::Present => info!(cycle, "daemon found"),
            Presence::Lost { silence } if self.pacing.clock().is_real_time() => {
                warn!(cycle, silence_s = silence, "daemon lost: no fresh command");
            }
            Presence::Lost { silence } => warn!(cycle, "daemon lost: no answer for {silence:.0} s"),
        }
    }

    fn warn_of_moved_deadlines(&mut self, late_ns: u64) {
        self.moves += 1;
        if self.warned.is_none_or(|warned| warned.elapsed() >= WARNING_PERIOD) {
            self.warned = Some(Instant::now());
            let (cycle, moves) = (self.plant.seq(), self.moves);
            warn!(cycle, moves, "the plant is {} us late: its deadlines move", late_ns / 1000);
        }
    }
}

/// Asks for wake-ups of this thread without the usual slack of 50 us, which is half a control period.
fn wake_precisely() {
    const SLACK_NS: libc::c_ulong = 1;
    // SAFETY: this option takes one number and concerns the calling thread only. If refused, wake-ups are later.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, SLACK_NS) };
}
