//! The processes of a system: programs, options, start, signals and logs.

use super::SessionError;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use upswing_config::System;
use upswing_ipc::Clock;

/// Role of a process in the system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// upswingd
    Daemon,
    /// upswing-planner
    Planner,
    /// upswing-plant
    Plant,
}

impl Role {
    /// All roles, in the order in which their processes are started and shut down.
    pub const ALL: [Self; 3] = [Self::Daemon, Self::Planner, Self::Plant];

    /// Name of the role in messages and file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Daemon => "daemon",
            Self::Planner => "planner",
            Self::Plant => "plant",
        }
    }
}

/// The programs of a system, without the options that [`super::Session::start`] adds.
#[derive(Clone, Debug)]
pub struct Programs {
    /// Path and first argument, if there is one, of each [`Role`].
    programs: [(PathBuf, Option<&'static str>); 3],
}

impl Programs {
    /// The `upswing` program itself in each of the three roles.
    ///
    /// # Errors
    /// [`SessionError::Spawn`] if the path of the running program is unknown.
    pub fn own() -> Result<Self, SessionError> {
        let unknown = |cause| SessionError::Spawn { role: "daemon", program: "upswing".into(), cause };
        let program = std::env::current_exe().map_err(unknown)?;
        Ok(Self { programs: Role::ALL.map(|role| (program.clone(), Some(role.name()))) })
    }

    /// The three dedicated programs `upswingd`, `upswing-planner` and `upswing-plant` in `folder`.
    pub fn dedicated(folder: &Path) -> Self {
        let names = ["upswingd", "upswing-planner", "upswing-plant"];
        Self { programs: names.map(|name| (folder.join(name), None)) }
    }

    fn command(&self, role: Role) -> Command {
        let (program, argument) = &self.programs[role as usize];
        let mut command = Command::new(program);
        command.args(*argument);
        command
    }
}

/// Options of a session: settings, domain, clock, start, scenario and logs.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Robot with its settings.
    pub system: System,
    /// Name of the shared-memory domain.
    pub domain: String,
    /// Clock of the plant.
    pub clock: Clock,
    /// Start positions of the actuated joints, deg or m, comma-separated; `None`: those of the plant's settings.
    pub start: Option<String>,
    /// Scenario of the plant; `None`: the plant's settings without a scenario.
    pub scenario: Option<String>,
    /// Folder for the logs of the processes.
    pub logs: PathBuf,
}

/// One process of the system; killed when dropped.
pub(super) struct SystemProcess {
    pub role: Role,
    pub child: Child,
    log: PathBuf,
}

impl SystemProcess {
    pub(super) fn start(
        role: Role,
        programs: &Programs,
        options: &SessionOptions,
    ) -> Result<Self, SessionError> {
        let mut command = programs.command(role);
        let program = command.get_program().to_string_lossy().into_owned();
        let spawn = |cause| SessionError::Spawn { role: role.name(), program: program.clone(), cause };
        let log = options.logs.join(format!("{}.log", role.name()));
        // A restarted process appends to the log of its predecessor.
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&log).map_err(spawn)?;
        command.args(["--domain", &options.domain]).arg("--system").arg(options.system.option());
        if role == Role::Plant {
            command.args(["--clock", &options.clock.to_string()]);
            command.args(options.start.iter().map(|start| format!("--start={start}")));
            command.args(options.scenario.iter().map(|scenario| format!("--scenario={scenario}")));
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(file);
        die_with_parent(&mut command);
        // A process group of its own: Ctrl-C in the terminal reaches this process only, which then shuts down its children.
        command.process_group(0);
        let child = command.spawn().map_err(spawn)?;
        Ok(Self { role, child, log })
    }

    /// Checks that the process has not exited.
    ///
    /// # Errors
    /// [`SessionError::Ended`] with the end of the log.
    pub(super) fn check(&mut self) -> Result<(), SessionError> {
        match self.child.try_wait() {
            Ok(Some(status)) => Err(SessionError::Ended { role: self.role.name(), status, log: self.tail() }),
            _ => Ok(()),
        }
    }

    /// The last lines of the log, as a part of a message; empty if the log is.
    pub(super) fn tail(&self) -> String {
        /// Number of lines: enough for an error and its context.
        const LINES: usize = 5;
        let text = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<_> = text.lines().collect();
        let tail = &lines[lines.len().saturating_sub(LINES)..];
        if tail.is_empty() { String::new() } else { format!("; its log ends with:\n  {}", tail.join("\n  ")) }
    }

    /// Sends a signal to the process, unless the process has exited.
    pub(super) fn signal(&mut self, signal: i32) {
        if let Ok(None) = self.child.try_wait() {
            // SAFETY: plain system call. The child has not been reaped, and only this exclusively borrowed handle can reap it:
            // even if it has exited, its process id is not reused.
            unsafe { libc::kill(self.child.id() as libc::pid_t, signal) };
        }
    }
}

impl Drop for SystemProcess {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Makes the kernel send SIGTERM to the child when this process dies.
fn die_with_parent(command: &mut Command) {
    // SAFETY: prctl is async-signal-safe; the closure allocates nothing and touches no lock.
    unsafe {
        command.pre_exec(|| {
            libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
            Ok(())
        });
    }
}
