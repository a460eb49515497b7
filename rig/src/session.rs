//! Daemon, planner and plant as three processes in a shared-memory domain of their own: start, requests, telemetry, shutdown.

mod process;

pub use process::{Programs, Role, SessionOptions};

use process::SystemProcess;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use upswing_ipc::operator::{Operator, OperatorError, OperatorRequest, PublishedPlan};
use upswing_ipc::{
    CallError, Client, ControlKind, ControlRequest, ControlResponse, Domain, DomainError, IpcError,
    ManoeuvreRequest, Node, PlannerResponse, PlantKind, PlantRequest, PlantResponse, Readiness, Telemetry,
};
use upswing_record::{Recorder, RecordingError, Tally, Tap};

/// Longest wait for a process to start; a start takes well below a second on an idle machine.
const START_PATIENCE: Duration = Duration::from_secs(30);
/// Longest wait for a response. A replan takes about a second at worst.
const RESPONSE_PATIENCE: Duration = Duration::from_secs(30);
/// Longest wait for the exit of a process after SIGTERM.
const END_PATIENCE: Duration = Duration::from_secs(30);
/// Time without the awaited telemetry after which plant and daemon are asked whether more will come.
const SILENCE: Duration = Duration::from_millis(100);
/// Pause between two checks of an awaited condition.
const PAUSE: Duration = Duration::from_millis(1);
/// Flag of a wait that nobody interrupts.
pub(crate) static NEVER: AtomicBool = AtomicBool::new(false);

/// Error of starting or driving a system.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A program could not be started.
    #[error("cannot start the {role} ({program}): {cause}")]
    Spawn {
        /// Role of the process: daemon, planner or plant.
        role: &'static str,
        /// Path of the program.
        program: String,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// A process exited unexpectedly or with an error.
    #[error("the {role} ended unexpectedly ({status}){log}")]
    Ended {
        /// Role of the process: daemon, planner or plant.
        role: &'static str,
        /// Exit status of the process.
        status: std::process::ExitStatus,
        /// The last lines of the log of the process.
        log: String,
    },
    /// An awaited condition did not occur in time.
    #[error("waited {waited:.0?} for {what}{log}")]
    Timeout {
        /// The awaited condition.
        what: String,
        /// Duration of the wait.
        waited: Duration,
        /// The last lines of the logs; may be empty.
        log: String,
    },
    /// The name of the domain is invalid.
    #[error("the domain refused: {0}")]
    Domain(#[from] DomainError),
    /// The plant refused a request.
    #[error("the plant refused: {0}")]
    Plant(String),
    /// The daemon left the expected modes.
    #[error(
        "the daemon refused: it is in mode {mode}{}",
        fault.map_or_else(String::new, |fault| format!(": {fault}"))
    )]
    Mode {
        /// Mode of the daemon.
        mode: String,
        /// Description of the fault of the daemon, if it has one.
        fault: Option<&'static str>,
    },
    /// Daemon or planner refused a request.
    #[error(transparent)]
    Operator(OperatorError),
    /// A request got no response.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Shared memory cannot be used.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The recording cannot be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The user interrupted the run (Ctrl-C).
    #[error("interrupted")]
    Interrupted,
}

impl From<OperatorError> for SessionError {
    fn from(e: OperatorError) -> Self {
        match e {
            OperatorError::Call(e) => Self::Call(e),
            OperatorError::Ipc(e) => Self::Ipc(e),
            e => Self::Operator(e),
        }
    }
}

/// A running system of daemon, planner and plant, with connections to all three.
pub struct Session {
    programs: Programs,
    options: SessionOptions,
    processes: [Option<SystemProcess>; 3],
    operator: Operator,
    plant: Client<PlantRequest>,
    tap: Tap,
    node: Node,
    /// Every telemetry record received so far.
    pub records: Vec<Telemetry>,
    /// Recording of all topics; [`Self::end`] completes the file.
    recorder: Option<Recorder>,
    tally: Tally,
}

impl Session {
    /// Starts the three processes and waits until each responds. `recorder` records from the first cycle on.
    ///
    /// # Errors
    /// [`SessionError`] with the end of the log of the process that failed.
    pub fn start(
        programs: Programs,
        options: &SessionOptions,
        recorder: Option<Recorder>,
    ) -> Result<Self, SessionError> {
        let node = Domain::new(&options.domain)?.join("session")?;
        let (operator, plant) = (Operator::with_patience(&node, RESPONSE_PATIENCE)?, node.client()?);
        let tap = Tap::new(&node)?;
        let start = |role| SystemProcess::start(role, &programs, options).map(Some);
        let processes = [start(Role::Daemon)?, start(Role::Planner)?, start(Role::Plant)?];
        let mut session = Self {
            programs,
            options: options.clone(),
            processes,
            operator,
            plant,
            tap,
            node,
            records: Vec::new(),
            recorder,
            tally: Tally::default(),
        };
        session.wait_for("all three processes to answer", START_PATIENCE, |s| {
            Ok(s.operator.has_daemon() && s.operator.has_planner()? && s.plant.has_server())
        })?;
        Ok(session)
    }

    /// Number of telemetry records lost between the daemon and this process.
    pub fn dropped(&self) -> u64 {
        self.tally.lost
    }

    /// Process id of a role; `None` if the process was killed or shut down.
    pub fn pid(&self, role: Role) -> Option<u32> {
        self.processes[role as usize].as_ref().map(|p| p.child.id())
    }

    /// Kills the process of a role (SIGKILL) and waits for its exit.
    pub fn kill(&mut self, role: Role) {
        self.processes[role as usize] = None;
    }

    /// Sends a signal to the process of a role, if it runs.
    pub fn signal(&mut self, role: Role, signal: i32) {
        if let Some(process) = &mut self.processes[role as usize] {
            process.signal(signal);
        }
    }

    /// Kills the process of a role if it runs, starts a new one, and waits until it responds.
    ///
    /// # Errors
    /// [`SessionError`] if the new process cannot be started or does not respond.
    pub fn restart(&mut self, role: Role) -> Result<(), SessionError> {
        self.kill(role);
        self.processes[role as usize] = Some(SystemProcess::start(role, &self.programs, &self.options)?);
        self.wait_for("the new process to answer", START_PATIENCE, |s| {
            Ok(match role {
                Role::Daemon => s.operator.has_daemon(),
                Role::Planner => s.operator.has_planner()?,
                Role::Plant => s.plant.has_server(),
            })
        })
    }

    /// Shuts down the process of a role with SIGTERM and waits for its exit.
    ///
    /// # Errors
    /// [`SessionError::Ended`] if the process exits with an error, [`SessionError::Timeout`] if it does not exit.
    pub fn end_process(&mut self, role: Role) -> Result<(), SessionError> {
        let i = role as usize;
        let Some(process) = &mut self.processes[i] else { return Ok(()) };
        process.signal(libc::SIGTERM);
        let begin = Instant::now();
        loop {
            self.collect()?;
            if self.options.clock.stands_still() && role == Role::Daemon {
                // The daemon needs further cycles to stop the arm.
                if let Ok(now) = self.plant_status() {
                    let seq = now.seq + 100;
                    let request = PlantRequest { seq, ..PlantRequest::new(PlantKind::AdvanceTo) };
                    self.plant(&request)?;
                }
            }
            let Some(process) = &mut self.processes[i] else { break };
            match process.child.try_wait() {
                Ok(Some(status)) if status.success() => break,
                Ok(Some(status)) => {
                    return Err(SessionError::Ended { role: role.name(), status, log: process.tail() });
                }
                _ if begin.elapsed() > END_PATIENCE => {
                    return Err(SessionError::Timeout {
                        what: format!("the {} to end", role.name()),
                        waited: begin.elapsed(),
                        log: process.tail(),
                    });
                }
                _ => std::thread::sleep(PAUSE),
            }
        }
        self.processes[i] = None;
        Ok(())
    }

    /// This process's connection to the domain of the system.
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// Waits until the drives are ready, enables the daemon, and returns its state. Setting `interrupted` ends the wait.
    ///
    /// # Errors
    /// [`SessionError::Interrupted`], or [`SessionError::Operator`] with the reason of a refusal.
    pub fn enable(&mut self, interrupted: &AtomicBool) -> Result<ControlResponse, SessionError> {
        if !self.options.clock.stands_still() {
            self.wait_for_drives(interrupted)?;
        }
        self.control(&ControlRequest::new(ControlKind::Enable))
    }

    /// Sends a request of the operator and returns the state of the daemon after it. `Enable` waits as [`Self::enable`] does.
    ///
    /// # Errors
    /// [`SessionError::Operator`] with the reason of a refusal.
    pub fn request(&mut self, request: OperatorRequest) -> Result<ControlResponse, SessionError> {
        if request == OperatorRequest::Enable {
            return self.enable(&NEVER);
        }
        match request.command() {
            Ok(command) => self.control(&ControlRequest::new(command)),
            Err(manoeuvre) => {
                self.start_manoeuvre(manoeuvre)?;
                self.status()
            }
        }
    }

    /// Waits until the daemon receives measurements and the plant receives commands; until then the daemon refuses to be enabled.
    /// No error after [`START_PATIENCE`]: the refusal that follows tells more than a timeout.
    fn wait_for_drives(&mut self, interrupted: &AtomicBool) -> Result<(), SessionError> {
        let ready = self.wait_for("the drives to be ready", START_PATIENCE, |s| {
            if interrupted.load(Ordering::Acquire) {
                return Err(SessionError::Interrupted);
            }
            let waits = [Ok(Readiness::NoMeasurement), Ok(Readiness::DrivesNotReady)];
            Ok(!waits.contains(&s.status()?.readiness()))
        });
        match ready {
            Err(SessionError::Timeout { .. }) => Ok(()),
            ready => ready,
        }
    }

    /// Requests the state of the daemon.
    ///
    /// # Errors
    /// [`SessionError::Operator`] if the daemon does not respond.
    pub fn status(&mut self) -> Result<ControlResponse, SessionError> {
        self.control(&ControlRequest::new(ControlKind::Status))
    }

    /// Plans a manoeuvre from the present state, waits until the daemon has loaded the plan and the plan is due, and starts the plan.
    ///
    /// # Errors
    /// [`SessionError::Operator`] with the reason of a refusal, [`SessionError::Timeout`] if the plan is not loaded.
    pub fn start_manoeuvre(&mut self, manoeuvre: &ManoeuvreRequest) -> Result<PlannerResponse, SessionError> {
        let response = self.plan(manoeuvre)?;
        let plan = PublishedPlan::from(&response);
        self.wait_for("the daemon to load the plan and its time to come", RESPONSE_PATIENCE, |s| {
            let status = s.status()?;
            Ok(plan.is_due(status.plan_id, status.t_ns))
        })?;
        self.control(&ControlRequest::start(plan.id))?;
        Ok(response)
    }

    /// Lets the planner plan a manoeuvre from the present state and publish the plan to the daemon.
    ///
    /// # Errors
    /// [`SessionError::Operator`] with the reason of a refusal.
    pub fn plan(&mut self, manoeuvre: &ManoeuvreRequest) -> Result<PlannerResponse, SessionError> {
        let Self { operator, tap, recorder, records, tally, .. } = self;
        let collect = || collect(tap, recorder.as_mut(), records, tally);
        while_collecting(collect, |wanted| Ok(operator.plan(*manoeuvre, wanted)?))
    }

    fn control(&mut self, request: &ControlRequest) -> Result<ControlResponse, SessionError> {
        let Self { operator, tap, recorder, records, tally, .. } = self;
        let collect = || collect(tap, recorder.as_mut(), records, tally);
        while_collecting(collect, |wanted| Ok(operator.control(request, wanted)?))
    }

    /// Sends a request to the plant; a refusal is an error.
    ///
    /// # Errors
    /// [`SessionError::Plant`] with the reason of a refusal, [`SessionError::Call`] without a response.
    pub fn plant(&mut self, request: &PlantRequest) -> Result<PlantResponse, SessionError> {
        let Self { plant, tap, recorder, records, tally, .. } = self;
        let collect = || collect(tap, recorder.as_mut(), records, tally);
        let response =
            while_collecting(collect, |wanted| Ok(plant.call_while(request, RESPONSE_PATIENCE, wanted)?))?;
        if response.accepted == 1 {
            Ok(response)
        } else {
            Err(SessionError::Plant(response.reason.to_string()))
        }
    }

    /// Requests the status of the plant: its cycle number and its true state.
    ///
    /// # Errors
    /// [`SessionError::Call`] if the plant does not respond.
    pub fn plant_status(&mut self) -> Result<PlantResponse, SessionError> {
        self.plant(&PlantRequest::new(PlantKind::Status))
    }

    /// Lets `cycles` further control cycles pass. In lockstep: advances the plant and waits for the daemon's record of the last cycle
    /// or, if a fault suppresses its measurement, of the last cycle with a measurement. On other clocks: waits until so many further
    /// cycles are recorded.
    ///
    /// # Errors
    /// [`SessionError::Timeout`] if the cycles are not recorded in time.
    pub fn advance(&mut self, cycles: u64) -> Result<(), SessionError> {
        let goal = self.now()? + cycles;
        self.advance_to(goal)
    }

    /// Number of cycles that the plant has completed.
    ///
    /// # Errors
    /// [`SessionError::Call`] if the plant does not respond.
    pub fn now(&mut self) -> Result<u64, SessionError> {
        let plant = self.plant_status()?.seq;
        // In lockstep the records may be far behind the plant.
        Ok(if self.options.clock.stands_still() { plant } else { self.last_measurement().max(plant) })
    }

    /// As [`Self::advance`], until the plant has completed cycle `end`; returns at once if cycle `end` has passed.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn advance_to(&mut self, end: u64) -> Result<(), SessionError> {
        /// Cycles per portion; their records fit into the telemetry ring of the daemon.
        const PORTION: u64 = 4000;
        let mut goal = self.now()?;
        while goal < end {
            goal = end.min(goal + PORTION);
            if self.options.clock.stands_still() {
                self.plant(&PlantRequest { seq: goal, ..PlantRequest::new(PlantKind::AdvanceTo) })?;
            }
            let begin = Instant::now();
            self.wait_for(&format!("cycle {goal}"), RESPONSE_PATIENCE, |s| {
                let here = s.last_measurement() >= goal;
                Ok(here || (begin.elapsed() > SILENCE && s.has_passed(goal)?))
            })?;
        }
        Ok(())
    }

    /// True if the plant has completed cycle `goal` and all records of the daemon so far are received.
    fn has_passed(&mut self, goal: u64) -> Result<bool, SessionError> {
        let reached = self.plant_status()?.seq >= goal;
        if !reached || self.pid(Role::Daemon).is_none() {
            return Ok(reached);
        }
        let last = self.status()?.seq;
        Ok(self.records.last().map_or(0, |r| r.seq) >= last)
    }

    fn last_measurement(&self) -> u64 {
        self.records.last().map_or(0, |r| r.measurement_seq)
    }

    /// Waits until `done` returns true. Meanwhile collects telemetry and checks that all processes run.
    ///
    /// # Errors
    /// [`SessionError::Timeout`] after `patience`, [`SessionError::Ended`] if a process exited, or the error of `done`.
    pub fn wait_for(
        &mut self,
        what: &str,
        patience: Duration,
        mut done: impl FnMut(&mut Self) -> Result<bool, SessionError>,
    ) -> Result<(), SessionError> {
        let begin = Instant::now();
        loop {
            self.collect()?;
            if done(self)? {
                return Ok(());
            }
            self.check()?;
            let waited = begin.elapsed();
            if waited > patience {
                let log = self.processes.iter().flatten().map(SystemProcess::tail).collect();
                return Err(SessionError::Timeout { what: what.into(), waited, log });
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Checks that all processes run, except those killed or shut down by this session.
    ///
    /// # Errors
    /// [`SessionError::Ended`] with the end of the log of a process that exited.
    pub fn check(&mut self) -> Result<(), SessionError> {
        self.processes.iter_mut().flatten().try_for_each(SystemProcess::check)
    }

    /// Collects all pending telemetry and passes it to the recorder.
    ///
    /// # Errors
    /// [`SessionError::Recording`] if the recording cannot be written.
    pub fn collect(&mut self) -> Result<(), SessionError> {
        collect(&self.tap, self.recorder.as_mut(), &mut self.records, &mut self.tally)
    }

    /// Shuts down the system: SIGTERM to the daemon, which stops the arm and closes the brakes, then to planner and plant.
    ///
    /// # Errors
    /// [`SessionError::Ended`] if a process exits with an error, [`SessionError::Timeout`] if a process does not exit.
    pub fn end(&mut self) -> Result<(), SessionError> {
        Role::ALL.into_iter().try_for_each(|role| self.end_process(role))?;
        if let Some(recorder) = self.recorder.take() {
            recorder.finish()?;
        }
        Ok(())
    }
}

/// Makes a call and collects telemetry during the call: the telemetry ring holds about one second, and a response may take longer on
/// a busy machine.
fn while_collecting<T>(
    mut collect: impl FnMut() -> Result<(), SessionError>,
    call: impl FnOnce(&mut dyn FnMut() -> bool) -> Result<T, SessionError>,
) -> Result<T, SessionError> {
    let mut collected = Ok(());
    let response = call(&mut || {
        collected = collect();
        collected.is_ok()
    });
    collected?;
    response
}

fn collect(
    tap: &Tap,
    recorder: Option<&mut Recorder>,
    records: &mut Vec<Telemetry>,
    tally: &mut Tally,
) -> Result<(), SessionError> {
    tap.drain(recorder, |new| {
        records.extend_from_slice(new);
        new.iter().for_each(|record| tally.count(record));
    })?;
    Ok(())
}
