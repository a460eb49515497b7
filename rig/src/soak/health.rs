//! Memory, handles and threads of the processes of a system over time.

use crate::session::{Role, Session};
use serde::Serialize;

/// Memory, handles and threads of one process at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ProcessResources {
    /// Process id.
    pub pid: u32,
    /// Resident memory, KiB: private, mapped files, and the pages of shared memory touched so far.
    pub resident_kib: u64,
    /// Private resident memory (RssAnon), KiB; a leak makes it grow.
    pub own_kib: u64,
    /// Number of open file descriptors.
    pub handles: usize,
    /// Number of threads.
    pub threads: usize,
}

impl ProcessResources {
    /// Reads the resources of process `pid` from /proc; `None` if it is gone or belongs to another user.
    pub fn of(pid: u32) -> Option<Self> {
        let folder = |name: &str| std::fs::read_dir(format!("/proc/{pid}/{name}")).ok().map(Iterator::count);
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
        let kib = |key: &str| {
            let value = status.lines().find_map(|line| line.strip_prefix(key))?;
            value.split_whitespace().next()?.parse().ok()
        };
        Some(Self {
            pid,
            resident_kib: kib("VmRSS:")?,
            own_kib: kib("RssAnon:")?,
            handles: folder("fd")?,
            threads: folder("task")?,
        })
    }
}

/// Resources of all processes of a system at one time.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ResourceSample {
    /// Time since the start of the run, s.
    pub t_s: f64,
    /// upswingd; `None` if it does not run.
    pub daemon: Option<ProcessResources>,
    /// upswing-planner; `None` if it does not run.
    pub planner: Option<ProcessResources>,
    /// upswing-plant; `None` if it does not run.
    pub plant: Option<ProcessResources>,
    /// This process, which drives the system.
    pub operator: Option<ProcessResources>,
}

impl ResourceSample {
    /// Samples the processes of a session, `t_s` (s) after the start of the run.
    pub fn take(session: &Session, t_s: f64) -> Self {
        let of = |role| session.pid(role).and_then(ProcessResources::of);
        Self {
            t_s,
            daemon: of(Role::Daemon),
            planner: of(Role::Planner),
            plant: of(Role::Plant),
            operator: ProcessResources::of(std::process::id()),
        }
    }
}

/// Range of the resources of one role over all samples.
#[derive(Clone, Debug, Serialize)]
pub struct ResourceGrowth {
    /// Role: daemon, planner, plant or operator.
    pub role: &'static str,
    /// Number of successive processes in this role.
    pub processes: usize,
    /// Smallest and largest resident memory, KiB.
    pub resident_kib: (u64, u64),
    /// Smallest and largest number of open file descriptors.
    pub handles: (usize, usize),
    /// Largest growth of the private memory of one process since its first sample, KiB.
    pub grown_kib: i64,
}

impl ResourceGrowth {
    /// The growth of each role that occurs in the samples.
    pub fn of(samples: &[ResourceSample]) -> Vec<Self> {
        type ProcessOf = fn(&ResourceSample) -> Option<ProcessResources>;
        let roles: [(_, ProcessOf); 4] = [
            ("daemon", |s| s.daemon),
            ("planner", |s| s.planner),
            ("plant", |s| s.plant),
            ("operator", |s| s.operator),
        ];
        roles
            .into_iter()
            .filter_map(|(role, of)| Self::of_role(role, samples.iter().filter_map(of)))
            .collect()
    }

    fn of_role(role: &'static str, mut samples: impl Iterator<Item = ProcessResources>) -> Option<Self> {
        let mut first = samples.next()?;
        let (kib, handles) = (first.resident_kib, first.handles);
        let mut growth =
            Self { role, processes: 1, resident_kib: (kib, kib), handles: (handles, handles), grown_kib: 0 };
        for sample in samples {
            let (kib, handles) = (sample.resident_kib, sample.handles);
            growth.resident_kib = (growth.resident_kib.0.min(kib), growth.resident_kib.1.max(kib));
            growth.handles = (growth.handles.0.min(handles), growth.handles.1.max(handles));
            if sample.pid == first.pid {
                growth.grown_kib = growth.grown_kib.max(sample.own_kib as i64 - first.own_kib as i64);
            } else {
                growth.processes += 1;
                first = sample;
            }
        }
        Some(growth)
    }
}

impl std::fmt::Display for ResourceGrowth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mib = |kib: u64| kib as f64 / 1024.0;
        write!(
            f,
            "{:<9} {} processes, memory {:.1} to {:.1} MiB, private memory of one grew by at most {:.1} MiB; handles {} to {}",
            self.role,
            self.processes,
            mib(self.resident_kib.0),
            mib(self.resident_kib.1),
            self.grown_kib as f64 / 1024.0,
            self.handles.0,
            self.handles.1
        )
    }
}

#[cfg(test)]
mod tests {
    use super::{ProcessResources, ResourceGrowth};

    #[test]
    fn growth_is_that_of_one_process() {
        // Touched shared memory does not count as growth.
        let held = |pid, own_kib, handles| ProcessResources {
            pid,
            resident_kib: own_kib + 10 * handles as u64,
            own_kib,
            handles,
            threads: 1,
        };
        let samples = [held(1, 100, 5), held(1, 130, 7), held(2, 90, 4), held(2, 95, 4)];
        let growth = ResourceGrowth::of_role("plant", samples.into_iter()).expect("samples");
        assert_eq!((growth.processes, growth.grown_kib), (2, 30));
        assert_eq!((growth.resident_kib, growth.handles), ((130, 200), (4, 7)));
    }

    #[test]
    fn this_process_holds_something() {
        let own = ProcessResources::of(std::process::id()).expect("this process");
        assert!(
            own.resident_kib > own.own_kib && own.own_kib > 0 && own.handles > 2 && own.threads > 0,
            "{own:?}"
        );
    }
}
