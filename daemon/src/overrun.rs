//! Causes of overruns: the phases of an overrun cycle, and the kernel's counters of the real-time thread.
//!
//! The real-time thread does not read its counters, because that would be a system call per cycle. The service thread reads them
//! periodically and after an overrun, and reports the difference.

use std::fmt;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};
use upswing_ipc::Telemetry;

/// Age at which the counters are read again: older events are not reported as causes of an overrun.
const REFRESH: Duration = Duration::from_millis(50);

/// The kernel's counters for a thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThreadCounters {
    /// Page faults with and without access to a disk.
    pub faults: u64,
    /// Number of times that the kernel took the CPU away from the thread.
    pub preemptions: u64,
    /// Time for which the thread was ready to run without a CPU, ns.
    pub starved_ns: u64,
}

/// Reader of the kernel's counters for the real-time thread, used by another thread.
#[derive(Debug)]
pub struct ThreadWatch {
    stat: File,
    status: File,
    schedstat: Option<File>,
    last: ThreadCounters,
    read: Instant,
}

impl ThreadWatch {
    /// Opens the counters of the thread `tid` of this process.
    ///
    /// # Errors
    /// If the kernel does not provide the counters of the thread.
    pub fn new(tid: u32) -> std::io::Result<Self> {
        let open = |name: &str| File::open(format!("/proc/self/task/{tid}/{name}"));
        let mut watch = Self {
            stat: open("stat")?,
            status: open("status")?,
            // Some kernels have no such file.
            schedstat: open("schedstat").ok(),
            last: ThreadCounters::default(),
            read: Instant::now(),
        };
        watch.last = watch.counters();
        Ok(watch)
    }

    /// Reads the counters; a counter that cannot be read is 0.
    pub fn counters(&self) -> ThreadCounters {
        let text = |file: &File| {
            let mut bytes = [0; 4096];
            let length = file.read_at(&mut bytes, 0).unwrap_or(0);
            String::from_utf8_lossy(&bytes[..length]).into_owned()
        };
        let stat = text(&self.stat);
        // Fields after the name, which may contain any character: state, then minflt and majflt as 8th and 10th (proc(5)).
        let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        let fields: Vec<&str> = after_name.split_whitespace().collect();
        let field = |n: usize| fields.get(n).and_then(|v| v.parse::<u64>().ok()).unwrap_or(0);
        let status = text(&self.status);
        let switches = status.lines().find_map(|line| line.strip_prefix("nonvoluntary_ctxt_switches:"));
        let schedstat = self.schedstat.as_ref().map(text).unwrap_or_default();
        let number = |text: Option<&str>| text.and_then(|v| v.trim().parse().ok()).unwrap_or(0);
        ThreadCounters {
            faults: field(7) + field(9),
            preemptions: number(switches),
            starved_ns: number(schedstat.split_whitespace().nth(1)),
        }
    }

    /// Reads the counters again if they are old; to be called often.
    pub fn refresh(&mut self) {
        if self.read.elapsed() >= REFRESH {
            self.take();
        }
    }

    /// Returns the change of the counters since they were last read, and the time since then.
    pub fn take(&mut self) -> (ThreadCounters, Duration) {
        let (now, age) = (self.counters(), self.read.elapsed());
        let last = std::mem::replace(&mut self.last, now);
        self.read = Instant::now();
        let since = ThreadCounters {
            faults: now.faults.saturating_sub(last.faults),
            preemptions: now.preemptions.saturating_sub(last.preemptions),
            starved_ns: now.starved_ns.saturating_sub(last.starved_ns),
        };
        (since, age)
    }
}

/// An overrun cycle and its possible causes.
#[derive(Clone, Copy, Debug)]
pub struct Overrun {
    /// Telemetry of the cycle.
    pub telemetry: Telemetry,
    /// Change of the thread's counters around the overrun.
    pub around: ThreadCounters,
    /// Duration in which the counters changed.
    pub window: Duration,
}

impl fmt::Display for Overrun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.telemetry;
        let phases =
            [("wake", t.wake_ns), ("read", t.read_ns), ("compute", t.compute_ns), ("write", t.write_ns)];
        let longest = phases.iter().max_by_key(|(_, ns)| ns).map_or("", |(name, _)| name);
        write!(f, "cycle {} late in {longest}:", t.seq)?;
        for (name, ns) in phases {
            write!(f, " {name} {:.1}", ns as f64 * 1e-3)?;
        }
        let ThreadCounters { faults, preemptions, starved_ns } = self.around;
        write!(
            f,
            " us; {preemptions} preemptions, {:.1} us ready without a CPU, {faults} page faults in the last {} ms",
            starved_ns as f64 * 1e-3,
            self.window.as_millis()
        )
    }
}
