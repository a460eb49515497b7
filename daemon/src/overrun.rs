//! Why a cycle ended late: its phases, and what the kernel did to the real-time thread.
//!
//! The thread itself asks nothing: that would be a system call per cycle. The other thread reads the counters that the
//! kernel keeps of it, now and then and after an overrun, and names the difference.

use std::fmt;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};
use upswing_ipc::Telemetry;

/// How old the counters of comparison get: what is older than this is not blamed on an overrun.
const REFRESH: Duration = Duration::from_millis(50);

/// The kernel's counters of a thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Page faults with and without access to a disk.
    pub faults: u64,
    /// Times that the kernel took the CPU away from it.
    pub preemptions: u64,
    /// Time that it was ready to run without a CPU, ns.
    pub starved_ns: u64,
}

/// Watches the real-time thread from outside.
#[derive(Debug)]
pub struct Watch {
    stat: File,
    status: File,
    schedstat: Option<File>,
    last: Counters,
    read: Instant,
}

impl Watch {
    /// A watch of the thread `tid` of this process.
    ///
    /// # Errors
    /// If the kernel does not show the thread.
    pub fn new(tid: u32) -> std::io::Result<Self> {
        let open = |name: &str| File::open(format!("/proc/self/task/{tid}/{name}"));
        let mut watch = Self {
            stat: open("stat")?,
            status: open("status")?,
            // Not in every kernel.
            schedstat: open("schedstat").ok(),
            last: Counters::default(),
            read: Instant::now(),
        };
        watch.last = watch.counters();
        Ok(watch)
    }

    /// The counters now; 0 for what cannot be read.
    pub fn counters(&self) -> Counters {
        let text = |file: &File| {
            let mut bytes = [0; 4096];
            let length = file.read_at(&mut bytes, 0).unwrap_or(0);
            String::from_utf8_lossy(&bytes[..length]).into_owned()
        };
        let stat = text(&self.stat);
        // After the name, which may hold anything: state, then minflt and majflt as 8th and 10th (proc(5)).
        let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        let fields: Vec<&str> = after_name.split_whitespace().collect();
        let field = |n: usize| fields.get(n).and_then(|v| v.parse::<u64>().ok()).unwrap_or(0);
        let status = text(&self.status);
        let switches = status.lines().find_map(|line| line.strip_prefix("nonvoluntary_ctxt_switches:"));
        let schedstat = self.schedstat.as_ref().map(text).unwrap_or_default();
        let number = |text: Option<&str>| text.and_then(|v| v.trim().parse().ok()).unwrap_or(0);
        Counters {
            faults: field(7) + field(9),
            preemptions: number(switches),
            starved_ns: number(schedstat.split_whitespace().nth(1)),
        }
    }

    /// Takes the counters anew if they are old; to be called often.
    pub fn refresh(&mut self) {
        if self.read.elapsed() >= REFRESH {
            self.take();
        }
    }

    /// What happened since the counters were last taken, and how long ago that was.
    pub fn take(&mut self) -> (Counters, Duration) {
        let (now, age) = (self.counters(), self.read.elapsed());
        let last = std::mem::replace(&mut self.last, now);
        self.read = Instant::now();
        let since = Counters {
            faults: now.faults.saturating_sub(last.faults),
            preemptions: now.preemptions.saturating_sub(last.preemptions),
            starved_ns: now.starved_ns.saturating_sub(last.starved_ns),
        };
        (since, age)
    }
}

/// A cycle that ended late, and what may have caused it.
#[derive(Clone, Copy, Debug)]
pub struct Overrun {
    /// The late cycle.
    pub telemetry: Telemetry,
    /// What the kernel did to the thread around it.
    pub around: Counters,
    /// In how long a time around it.
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
        let Counters { faults, preemptions, starved_ns } = self.around;
        write!(
            f,
            " us; {preemptions} preemptions, {:.1} us ready without a CPU, {faults} page faults in the last {} ms",
            starved_ns as f64 * 1e-3,
            self.window.as_millis()
        )
    }
}
