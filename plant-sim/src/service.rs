//! The process: the plant on its clock, its measurements, and the `plant` service.

use crate::clock::{Patience, wake_precisely};
use crate::link::Link;
use crate::{Plant, SetEventError};
use std::sync::atomic::{AtomicBool, Ordering};
use tracing::{info, warn};
use upswing_config::{Fault, FaultKind, Push};
use upswing_ipc::{
    Clock, Command, Domain, IpcError, Measurement, PlantKind, PlantRequest, PlantResponse, Server, Text,
    Writer, is_lost, monotonic_ns, sleep_until,
};
use upswing_model::JointVector;
use upswing_process::notify::Notifier;

/// Shortest time between two reports of the same trouble, ns.
const REPORT_PERIOD_NS: u64 = 1_000_000_000;
/// Longest time without a look at the requests, ns.
const SERVE_PERIOD_NS: u64 = 1_000_000;

#[derive(Debug, thiserror::Error)]
pub(crate) enum ServiceError {
    #[error(transparent)]
    Ipc(#[from] IpcError),
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// Runs the plant until `shutdown`. On the clock `wall` the daemon counts as lost after `watchdog_cycles` without a fresh
/// command.
pub(crate) fn serve(
    clock: Clock,
    watchdog_cycles: u32,
    plant: Plant,
    domain: &Domain,
    shutdown: &AtomicBool,
) -> Result<(), ServiceError> {
    let node = domain.connect("plant")?;
    // First: it refuses a second plant before that disturbs the daemon.
    let server = node.server::<PlantRequest>()?;
    let link = Link::new(&node)?;
    let writer = node.writer::<Measurement>()?;
    let front =
        Front { plant, clock, granted: 0, measured: false, server, failing: false, manager: Notifier::new() };
    Service { front, writer, published: 0, link, watchdog_cycles, shutdown }.run();
    Ok(())
}

/// Whether a daemon answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    /// None has sent a command yet.
    Awaited,
    Present,
    Lost,
}

struct Service<'a> {
    front: Front,
    writer: Writer<Measurement>,
    /// `seq` of the measurement published last.
    published: u64,
    link: Link,
    watchdog_cycles: u32,
    shutdown: &'a AtomicBool,
}

impl Service<'_> {
    fn run(mut self) {
        let q = self.front.plant.position().map(|v| (v.to_degrees() * 100.0).round() / 100.0);
        info!(clock = %self.front.clock, q_deg = ?q.as_slice(), "plant started, brakes closed");
        self.front.manager.ready();
        self.front.manager.status(&format!("clock {}", self.front.clock));
        wake_precisely();
        match self.front.clock {
            Clock::Wall => self.run_on_wall_clock(),
            Clock::Paced | Clock::Lockstep => self.run_with_daemon(),
        }
        self.front.manager.stopping();
        info!(cycle = self.front.completed(), "plant stopped");
    }

    fn stopped(&self) -> bool {
        self.shutdown.load(Ordering::Acquire)
    }

    /// Clock `wall`. Where the plant itself is late by less than the watchdog's time it catches up; if later, it moves
    /// its deadlines.
    fn run_on_wall_clock(&mut self) {
        let period = self.front.plant.period().nanos();
        let tolerated = period.saturating_mul(self.watchdog_cycles.into());
        let mut deadline = monotonic_ns();
        let mut presence = Presence::Awaited;
        let mut age = 0_u32;
        let (mut moves, mut next_report) = (0_u64, 0);
        while !self.stopped() {
            let now = monotonic_ns();
            let behind = now.saturating_sub(deadline);
            if behind > tolerated {
                deadline = now;
                moves += 1;
                if now >= next_report {
                    warn!(
                        cycle = self.front.plant.seq(),
                        moves,
                        "the plant is {} us late: its deadlines move",
                        behind / 1000
                    );
                    next_report = now.saturating_add(REPORT_PERIOD_NS);
                }
            }
            // The state is that of the deadline, even if this process is late to say so.
            self.publish(Some(deadline));
            let command = self.link.take(self.front.plant.seq());
            age = if command.is_some() { 0 } else { age.saturating_add(1) };
            if command.is_some() && presence != Presence::Present {
                presence = self.found();
            } else if presence == Presence::Present && age >= self.watchdog_cycles {
                warn!(cycle = self.front.plant.seq(), cycles = age, "daemon lost: no fresh command");
                presence = Presence::Lost;
            }
            self.step(command.as_ref());
            self.front.serve();
            deadline += period;
            self.wait_until(deadline);
        }
    }

    /// Clocks `paced` and `lockstep`.
    fn run_with_daemon(&mut self) {
        let paced = self.front.clock == Clock::Paced;
        let period = self.front.plant.period().nanos();
        let mut deadline = monotonic_ns();
        let mut presence = Presence::Awaited;
        while self.wait_for_grant() {
            // Of a daemon that was not there a cycle ago: this cycle waits for it.
            if presence != Presence::Present && self.link.take(self.front.completed()).is_some() {
                presence = self.found();
            }
            let shown = self.publish(None);
            let mut due = 0;
            if paced {
                // The answer comes meanwhile: to wait for it costs one sleep.
                deadline = deadline.saturating_add(period);
                self.wait_until(deadline);
                due = monotonic_ns();
                // This process does not make up for what it was late itself.
                deadline = deadline.max(due.saturating_sub(period));
            }
            let waits = presence == Presence::Present || (presence == Presence::Awaited && !paced);
            let mut answer = None;
            if let Some(shown) = shown
                && waits
            {
                answer = self.wait_for_answer(shown, &mut presence);
            }
            if self.stopped() {
                break;
            }
            if paced {
                // A late answer moves all later deadlines.
                deadline = deadline.saturating_add(monotonic_ns().saturating_sub(due));
            }
            if presence != Presence::Present
                && let Some(command) = self.link.take(self.front.plant.seq())
            {
                presence = self.found();
                answer = Some(command).filter(|c| Some(c.measurement_seq) == shown);
            }
            self.step(answer.as_ref());
            self.front.serve();
        }
    }

    /// Lockstep: waits until the next cycle is granted. False on shutdown.
    fn wait_for_grant(&mut self) -> bool {
        let mut patience = Patience::new();
        while self.front.clock == Clock::Lockstep && self.front.completed() >= self.front.granted {
            if patience.pause() {
                self.front.serve();
                if self.stopped() {
                    return false;
                }
            }
        }
        !self.stopped()
    }

    /// Waits for the command that answers the measurement `seq`; None if the daemon is lost or on shutdown.
    fn wait_for_answer(&mut self, seq: u64, presence: &mut Presence) -> Option<Command> {
        let paced = self.front.clock == Clock::Paced;
        let mut patience = if paced { Patience::gentle() } else { Patience::new() };
        let newest = self.front.plant.seq();
        loop {
            if let Some(command) = self.link.take(newest) {
                if *presence != Presence::Present {
                    *presence = self.found();
                    patience = Patience::gentle();
                }
                if command.measurement_seq == seq {
                    return Some(command);
                }
            }
            if !patience.pause() {
                continue;
            }
            self.front.serve();
            if self.stopped() {
                return None;
            }
            if *presence == Presence::Present && is_lost(self.link.daemon_lives(), patience.waited()) {
                warn!(cycle = seq, "daemon lost: no answer for {:.0} s", patience.waited().as_secs_f64());
                *presence = Presence::Lost;
                return None;
            }
        }
    }

    fn found(&self) -> Presence {
        info!(cycle = self.front.plant.seq(), "daemon found");
        Presence::Present
    }

    /// Publishes what the daemon finds in this cycle; its number if that is something new. Its time is simulated unless
    /// the cycle's (CLOCK_MONOTONIC, ns) is given.
    fn publish(&mut self, now: Option<u64>) -> Option<u64> {
        self.front.measured = true;
        let plant = &self.front.plant;
        let measured = plant.measure();
        if measured.seq == self.published {
            return None;
        }
        self.published = measured.seq;
        // A late measurement, or a stale time, is as old on one clock as on the other.
        let simulated = plant.period().nanos_of(plant.seq());
        let t_ns =
            now.map_or(measured.t_ns, |now| now.saturating_sub(simulated.saturating_sub(measured.t_ns)));
        self.writer.write(Measurement { t_ns, clock: self.front.clock.code(), ..measured });
        Some(measured.seq)
    }

    fn step(&mut self, command: Option<&Command>) {
        let plant = &mut self.front.plant;
        let (before, seq) = (plant.brakes_closed(), plant.seq());
        plant.step(command);
        self.front.measured = false;
        match (before, plant.brakes_closed()) {
            (true, false) => info!(cycle = seq, "brakes released"),
            (false, true) => info!(cycle = seq, drive_fault = plant.drive_fault(), "brakes closed"),
            _ => {}
        }
    }

    /// Serves requests until `deadline` (CLOCK_MONOTONIC, ns) or shutdown.
    fn wait_until(&mut self, deadline: u64) {
        loop {
            let now = monotonic_ns();
            if now >= deadline || self.stopped() {
                return;
            }
            let next_look = now.saturating_add(SERVE_PERIOD_NS);
            sleep_until(deadline.min(next_look));
            if next_look < deadline {
                self.front.serve();
            }
        }
    }
}

/// The `plant` service, and what its requests concern.
struct Front {
    plant: Plant,
    clock: Clock,
    /// Cycle up to which lockstep may advance.
    granted: u64,
    /// Whether the daemon could see the measurement of this cycle already.
    measured: bool,
    server: Server<PlantRequest>,
    /// Whether the service failed when it was looked at last.
    failing: bool,
    manager: Notifier,
}

impl Front {
    /// The last cycle whose measurement is answered and whose period is over.
    fn completed(&self) -> u64 {
        self.plant.seq().saturating_sub(1)
    }

    /// Answers all waiting requests.
    fn serve(&mut self) {
        let Self { plant, clock, granted, measured, server, failing, manager } = self;
        manager.alive();
        let next = plant.seq() + u64::from(*measured);
        let outcome = server.poll(|request| answer(plant, *clock, granted, next, request));
        if let Err(e) = &outcome
            && !*failing
        {
            warn!("{e}");
        }
        *failing = outcome.is_err();
    }
}

/// Does what a request asks, or says why not. `next`: the first cycle that it can concern.
fn answer(
    plant: &mut Plant,
    clock: Clock,
    granted: &mut u64,
    next: u64,
    request: &PlantRequest,
) -> PlantResponse {
    let outcome = match request.kind() {
        Err(e) => Err(e.to_string()),
        Ok(PlantKind::Status) => Ok(()),
        Ok(PlantKind::ResetState) => plant
            .reset(&JointVector::from(request.q), &JointVector::from(request.qd))
            .map_err(|e| e.to_string()),
        Ok(PlantKind::AdvanceTo) => advance_to(clock, granted, request.seq),
        Ok(PlantKind::SetFault) => {
            first_cycle(next, request).and_then(|from| set_fault(plant, from, request))
        }
        Ok(PlantKind::ClearFaults) => {
            plant.clear_faults();
            Ok(())
        }
        Ok(PlantKind::Push) => first_cycle(next, request).and_then(|from| {
            let push = Push { from, cycles: request.cycles, impulse: request.impulse };
            plant.push(&push).map_err(|e| e.to_string())
        }),
    };
    PlantResponse {
        accepted: outcome.is_ok().into(),
        seq: plant.seq().saturating_sub(1),
        q: (*plant.position()).into(),
        qd: (*plant.velocity()).into(),
        brakes_closed: plant.brakes_closed().into(),
        tau_peak: (*plant.tau_peak()).into(),
        reason: Text::new(&outcome.err().unwrap_or_default()),
    }
}

fn set_fault(plant: &mut Plant, from: u64, request: &PlantRequest) -> Result<(), String> {
    let kind = usize::try_from(request.fault).ok().and_then(|code| FaultKind::all().get(code));
    let Some(kind) = kind.copied() else {
        let max = FaultKind::all().len() - 1;
        return Err(format!("fault: expected a code from 0 to {max}, got {}", request.fault));
    };
    // Joint 0, of kinds without one, is none either.
    let joint = usize::try_from(request.joint).unwrap_or(usize::MAX).wrapping_sub(1);
    let (cycles, amount) = (request.cycles, request.amount);
    let fault = Fault { kind, from, cycles, joint, amount };
    plant.set_fault(&fault).map_err(|e| e.to_string())
}

/// First cycle of what a request asks for.
fn first_cycle(next: u64, request: &PlantRequest) -> Result<u64, String> {
    match request.seq {
        0 => Ok(next),
        got if got < next => Err(SetEventError::Past { next, got }.to_string()),
        seq => Ok(seq),
    }
}

fn advance_to(clock: Clock, granted: &mut u64, seq: u64) -> Result<(), String> {
    if clock != Clock::Lockstep {
        return Err(format!("the {clock} clock advances by itself: start the plant with --clock lockstep"));
    }
    if seq < *granted {
        return Err(format!("cycle {granted} is granted already: expected at least that, got {seq}"));
    }
    *granted = seq;
    Ok(())
}
