//! `upswing doctor`: checks whether this host can run the control daemon in real time, and prints remedies.

pub mod host;

use super::{CommonArgs, time_bar};
use host::Host;
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};
use upswing_config::RealtimeSettings;
use upswing_ipc::{Domain, monotonic_ns, sleep_until};
use upswing_model::Period;
use upswing_process::Failure;
use upswing_process::number::within;
use upswing_view::live::LatencyPercentiles;
use upswingd::histogram::Histogram;
use upswingd::os;

/// Checks whether this host is suitable for real time, and measures its wake-up latency.
///
/// Run it as the daemon's user and with the daemon's resource limits. Exit code 1: the system refuses a real-time setting.
///
/// Example: upswing doctor --seconds 60
#[derive(Clone, Debug, clap::Args)]
pub struct DoctorArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Duration of the latency measurement, s (up to a day); 0: no measurement
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = within(0.0, 86_400.0))]
    pub seconds: f64,
}

/// Verdict on one property of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// The property is suitable.
    Good,
    /// The daemon runs, but cycles may be late.
    Advice,
    /// The daemon does not run, or not in real time.
    Bad,
}

/// One checked property of the host.
#[derive(Clone, Debug, Serialize)]
pub struct HostFinding {
    /// The property.
    pub what: &'static str,
    /// The verdict.
    pub grade: Grade,
    /// The state found.
    pub found: String,
    /// The remedy; empty if none is needed.
    pub fix: String,
}

impl HostFinding {
    fn good(what: &'static str, found: String) -> Self {
        Self::new(what, Grade::Good, found, "")
    }

    fn new(what: &'static str, grade: Grade, found: String, fix: &str) -> Self {
        Self { what, grade, found, fix: fix.into() }
    }
}

#[derive(Serialize)]
struct DoctorResult {
    verdict: Grade,
    findings: Vec<HostFinding>,
    wake_us: Option<LatencyPercentiles>,
    /// Lower end of each octave, us, and its number of wake-ups.
    histogram: Vec<(f64, u64)>,
}

impl fmt::Display for DoctorResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for HostFinding { what, grade, found, fix } in &self.findings {
            let sign = match grade {
                Grade::Good => "ok",
                Grade::Advice => "advice",
                Grade::Bad => "BAD",
            };
            writeln!(f, "{sign:<7}{what:<21}{found}")?;
            if !fix.is_empty() {
                writeln!(f, "{:28}-> {fix}", "")?;
            }
        }
        let most = self.histogram.iter().map(|(_, n)| *n).max().unwrap_or(0);
        for (begin, n) in &self.histogram {
            // Logarithmic, so that one late wake-up in a million is visible.
            let share = (*n as f64 + 1.0).ln() / (most as f64 + 1.0).ln();
            writeln!(f, "{begin:>10.1} us {n:>9}  {}", "#".repeat((40.0 * share).round() as usize))?;
        }
        if let Some(wake) = &self.wake_us {
            wake.line(f, "wake-up")?;
            writeln!(f)?;
        }
        f.write_str(match self.verdict {
            Grade::Good => "This host is fit for real time.",
            Grade::Advice => "The daemon runs in real time here; cycles may be late for the reasons above.",
            Grade::Bad => "The daemon does not run in real time here.",
        })
    }
}

/// Checks the host, measures and reports.
///
/// # Errors
/// [`Failure::BadInput`] for invalid options, [`Failure::Failed`] if a property is bad.
pub fn run(args: &DoctorArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    let domain = Domain::new(&args.common.process.domain).map_err(Failure::bad_input)?;
    let (period, settings) = (config.daemon.cycle.period, config.daemon.realtime);
    let mut findings = Host::at(Path::new("/")).findings(settings.cpu);
    findings.extend([memory(), leftovers(&domain)]);

    let (prepared, mut refused) = os::prepare_process();
    let duration = Duration::from_secs_f64(args.seconds);
    let measured = std::thread::spawn(move || {
        let refused = os::prepare_thread(&settings);
        (refused, wake_up_latency(period, duration))
    });
    let bar = time_bar(args.seconds, "measuring wake-ups");
    let begin = Instant::now();
    while !measured.is_finished() {
        bar.set_position(u64::try_from(begin.elapsed().as_millis()).unwrap_or(u64::MAX));
        std::thread::sleep(Duration::from_millis(100).min(duration));
    }
    bar.finish_and_clear();
    let (of_thread, (histogram, overruns)) =
        measured.join().map_err(|_| Failure::failed("the measurement panicked"))?;
    drop(prepared);
    refused.extend(of_thread);
    findings.extend(granted(&refused, &settings));
    let percentiles = histogram.percentiles();
    if overruns > 0 {
        let found = format!("{overruns} of {} came later than a period", percentiles.count);
        let fix = "see the advice above, and what else runs on this machine";
        findings.push(HostFinding::new("wake-up", Grade::Advice, found, fix));
    }
    let report = DoctorResult {
        verdict: findings.iter().map(|finding| finding.grade).max().unwrap_or(Grade::Good),
        findings,
        wake_us: (percentiles.count > 0).then(|| LatencyPercentiles::new(&percentiles)),
        histogram: histogram.octaves().into_iter().map(|(ns, n)| (ns as f64 * 1e-3, n)).collect(),
    };
    args.common.print(&report)?;
    if report.verdict == Grade::Bad {
        Err(Failure::failed("this host is not fit for real time"))
    } else {
        Ok(())
    }
}

/// Reports the real-time settings of the daemon that the system `refused`, or that all are granted.
fn granted(refused: &[os::RefusedSetting], settings: &RealtimeSettings) -> Vec<HostFinding> {
    const NAME: &str = "real-time set-up";
    if refused.is_empty() {
        let found = format!("SCHED_FIFO {}, memory lock, timer and CPU are granted", settings.priority);
        return vec![HostFinding::good(NAME, found)];
    }
    let bad = |refused: &os::RefusedSetting| {
        HostFinding::new(NAME, Grade::Bad, refused.degradation().to_string(), &format!("refused: {refused}"))
    };
    refused.iter().map(bad).collect()
}

fn memory() -> HostFinding {
    const NAME: &str = "shared memory";
    const MIB: u64 = 1 << 20;
    let needed = Domain::MEMORY / MIB;
    match Domain::free_memory() {
        Ok(free) if free >= Domain::MEMORY => {
            HostFinding::good(NAME, format!("{} MiB free in /dev/shm", free / MIB))
        }
        Ok(free) => HostFinding::new(
            NAME,
            Grade::Bad,
            format!("{} MiB free in /dev/shm, a system takes up to {needed}", free / MIB),
            "remove what is not needed there, or enlarge it: mount -o remount,size=1g /dev/shm",
        ),
        Err(e) => HostFinding::new(NAME, Grade::Bad, format!("/dev/shm: {e}"), "mount a tmpfs at /dev/shm"),
    }
}

/// Reports files of dead processes in shared memory.
fn leftovers(domain: &Domain) -> HostFinding {
    const NAME: &str = "leftovers";
    match domain.count_dead() {
        Ok(0) => HostFinding::good(NAME, format!("none in domain `{domain}`")),
        Ok(n) => HostFinding::new(
            NAME,
            Grade::Advice,
            format!("{n} dead process(es) in domain `{domain}`"),
            "the next process that starts there removes them",
        ),
        Err(e) => HostFinding::new(NAME, Grade::Bad, e.to_string(), "run the doctor as the daemon's user"),
    }
}

/// Measures wake-up latencies at absolute deadlines, as in the daemon. Returns them and the number of those above a period.
fn wake_up_latency(period: Period, duration: Duration) -> (Histogram, u64) {
    let period = period.nanos();
    let mut histogram = Histogram::default();
    let mut overruns = 0;
    let begin = monotonic_ns();
    let end = begin.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX));
    let mut deadline = begin + period;
    while deadline <= end {
        sleep_until(deadline);
        let late = monotonic_ns().saturating_sub(deadline);
        histogram.add(late);
        overruns += u64::from(late >= period);
        deadline += (late / period + 1) * period;
    }
    (histogram, overruns)
}
