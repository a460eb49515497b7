//! Real-time properties of a host, read from files of the kernel.

use super::{Grade, HostFinding};
use std::path::{Path, PathBuf};

/// A host, represented by its file system.
#[derive(Clone, Debug)]
pub struct Host {
    root: PathBuf,
}

impl Host {
    /// Returns the host with the file system at `root`: `/`, or a copy of the files.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// Reads a file without white space at its ends; `None` if it cannot be read.
    fn read(&self, path: &str) -> Option<String> {
        std::fs::read_to_string(self.root.join(path)).ok().map(|text| text.trim().to_owned())
    }

    fn number(&self, path: &str) -> Option<i64> {
        self.read(path)?.parse().ok()
    }

    /// Returns all findings from files, for a real-time thread on `cpu` (`None`: on any CPU).
    pub fn findings(&self, cpu: Option<usize>) -> Vec<HostFinding> {
        vec![self.kernel(), self.throttling(), self.group(), self.governor(cpu), self.isolation(cpu)]
    }

    fn kernel(&self) -> HostFinding {
        let release = self.read("proc/sys/kernel/osrelease").unwrap_or_else(|| "unknown".into());
        if self.number("sys/kernel/realtime") == Some(1) {
            return HostFinding::good("kernel", format!("{release}, PREEMPT_RT"));
        }
        let fix = "install a kernel with PREEMPT_RT (Debian: linux-image-rt-amd64): others delay a thread by milliseconds";
        HostFinding::new("kernel", Grade::Advice, format!("{release}, not PREEMPT_RT"), fix)
    }

    /// Checks the share of each period that the kernel leaves to real-time threads.
    fn throttling(&self) -> HostFinding {
        const NAME: &str = "real-time throttling";
        const FILE: &str = "kernel.sched_rt_runtime_us";
        let runtime = self.number("proc/sys/kernel/sched_rt_runtime_us");
        let period = self.number("proc/sys/kernel/sched_rt_period_us").filter(|us| *us > 0);
        match (runtime, period) {
            (Some(-1), _) => HostFinding::good(NAME, "off".into()),
            (Some(0), _) => HostFinding::new(
                NAME,
                Grade::Bad,
                format!("{FILE} is 0: no real-time thread ever runs"),
                "sysctl kernel.sched_rt_runtime_us=950000",
            ),
            (Some(runtime), Some(period)) if 2 * runtime < period => HostFinding::new(
                NAME,
                Grade::Advice,
                format!("{FILE} leaves {runtime} of {period} us"),
                "sysctl kernel.sched_rt_runtime_us=950000",
            ),
            (Some(runtime), Some(period)) => HostFinding::good(
                NAME,
                format!("{runtime} of {period} us; the daemon sleeps most of the time"),
            ),
            _ => HostFinding::good(NAME, "none in this kernel".into()),
        }
    }

    /// Checks the real-time budget of this process's cgroup, which exists only with RT_GROUP_SCHED and is 0 by default.
    fn group(&self) -> HostFinding {
        const NAME: &str = "control group";
        let groups = self.read("proc/self/cgroup").unwrap_or_default();
        let cpu_group = groups.lines().find_map(|line| {
            let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
            controllers.split(',').any(|name| name == "cpu").then_some(path)
        });
        let file =
            cpu_group.map(|path| format!("sys/fs/cgroup/cpu{path}/cpu.rt_runtime_us").replace("//", "/"));
        match file.and_then(|file| self.number(&file).map(|us| (file, us))) {
            Some((file, 0)) => HostFinding::new(
                NAME,
                Grade::Bad,
                format!("/{file} is 0: SCHED_FIFO is refused"),
                "write a runtime into that file and those of the groups above, or boot with a kernel without \
                 RT_GROUP_SCHED",
            ),
            Some((_, us)) => HostFinding::good(NAME, format!("{us} us of real time")),
            None => HostFinding::good(NAME, "does not limit real time".into()),
        }
    }

    fn governor(&self, cpu: Option<usize>) -> HostFinding {
        const NAME: &str = "frequency governor";
        let of = |cpu: usize| {
            let governor = self.read(&format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor"))?;
            Some((cpu, governor))
        };
        let cpus = cpu.map_or(0..=1023, |cpu| cpu..=cpu);
        let (fast, slow): (Vec<_>, Vec<_>) = cpus.filter_map(of).partition(|(_, name)| name == "performance");
        match (slow.first(), fast.is_empty()) {
            (Some((cpu, name)), _) => HostFinding::new(
                NAME,
                Grade::Advice,
                format!("`{name}` on CPU {cpu}: it slows down while the daemon sleeps"),
                "cpupower frequency-set --governor performance",
            ),
            (None, true) => {
                HostFinding::good(NAME, "none: this machine does not scale frequencies itself".into())
            }
            (None, false) => HostFinding::good(NAME, "performance".into()),
        }
    }

    fn isolation(&self, cpu: Option<usize>) -> HostFinding {
        const NAME: &str = "CPU of its own";
        let isolated = self.read("sys/devices/system/cpu/isolated").unwrap_or_default();
        let Some(cpu) = cpu else {
            return HostFinding::new(
                NAME,
                Grade::Advice,
                "realtime.cpu is -1: the thread runs wherever there is room".into(),
                "isolate a CPU (kernel command line: isolcpus=N nohz_full=N irqaffinity=OTHERS) and set realtime.cpu",
            );
        };
        if in_list(&isolated, cpu) {
            return HostFinding::good(NAME, format!("{cpu}, isolated"));
        }
        let fix =
            format!("add isolcpus={cpu} nohz_full={cpu} to the kernel command line, irqaffinity= without it");
        HostFinding::new(NAME, Grade::Advice, format!("CPU {cpu} also does other work"), &fix)
    }
}

/// Whether a kernel list ("0,2-4") contains `number`.
fn in_list(list: &str, number: usize) -> bool {
    list.split(',').any(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        match (first.trim().parse::<usize>(), last.trim().parse::<usize>()) {
            (Ok(first), Ok(last)) => (first..=last).contains(&number),
            _ => false,
        }
    })
}
