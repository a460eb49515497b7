//! Three processes under test.

use crate::matrix;
use crate::programs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::{Manoeuvre, Request};
use upswing_ipc::{Clock, ControlResponse, Mode, Telemetry, TempDomain};
use upswing_record::Recorder;
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_rig::course::{SessionCourse, swing_up};
use upswing_rig::session::{Programs, Role, Session, SessionError, SessionOptions};

/// Start of the arm in the paper's experiment, deg.
pub const START: [f64; 7] = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
/// Longest wait for something: machines are shared.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time in which the arm settles on its hold, cycles.
const SETTLE: u64 = 2000;
/// Cycles between two looks, and the longest wait in cycles: a minute of virtual time.
const STEP: u64 = 80;
const LONGEST: u64 = 480_000;

/// A system under test. Its processes end, and its shared memory and logs go, when it is dropped.
pub struct System {
    /// Drives the system. Declared first: it must end before what it uses is removed.
    pub session: Session,
    /// The settings the system runs with.
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
    /// Starts the dedicated programs on `clock` with the arm at `start_deg`.
    ///
    /// # Panics
    /// If they do not start, with the end of the log of the one that failed.
    pub fn start(clock: Clock, start_deg: [f64; 7]) -> Self {
        Self::start_with(clock, start_deg, None)
    }

    /// As [`Self::start`], with the settings in a folder.
    ///
    /// # Panics
    /// As [`Self::start`], and if the settings cannot be used.
    pub fn start_with(clock: Clock, start_deg: [f64; 7], settings: Option<&Path>) -> Self {
        Self::start_recorded(clock, start_deg, settings, None)
    }

    /// As [`Self::start_with`], with a new recording in a file where one is named.
    ///
    /// # Panics
    /// As [`Self::start_with`], and if the file cannot be made.
    pub fn start_recorded(
        clock: Clock,
        start_deg: [f64; 7],
        settings: Option<&Path>,
        file: Option<&Path>,
    ) -> Self {
        let own = TempDomain::new("test").expect("a name");
        let domain = own.name().to_owned();
        let folder = std::env::temp_dir().join(format!("upswing-{domain}"));
        std::fs::create_dir_all(&folder).expect("folder for logs");
        let config = Config::load(settings).unwrap_or_else(|e| panic!("{e}"));
        let details = [("clock", clock.to_string())];
        let recorder =
            file.map(|file| Recorder::create(file, &config, details).unwrap_or_else(|e| panic!("{e}")));
        let options = SessionOptions {
            config: settings.map(Path::to_owned),
            domain,
            clock,
            start: Some(start_deg.map(|d| d.to_string()).join(",")),
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

    /// Swings up, balances for `seconds`, and evaluates.
    ///
    /// # Panics
    /// If the system refuses or leaves the modes of a swing-up.
    pub fn swing_up(&mut self, seconds: f64) -> SwingUpEvaluation {
        let period = self.period();
        let plan = swing_up(&mut SessionCourse::new(&mut self.session, period), period, seconds);
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

    /// Lets time pass until so many more cycles are recorded.
    ///
    /// # Panics
    /// If it does not pass.
    pub fn advance(&mut self, cycles: u64) {
        let passed = self.session.advance(cycles);
        self.must(passed);
    }

    /// Asks the daemon for something that it must accept.
    ///
    /// # Panics
    /// If it refuses.
    pub fn request(&mut self, request: Request) -> ControlResponse {
        let response = self.session.request(request);
        self.must(response)
    }

    /// The daemon's state, with what it has to say about it.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn status(&mut self) -> ControlResponse {
        let response = self.session.status();
        self.must(response)
    }

    /// Whether the brakes of the plant hold.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn brakes_closed(&mut self) -> bool {
        let response = self.session.plant_status();
        self.must(response).brakes_closed == 1
    }

    /// From the start into a mode: settled in Hold, in full swing in Track, or where the way leads from there.
    ///
    /// # Panics
    /// If it does not get there.
    pub fn bring_to(&mut self, goal: Mode) {
        self.advance(1);
        if goal != Mode::Idle {
            self.request(Request::Enable);
        }
        // The arm settles; and a plant has heard the daemon for which it waits.
        self.advance(SETTLE);
        if matches!(goal, Mode::Track | Mode::Balance | Mode::Stop) {
            let plan = self.session.start_manoeuvre(Manoeuvre::SwingUp);
            let plan = self.must(plan);
            self.wait_until("track", |record| record.mode() == Ok(Mode::Track));
            if goal != Mode::Balance {
                self.advance((plan.t_f / self.period() / 2.0) as u64);
            }
        }
        match goal {
            Mode::Stop => drop(self.request(Request::Stop)),
            Mode::Fault => self.inject("encoder-nan --joint 1 --cycles 1"),
            _ => {}
        }
        // In real time the plan may have ended by now; it was followed.
        if goal != Mode::Track {
            self.wait_until(&goal.to_string(), |record| record.mode() == Ok(goal));
        }
    }

    /// Breaks the plant as `upswing disturb fault` does, for example `encoder-jump --joint 4 --amount 0.1`; from the next
    /// cycle on, or from that of `--from`.
    ///
    /// # Panics
    /// If there is no such fault, or the plant refuses it.
    pub fn inject(&mut self, fault: &str) {
        let request = matrix::fault(fault).and_then(|args| args.request().map_err(|e| e.to_string()));
        let request = request.unwrap_or_else(|e| panic!("{fault}: {e}"));
        let response = self.session.plant(&request);
        self.must(response);
    }

    /// Lets time pass until a cycle is as wanted, the newest one or one that is still to come, and returns it.
    ///
    /// # Panics
    /// If none comes, with `what` was awaited.
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

    /// Kills a process.
    pub fn kill(&mut self, role: Role) {
        self.session.kill(role);
    }

    /// Kills a process and starts it again.
    ///
    /// # Panics
    /// If it does not start.
    pub fn restart(&mut self, role: Role) {
        let restarted = self.session.restart(role);
        self.must(restarted);
    }

    /// Stops a process for a time of the wall clock, as if its machine had no time for it.
    pub fn stall(&mut self, role: Role, time: Duration) {
        self.session.signal(role, libc::SIGSTOP);
        self.pass(time);
        self.session.signal(role, libc::SIGCONT);
    }

    /// Lets a time of the wall clock pass. Telemetry waits a second only for those who take it.
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

    /// Ends all processes in order.
    ///
    /// # Panics
    /// If one of them does not end well.
    pub fn end(mut self) {
        let ended = self.session.end();
        self.must(ended);
    }

    /// The value; or the end of the test, with what the daemon says of itself.
    fn must<T>(&mut self, result: Result<T, SessionError>) -> T {
        result.unwrap_or_else(|e| {
            let status = match self.session.status() {
                Ok(status) => {
                    let fault = upswingd::fault_text(status.fault).unwrap_or("no fault");
                    let mode = status.mode().map_or_else(|e| e.to_string(), |mode| mode.to_string());
                    format!("in {mode} at cycle {}, {fault}; {}", status.seq, status.reason)
                }
                Err(e) => e.to_string(),
            };
            panic!("{e}\nthe daemon: {status}")
        })
    }
}
