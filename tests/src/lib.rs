//! Harness for hardware-in-the-loop style tests: starts a whole system, the three programs as separate processes
//! in a shared-memory domain of its own, drives it and collects its telemetry.

pub mod running;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use upswing::report::Report;
use upswing::session::{CleanUp, Options, Programs, Session};
use upswing::swing_up::swing_up;
use upswing_config::Config;
use upswing_ipc::{Clock, Domain, Telemetry};

/// A system under test. Its processes end, and its shared memory and logs go, when it is dropped.
pub struct System {
    /// Drives the system. Declared first: it must end before what it uses is removed.
    pub session: Session,
    /// The settings the system runs with.
    pub config: Config,
    _logs: Logs,
    _clean: CleanUp,
}

struct Logs(PathBuf);

impl Drop for Logs {
    fn drop(&mut self) {
        // A failed test keeps its logs for the reader.
        if !std::thread::panicking() {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }
}

/// Folder of the programs under test: that of the test programs' parent.
///
/// # Panics
/// If they are not built.
pub fn programs() -> PathBuf {
    let test = std::env::current_exe().expect("path of the test program");
    let folder = test.parent().and_then(|p| p.parent()).expect("target folder").to_owned();
    for program in ["upswing", "upswingd", "upswing-planner", "upswing-plant"] {
        let path = folder.join(program);
        assert!(path.exists(), "{} is not built: run `cargo test --release --workspace`", path.display());
    }
    folder
}

/// A domain name that no other test and no earlier run uses.
pub fn unique_domain() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    format!("test-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed))
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
        let domain = unique_domain();
        let logs = std::env::temp_dir().join(format!("upswing-{domain}"));
        std::fs::create_dir_all(&logs).expect("folder for logs");
        let clean = CleanUp(Domain::new(&domain).expect("valid domain"));
        let options = Options {
            config: settings.map(Path::to_owned),
            domain,
            clock,
            start: Some(start_deg.map(|d| d.to_string()).join(",")),
            scenario: None,
            logs: logs.clone(),
        };
        let session =
            Session::start(Programs::dedicated(&programs()), &options).unwrap_or_else(|e| panic!("{e}"));
        Self {
            session,
            config: Config::load(settings).unwrap_or_else(|e| panic!("{e}")),
            _logs: Logs(logs),
            _clean: clean,
        }
    }

    /// Control period, s.
    pub fn period(&self) -> f64 {
        self.config.daemon.cycle.period.as_secs_f64()
    }

    /// Swings up, balances for `seconds`, and evaluates.
    ///
    /// # Panics
    /// If the system refuses or leaves the modes of a swing-up.
    pub fn swing_up(&mut self, seconds: f64) -> Report {
        let period = self.period();
        let plan = swing_up(&mut self.session, period, seconds, &AtomicBool::new(false), &|_, _| ())
            .unwrap_or_else(|e| panic!("{e}"));
        Report::new(&self.config, &plan, &self.session.records, self.session.dropped(), seconds)
    }
}

/// The bits of a record, field by field: equal only if every number is bit-identical.
pub fn bits(record: &Telemetry) -> String {
    // Debug prints the shortest text that reads back to the same bits; NaN does not occur.
    format!("{record:?}")
}
