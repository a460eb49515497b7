//! A system of three processes in a shared-memory domain of its own, and the means to drive it.

use crate::recording::{Recorder, RecordingError, Tally};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use upswing_ipc::{
    CallError, Client, Clock, ControlCommand, ControlRequest, ControlResponse, Domain, IpcError, Node,
    PlannerKind, PlannerRequest, PlannerResponse, PlantKind, PlantRequest, PlantResponse, Subscriber,
    Telemetry, TelemetryBatch,
};

/// How long a process may take to appear: starting takes well below a second, but machines are shared.
const START_PATIENCE: Duration = Duration::from_secs(30);
/// How long an answer may take. A replan takes about a second at worst.
const ANSWER_PATIENCE: Duration = Duration::from_secs(30);
/// How long a process may take to end after SIGTERM.
const END_PATIENCE: Duration = Duration::from_secs(10);
/// Pause between two looks at something awaited.
const PAUSE: Duration = Duration::from_millis(1);

/// Why a system could not be started or driven.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A program could not be started.
    #[error("cannot start the {role} ({program}): {cause}")]
    Spawn {
        /// daemon, planner or plant.
        role: &'static str,
        /// What was to be executed.
        program: String,
        /// Why not.
        cause: std::io::Error,
    },
    /// A process ended by itself.
    #[error("the {role} ended unexpectedly ({status}){log}")]
    Ended {
        /// daemon, planner or plant.
        role: &'static str,
        /// Exit status.
        status: std::process::ExitStatus,
        /// The last lines of its log.
        log: String,
    },
    /// Something awaited did not happen.
    #[error("waited {waited:.0?} for {what}{log}")]
    Timeout {
        /// What was awaited.
        what: String,
        /// How long.
        waited: Duration,
        /// The last lines of the logs.
        log: String,
    },
    /// A request was refused.
    #[error("the {role} refused: {reason}")]
    Refused {
        /// Who refused.
        role: &'static str,
        /// Why.
        reason: String,
    },
    /// No answer.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Shared memory.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
}

/// The programs of a system, without the options that [`Session::start`] adds.
#[derive(Debug)]
pub struct Programs {
    /// Starts the daemon.
    pub daemon: Command,
    /// Starts the planner.
    pub planner: Command,
    /// Starts the plant simulator.
    pub plant: Command,
}

impl Programs {
    /// The `upswing` program itself in each of the three roles.
    ///
    /// # Errors
    /// If the path of the running program cannot be found out.
    pub fn own() -> std::io::Result<Self> {
        let program = std::env::current_exe()?;
        let role = |name| {
            let mut c = Command::new(&program);
            c.arg(name);
            c
        };
        Ok(Self { daemon: role("daemon"), planner: role("planner"), plant: role("plant") })
    }

    /// The three dedicated programs in `folder`.
    pub fn dedicated(folder: &Path) -> Self {
        Self {
            daemon: Command::new(folder.join("upswingd")),
            planner: Command::new(folder.join("upswing-planner")),
            plant: Command::new(folder.join("upswing-plant")),
        }
    }
}

/// What to start.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder with settings; `None`: the embedded ones.
    pub config: Option<PathBuf>,
    /// Name of the domain.
    pub domain: String,
    /// Clock of the plant.
    pub clock: Clock,
    /// Start pose of the arm, deg, comma-separated; `None`: as the plant's settings say.
    pub start: Option<String>,
    /// Scenario of the plant; `None`: as its settings say.
    pub scenario: Option<String>,
    /// Folder for the logs of the processes.
    pub logs: PathBuf,
}

/// One process of the system; ended when dropped.
struct Process {
    role: &'static str,
    child: Child,
    log: PathBuf,
}

impl Process {
    fn start(
        role: &'static str,
        mut command: Command,
        options: &Options,
        extra: &[String],
    ) -> Result<Self, SessionError> {
        let program = command.get_program().to_string_lossy().into_owned();
        let spawn = |cause| SessionError::Spawn { role, program: program.clone(), cause };
        let log = options.logs.join(format!("{role}.log"));
        let file = std::fs::File::create(&log).map_err(spawn)?;
        command.args(["--domain", &options.domain]).args(extra);
        if let Some(config) = &options.config {
            command.arg("--config").arg(config);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(file);
        die_with_parent(&mut command);
        let child = command.spawn().map_err(spawn)?;
        Ok(Self { role, child, log })
    }

    fn check(&mut self) -> Result<(), SessionError> {
        match self.child.try_wait() {
            Ok(Some(status)) => Err(SessionError::Ended { role: self.role, status, log: self.tail() }),
            _ => Ok(()),
        }
    }

    /// The last lines of the log.
    fn tail(&self) -> String {
        /// Enough for an error and what led to it.
        const LINES: usize = 5;
        let text = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<_> = text.lines().collect();
        let tail = &lines[lines.len().saturating_sub(LINES)..];
        if tail.is_empty() { String::new() } else { format!("; its log ends with:\n  {}", tail.join("\n  ")) }
    }

    fn signal(&self, signal: i32) {
        // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
        unsafe { libc::kill(self.child.id() as libc::pid_t, signal) };
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// The kernel ends the child if this process dies without doing so.
fn die_with_parent(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    // SAFETY: prctl is async-signal-safe; the closure allocates nothing and touches no lock.
    unsafe {
        command.pre_exec(|| {
            libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
            Ok(())
        });
    }
}

/// Who of the system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// upswingd
    Daemon,
    /// upswing-planner
    Planner,
    /// upswing-plant
    Plant,
}

/// A running system.
pub struct Session {
    processes: [Option<Process>; 3],
    control: Client<ControlRequest>,
    planner: Client<PlannerRequest>,
    plant: Client<PlantRequest>,
    telemetry: Subscriber<TelemetryBatch>,
    node: Node,
    domain: Domain,
    clock: Clock,
    /// Every record received so far.
    pub records: Vec<Telemetry>,
    /// Takes every record, too; [`Session::end`] completes it.
    pub recorder: Option<Recorder>,
    tally: Tally,
}

impl Session {
    /// Starts the three processes and waits until each answers.
    ///
    /// # Errors
    /// [`SessionError`] with the end of the log of the process that failed.
    pub fn start(programs: Programs, options: &Options) -> Result<Self, SessionError> {
        let domain = Domain::new(&options.domain)
            .map_err(|e| SessionError::Refused { role: "domain", reason: e.to_string() })?;
        let node = domain.connect("session")?;
        let (control, planner, plant) =
            (node.control_client()?, node.planner_client()?, node.plant_client()?);
        let telemetry = node.telemetry_subscriber()?;
        let mut plant_options = vec!["--clock".into(), options.clock.to_string()];
        if let Some(start) = &options.start {
            plant_options.push(format!("--start={start}"));
        }
        if let Some(scenario) = &options.scenario {
            plant_options.push(format!("--scenario={scenario}"));
        }
        let processes = [
            Some(Process::start("daemon", programs.daemon, options, &[])?),
            Some(Process::start("planner", programs.planner, options, &[])?),
            Some(Process::start("plant", programs.plant, options, &plant_options)?),
        ];
        let mut session = Self {
            processes,
            control,
            planner,
            plant,
            telemetry,
            node,
            domain,
            clock: options.clock,
            records: Vec::new(),
            recorder: None,
            tally: Tally::default(),
        };
        session.wait_for("all three processes to answer", START_PATIENCE, |s| {
            Ok(s.control.has_server() && s.planner.has_server() && s.plant.has_server())
        })?;
        Ok(session)
    }

    /// Records that were lost on the way here.
    pub fn dropped(&self) -> u64 {
        self.tally.lost
    }

    /// Process id of a role; `None` if it was ended.
    pub fn pid(&self, role: Role) -> Option<u32> {
        self.processes[role as usize].as_ref().map(|p| p.child.id())
    }

    /// Kills a process (SIGKILL) and reaps it.
    pub fn kill(&mut self, role: Role) {
        self.processes[role as usize] = None;
    }

    /// The domain that the system runs in.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// This process's connection to the domain.
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// Sends a command to the daemon and expects it to be accepted.
    ///
    /// # Errors
    /// [`SessionError::Refused`] with the daemon's reason.
    pub fn control(&mut self, command: ControlCommand) -> Result<ControlResponse, SessionError> {
        let response = self.ask_control(command)?;
        if response.accepted == 1 {
            Ok(response)
        } else {
            Err(SessionError::Refused { role: "daemon", reason: text(&response.reason) })
        }
    }

    /// Sends a command to the daemon; the answer may be a refusal.
    ///
    /// # Errors
    /// [`SessionError::Call`] if no answer comes.
    pub fn ask_control(&mut self, command: ControlCommand) -> Result<ControlResponse, SessionError> {
        Ok(self.control.call(&ControlRequest::new(command), ANSWER_PATIENCE)?)
    }

    /// Asks for a swing-up or swing-down from the present state and publishes it to the daemon.
    ///
    /// # Errors
    /// [`SessionError::Refused`] with the planner's reason.
    pub fn plan_from_now(&mut self, kind: PlannerKind) -> Result<PlannerResponse, SessionError> {
        let request =
            PlannerRequest { kind: kind.code(), from_now: 1, publish: 1, ..PlannerRequest::default() };
        let response = self.planner.call(&request, ANSWER_PATIENCE)?;
        if response.plan_id == 0 {
            return Err(SessionError::Refused { role: "planner", reason: text(&response.reason) });
        }
        Ok(response)
    }

    /// Sends a request to the plant and expects it to be accepted.
    ///
    /// # Errors
    /// [`SessionError::Refused`] with the plant's reason.
    pub fn plant(&mut self, request: &PlantRequest) -> Result<PlantResponse, SessionError> {
        let response = self.plant.call(request, ANSWER_PATIENCE)?;
        if response.accepted == 1 {
            Ok(response)
        } else {
            Err(SessionError::Refused { role: "plant", reason: text(&response.reason) })
        }
    }

    /// The plant's cycle number and true state.
    ///
    /// # Errors
    /// [`SessionError::Call`] if no answer comes.
    pub fn plant_status(&mut self) -> Result<PlantResponse, SessionError> {
        self.plant(&PlantRequest { kind: PlantKind::Status.code(), ..PlantRequest::default() })
    }

    /// In lockstep: lets the plant run `cycles` more and waits until the daemon's record of the last one is here.
    /// On the other clocks: waits until that many more cycles are recorded.
    ///
    /// # Errors
    /// [`SessionError::Timeout`] if time does not pass.
    pub fn advance(&mut self, cycles: u64) -> Result<(), SessionError> {
        /// Records fit into the daemon's ring with room to spare.
        const PORTION: u64 = 4000;
        let mut left = cycles;
        while left > 0 {
            let portion = left.min(PORTION);
            left -= portion;
            let goal = match self.clock {
                Clock::Lockstep => {
                    let seq = self.plant_status()?.seq + portion;
                    self.plant(&PlantRequest {
                        kind: PlantKind::AdvanceTo.code(),
                        seq,
                        ..Default::default()
                    })?;
                    seq
                }
                _ => self.last_measurement() + portion,
            };
            self.wait_for(&format!("cycle {goal}"), ANSWER_PATIENCE, |s| Ok(s.last_measurement() >= goal))?;
        }
        Ok(())
    }

    fn last_measurement(&self) -> u64 {
        self.records.last().map_or(0, |r| r.measurement_seq)
    }

    /// Waits until `done`, collecting telemetry; checks that no process has ended meanwhile.
    ///
    /// # Errors
    /// [`SessionError::Timeout`], or whatever `done` says.
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
            for process in self.processes.iter_mut().flatten() {
                process.check()?;
            }
            let waited = begin.elapsed();
            if waited > patience {
                let log = self.processes.iter().flatten().map(Process::tail).collect();
                return Err(SessionError::Timeout { what: what.into(), waited, log });
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Takes all telemetry that is waiting.
    ///
    /// # Errors
    /// [`SessionError::Ipc`], [`SessionError::Recording`].
    pub fn collect(&mut self) -> Result<(), SessionError> {
        while let Some(batch) = self.telemetry.receive()? {
            let begin = self.records.len();
            self.records.extend_from_slice(batch.used());
            let new = &self.records[begin..];
            new.iter().for_each(|record| self.tally.count(record));
            if let Some(recorder) = &mut self.recorder {
                recorder.write(new)?;
            }
        }
        Ok(())
    }

    /// Ends the system: SIGTERM to the daemon, which stops the arm and closes the brakes, then to the others.
    ///
    /// # Errors
    /// [`SessionError::Ended`] if a process ends with an error, [`SessionError::Timeout`] if one does not end.
    pub fn end(mut self) -> Result<Vec<Telemetry>, SessionError> {
        self.end_in_place()?;
        Ok(std::mem::take(&mut self.records))
    }

    /// As [`Self::end`], for a session that is not one's own; keeps the records.
    ///
    /// # Errors
    /// As [`Self::end`].
    pub fn end_in_place(&mut self) -> Result<(), SessionError> {
        for i in [Role::Daemon, Role::Planner, Role::Plant].map(|r| r as usize) {
            let Some(process) = &self.processes[i] else { continue };
            process.signal(libc::SIGTERM);
            let begin = Instant::now();
            loop {
                self.collect()?;
                if self.clock == Clock::Lockstep && i == Role::Daemon as usize {
                    // The daemon needs cycles to stop the arm in.
                    if let Ok(now) = self.plant_status() {
                        let seq = now.seq + 100;
                        let request =
                            PlantRequest { kind: PlantKind::AdvanceTo.code(), seq, ..Default::default() };
                        self.plant(&request)?;
                    }
                }
                let Some(process) = &mut self.processes[i] else { break };
                match process.child.try_wait() {
                    Ok(Some(status)) if status.success() => break,
                    Ok(Some(status)) => {
                        return Err(SessionError::Ended { role: process.role, status, log: process.tail() });
                    }
                    _ if begin.elapsed() > END_PATIENCE => {
                        return Err(SessionError::Timeout {
                            what: format!("the {} to end", process.role),
                            waited: begin.elapsed(),
                            log: process.tail(),
                        });
                    }
                    _ => std::thread::sleep(PAUSE),
                }
            }
            self.processes[i] = None;
        }
        if let Some(recorder) = self.recorder.take() {
            recorder.finish()?;
        }
        Ok(())
    }
}

/// A text from shared memory, whatever is in it.
fn text(text: &upswing_ipc::Text) -> String {
    text.as_str().map_or_else(|e| e.to_string(), str::to_owned)
}

/// Ends like a session does, and removes what the domain left in shared memory.
pub struct CleanUp(pub Domain);

impl Drop for CleanUp {
    fn drop(&mut self) {
        let _ = self.0.remove_if_unused();
    }
}
