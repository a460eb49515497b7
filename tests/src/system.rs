//! A system under test: daemon, planner and simulated plant as three processes.

use crate::matrix;
use crate::programs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;
use upswing_ipc::{Clock, ControlResponse, Mode, Telemetry, TempDomain};
use upswing_record::Recorder;
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_rig::course::{SessionCourse, execute_from_idle, first_manoeuvre};
use upswing_rig::session::{Programs, Role, Session, SessionError, SessionOptions};

/// Start pose in the paper's experiment: angles of the actuated joints, deg.
pub const START: &[f64] = &[0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
/// Longest wait for a condition in real time; long, because test machines may be busy.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time in which the arm settles in Hold, cycles.
const SETTLE: u64 = 2000;
/// In lockstep: cycles between two checks of a condition, and longest wait, cycles; one minute of virtual time.
const STEP: u64 = 80;
const LONGEST: u64 = 480_000;

/// A system of three processes under test. Dropping it ends the processes and removes their shared memory and logs.
pub struct System {
    /// Processes and connections. Declared first: dropped before the domain that they use.
    pub session: Session,
    /// Settings of the system.
    pub config: Config,
    clock: Clock,
    folder: PathBuf,
    _own: TempDomain,
}

impl Drop for System {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let _ = std::fs::remove_dir_all(&self.folder);
            return;
        }
        let file = self.folder.join("run.mcap");
        let kept = Recorder::create(&file, &self.config, []).and_then(|mut recorder| {
            recorder.write(&self.session.records)?;
            recorder.finish()
        });
        let kept = kept.map_or_else(|e| e.to_string(), |_| "logs and a recording".to_owned());
        eprintln!("in {}: {kept}", self.folder.display());
    }
}

impl System {
    /// Starts the dedicated programs with the plant on `clock` and the actuated joints at `start_deg` (deg).
    ///
    /// # Panics
    /// If a program does not start; the message contains the end of its log.
    pub fn start(clock: Clock, start_deg: &[f64]) -> Self {
        Self::start_with(clock, start_deg, None)
    }

    /// Starts a system as [`Self::start`], with the settings in a folder; `None`: the embedded settings.
    ///
    /// # Panics
    /// As [`Self::start`], and if the settings are invalid.
    pub fn start_with(clock: Clock, start_deg: &[f64], settings: Option<&Path>) -> Self {
        Self::start_recorded(clock, start_deg, settings, None)
    }

    /// Starts a system as [`Self::start_with`], with a new recording in `file` if one is given.
    ///
    /// # Panics
    /// As [`Self::start_with`], and if the file cannot be created.
    pub fn start_recorded(
        clock: Clock,
        start_deg: &[f64],
        settings: Option<&Path>,
        file: Option<&Path>,
    ) -> Self {
        let own = TempDomain::new("test").expect("a name");
        let domain = own.name().to_owned();
        let folder = std::env::temp_dir().join(format!("upswing-{domain}"));
        std::fs::create_dir_all(&folder).expect("folder for logs");
        let robot = settings.map_or_else(upswing_config::System::default, |folder| {
            upswing_config::System::Folder(folder.to_owned())
        });
        let config = Config::load(&robot).unwrap_or_else(|e| panic!("{e}"));
        let details = [("clock", clock.to_string())];
        let recorder =
            file.map(|file| Recorder::create(file, &config, details).unwrap_or_else(|e| panic!("{e}")));
        let options = SessionOptions {
            system: robot,
            domain,
            clock,
            start: Some(start_deg.iter().map(f64::to_string).collect::<Vec<_>>().join(",")),
            scenario: None,
            logs: folder.clone(),
        };
        let session = Session::start(Programs::dedicated(&programs()), &options, recorder);
        let session = session.unwrap_or_else(|e| panic!("{e}"));
        Self { session, config, clock, folder, _own: own }
    }

    /// Control period, s.
    pub fn period(&self) -> f64 {
        self.config.daemon.cycle.period.seconds()
    }

    /// Swings up, balances for `seconds` (s), and evaluates the run.
    ///
    /// # Panics
    /// If the system refuses or leaves the modes of a swing-up.
    pub fn swing_up(&mut self, seconds: f64) -> SwingUpEvaluation {
        let period = self.period();
        let manoeuvre = first_manoeuvre(&self.config);
        let course = &mut SessionCourse::new(&mut self.session, period);
        let plan = execute_from_idle(course, &manoeuvre, period, seconds);
        let plan = self.must(plan);
        SwingUpEvaluation::new(
            &self.config,
            &plan,
            &self.session.records,
            self.session.dropped(),
            seconds,
            None,
        )
    }

    /// Lets `cycles` further control cycles pass and waits for their records.
    ///
    /// # Panics
    /// If the cycles are not recorded in time.
    pub fn advance(&mut self, cycles: u64) {
        let passed = self.session.advance(cycles);
        self.must(passed);
    }

    /// Sends a request that the daemon must accept; returns the state of the daemon after it.
    ///
    /// # Panics
    /// If the daemon refuses the request.
    pub fn request(&mut self, request: OperatorRequest) -> ControlResponse {
        let response = self.session.request(request);
        self.must(response)
    }

    /// Requests the state of the daemon, with reason and next action as text.
    ///
    /// # Panics
    /// If the daemon does not respond.
    pub fn status(&mut self) -> ControlResponse {
        let response = self.session.status();
        self.must(response)
    }

    /// True if the brakes of the plant are closed.
    ///
    /// # Panics
    /// If the plant does not respond.
    pub fn brakes_closed(&mut self) -> bool {
        let response = self.session.plant_status();
        self.must(response).brakes_closed == 1
    }

    /// Brings a newly started system to a mode: Idle, settled in Hold, halfway through the plan in Track, Balance at the end of the plan,
    /// or Stop or Fault from there.
    ///
    /// # Panics
    /// If the system does not reach the mode.
    pub fn bring_to(&mut self, goal: Mode) {
        self.advance(1);
        if goal != Mode::Idle {
            self.request(OperatorRequest::Enable);
        }
        // The arm settles, and a plant that waits for the daemon receives its first command.
        self.advance(SETTLE);
        if matches!(goal, Mode::Track | Mode::Balance | Mode::Stop) {
            let plan = self.session.start_manoeuvre(&first_manoeuvre(&self.config));
            let plan = self.must(plan);
            self.wait_until("track", |record| record.mode() == Ok(Mode::Track));
            if goal != Mode::Balance {
                self.advance((plan.t_f / self.period() / 2.0) as u64);
            }
        }
        match goal {
            Mode::Stop => drop(self.request(OperatorRequest::Stop)),
            Mode::Fault => self.inject("encoder-nan --joint joint_1 --cycles 1"),
            _ => {}
        }
        // In real time the plan may have ended by now, so that Track is not required any more.
        if goal != Mode::Track {
            self.wait_until(&goal.to_string(), |record| record.mode() == Ok(goal));
        }
    }

    /// Injects a fault into the plant, in the syntax of `upswing disturb fault`, for example `encoder-jump --joint joint_4 --amount 0.1`; it
    /// begins in the next cycle, or in the cycle of `--from`.
    ///
    /// # Panics
    /// If there is no such fault, or the plant refuses the fault.
    pub fn inject(&mut self, fault: &str) {
        let request = matrix::fault(fault).and_then(|args| Ok(args.request(&self.config.model)?));
        let request = request.unwrap_or_else(|e| panic!("{fault}: {e}"));
        let response = self.session.plant(&request);
        self.must(response);
    }

    /// Lets time pass until `wanted` holds for the record of a cycle, from the newest record on, and returns this record.
    ///
    /// # Panics
    /// If there is no such record in time; the message names the awaited condition `what`.
    pub fn wait_until(&mut self, what: &str, mut wanted: impl FnMut(&Telemetry) -> bool) -> Telemetry {
        let mut seen = self.session.records.len().saturating_sub(1);
        let mut find = |session: &Session| {
            let found = session.records[seen..].iter().find(|record| wanted(record)).copied();
            seen = session.records.len();
            found
        };
        if self.clock.stands_still() {
            for _ in 0..LONGEST / STEP {
                if let Some(found) = find(&self.session) {
                    return found;
                }
                self.advance(STEP);
            }
            panic!("waited {LONGEST} cycles for {what}; the last one: {:?}", self.session.records.last());
        }
        let mut found = None;
        let waited = self.session.wait_for(what, PATIENCE, |session| {
            found = find(session);
            Ok(found.is_some())
        });
        self.must(waited);
        found.unwrap_or_default()
    }

    /// Kills the process of a role (SIGKILL).
    pub fn kill(&mut self, role: Role) {
        self.session.kill(role);
    }

    /// Kills the process of a role, if it runs, and starts a new one.
    ///
    /// # Panics
    /// If the new process does not start.
    pub fn restart(&mut self, role: Role) {
        let restarted = self.session.restart(role);
        self.must(restarted);
    }

    /// Suspends the process of a role for `time` of the wall clock, as on an overloaded machine.
    pub fn stall(&mut self, role: Role, time: Duration) {
        self.session.signal(role, libc::SIGSTOP);
        self.pass(time);
        self.session.signal(role, libc::SIGCONT);
    }

    /// Waits for `time` of the wall clock and collects telemetry meanwhile: the telemetry ring holds about one second.
    ///
    /// # Panics
    /// If a recording cannot be written.
    pub fn pass(&mut self, time: Duration) {
        let begin = Instant::now();
        while begin.elapsed() < time {
            let collected = self.session.collect();
            self.must(collected);
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Shuts down all processes: daemon, planner, plant.
    ///
    /// # Panics
    /// If a process does not exit, or exits with an error.
    pub fn end(mut self) {
        let ended = self.session.end();
        self.must(ended);
    }

    /// Unwraps a result; on an error panics with the error and the state of the daemon.
    fn must<T>(&mut self, result: Result<T, SessionError>) -> T {
        result.unwrap_or_else(|e| {
            let status = match self.session.status() {
                Ok(status) => {
                    let fault = upswingd::fault_text(status.fault).unwrap_or("no fault");
                    let mode = status.mode_text();
                    format!("in {mode} at cycle {}, {fault}; {}", status.seq, status.reason)
                }
                Err(e) => e.to_string(),
            };
            panic!("{e}\nthe daemon: {status}")
        })
    }
}
