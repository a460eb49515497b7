//! Calls of the operating system for scheduling and memory.

use std::fs::File;
use std::io::{Error, ErrorKind, Write};
use upswing_config::RealtimeSettings;
use upswing_ipc::Degradation;

/// Locked memory that a limit must allow, bytes: the process with all its segments uses less.
const ENOUGH_MEMORY: libc::rlim_t = 256 << 20;
/// Heap that is touched before the first cycle, bytes: rings, recorder, plans.
const HEAP: usize = 18 << 20;
/// Stack that is touched before the first cycle, bytes; the cycle uses less.
const STACK: usize = 256 << 10;
const PAGE: usize = 4096;
/// File that keeps CPUs out of deep sleep while it is open.
const DMA_LATENCY: &str = "/dev/cpu_dma_latency";
/// Remedy for a refused memory lock.
const MEMORY_GRANT: &str = "set LimitMEMLOCK=infinity in the unit, or memlock unlimited in limits.conf";

/// Id of the calling thread.
pub fn thread_id() -> u32 {
    // SAFETY: takes nothing, cannot fail.
    unsafe { libc::gettid() }.cast_unsigned()
}

/// Real-time setting that the system refuses, with the reason and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum RefusedSetting {
    /// Memory cannot be locked.
    #[error("memory lock ({cause}; {MEMORY_GRANT})")]
    MemoryLock {
        /// Error of the operating system.
        cause: Error,
    },
    /// Too little memory may be locked.
    #[error("memory lock (at most {limit} bytes, {ENOUGH_MEMORY} are needed; {MEMORY_GRANT})")]
    MemoryLimit {
        /// Memory that may be locked, bytes.
        limit: libc::rlim_t,
    },
    /// The file against deep sleep of CPUs cannot be opened.
    #[error("{DMA_LATENCY} ({cause}; allow the daemon's user to write to it)")]
    DmaLatencyFile {
        /// Error of the operating system.
        cause: Error,
    },
    /// The kernel does not take the longest latency of a CPU.
    #[error("{DMA_LATENCY} ({cause})")]
    DmaLatency {
        /// Error of the operating system.
        cause: Error,
    },
    /// The precision of timers cannot be set.
    #[error("timer slack ({cause})")]
    TimerSlack {
        /// Error of the operating system.
        cause: Error,
    },
    /// The thread may not have its priority.
    #[error(
        "SCHED_FIFO priority {priority} ({cause}; set LimitRTPRIO={priority} in the unit, or rtprio in limits.conf)"
    )]
    Scheduler {
        /// SCHED_FIFO priority of the settings.
        priority: u8,
        /// Error of the operating system, or another scheduling policy than the requested one.
        cause: Error,
    },
    /// The thread may not run on its CPU.
    #[error("CPU {cpu} ({cause}; choose another realtime.cpu, or allow it in AllowedCPUs)")]
    Cpu {
        /// CPU of the settings.
        cpu: usize,
        /// Error of the operating system.
        cause: Error,
    },
}

impl RefusedSetting {
    /// The degradation that follows from the refusal.
    pub fn degradation(&self) -> Degradation {
        match self {
            Self::MemoryLock { .. } | Self::MemoryLimit { .. } => Degradation::Memory,
            Self::DmaLatencyFile { .. } | Self::DmaLatency { .. } => Degradation::DmaLatency,
            Self::TimerSlack { .. } => Degradation::TimerSlack,
            Self::Scheduler { .. } => Degradation::Scheduler,
            Self::Cpu { .. } => Degradation::Cpu,
        }
    }
}

/// Preparation of the process for real time, to be kept until its end: dropping it permits deep sleep of the CPU again.
#[derive(Debug)]
pub struct PreparedProcess {
    /// Request to the kernel; closing the file withdraws it.
    _latency: Option<File>,
}

/// Prepares the process before it opens or maps anything: locks and touches memory, forbids deep sleep of the CPU. Returns
/// also the refusals.
pub fn prepare_process() -> (PreparedProcess, Vec<RefusedSetting>) {
    touch_heap();
    let memory = lock_memory();
    let (latency, denied) = match forbid_deep_sleep() {
        Ok(file) => (file, None),
        Err(refused) => (None, Some(refused)),
    };
    (PreparedProcess { _latency: latency }, memory.err().into_iter().chain(denied).collect())
}

/// Locks all memory of the process, also future memory: no swap, and no page faults of present memory. Future memory
/// is locked when it is touched: shared memory is sized for the worst case, and the service thread first touches the parts
/// that the real-time thread uses.
fn lock_memory() -> Result<(), RefusedSetting> {
    let unlimited = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };
    let mut limit = unlimited;
    // Any process may raise the limit up to the hard limit, a privileged one beyond it; the limit that is read back counts.
    // SAFETY: both limits are valid for the duration of the calls.
    let read = unsafe {
        if libc::setrlimit(libc::RLIMIT_MEMLOCK, &raw const unlimited) != 0
            && libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit) == 0
        {
            limit.rlim_cur = limit.rlim_max;
            libc::setrlimit(libc::RLIMIT_MEMLOCK, &raw const limit);
        }
        libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit)
    };
    if read != 0 {
        return Err(RefusedSetting::MemoryLock { cause: Error::last_os_error() });
    }
    // With too low a limit, the lock would be granted now, but a later allocation would fail.
    if limit.rlim_cur < ENOUGH_MEMORY && !may_exceed_memory_limit() {
        return Err(RefusedSetting::MemoryLimit { limit: limit.rlim_cur });
    }
    for what in [libc::MCL_CURRENT, libc::MCL_FUTURE | libc::MCL_ONFAULT] {
        // SAFETY: no pointers; it changes the residency of memory, not its contents.
        if unsafe { libc::mlockall(what) } != 0 {
            return Err(RefusedSetting::MemoryLock { cause: Error::last_os_error() });
        }
    }
    Ok(())
}

/// Whether the process has CAP_IPC_LOCK, which exempts it from the limit.
fn may_exceed_memory_limit() -> bool {
    /// Bit of the capability in `capability.h`.
    const CAP_IPC_LOCK: u32 = 14;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let bits = effective.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok()).unwrap_or(0);
    bits & (1 << CAP_IPC_LOCK) != 0
}

/// Maps and touches the heap that the daemon will use, so that its first use does not fault even if memory cannot be
/// locked.
fn touch_heap() {
    // One arena that never shrinks: touched memory stays mapped.
    #[cfg(target_env = "gnu")]
    // SAFETY: no pointers; concerns where later allocations come from. If refused, they fault once.
    unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
    let mut heap: Vec<u8> = Vec::with_capacity(HEAP);
    for page in heap.spare_capacity_mut().iter_mut().step_by(PAGE) {
        // SAFETY: a valid place for one byte. Volatile: the memory is touched though nobody reads it.
        unsafe { std::ptr::write_volatile(page.as_mut_ptr(), 0) };
    }
}

/// Touches the stack that the calling thread will use.
#[inline(never)]
fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for byte in stack.iter_mut().step_by(PAGE) {
        // SAFETY: a valid place for one byte. Volatile: the memory is touched though nobody reads it.
        unsafe { std::ptr::write_volatile(byte, 1) };
    }
}

/// Asks the kernel to keep CPUs out of deep sleep while the file is open. `None`: the system has no such states.
fn forbid_deep_sleep() -> Result<Option<File>, RefusedSetting> {
    let mut file = match File::options().write(true).open(DMA_LATENCY) {
        Ok(file) => file,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        Err(cause) => return Err(RefusedSetting::DmaLatencyFile { cause }),
    };
    // Latency in us.
    match file.write_all(&0_i32.to_ne_bytes()) {
        Ok(()) => Ok(Some(file)),
        Err(cause) => Err(RefusedSetting::DmaLatency { cause }),
    }
}

/// Sets CPU, timer precision and arithmetic of the calling thread for real time, touches its stack, and checks whether it
/// may have the priority that [`set_priority`] sets. Returns the refusals; the other settings are applied nevertheless.
pub fn prepare_thread(settings: &RealtimeSettings) -> Vec<RefusedSetting> {
    touch_stack();
    flush_to_zero();
    let mut refused = Vec::new();
    // SAFETY: no pointers. Matters only without real-time priority, where sleeps last 50 us longer by default.
    if unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1_u64) } != 0 {
        refused.push(RefusedSetting::TimerSlack { cause: Error::last_os_error() });
    }
    let priority = settings.priority;
    let granted = set_priority(thread_id(), Some(priority)).and_then(|()| {
        // SAFETY: no pointers; 0 means this thread.
        match unsafe { libc::sched_getscheduler(0) } & !libc::SCHED_RESET_ON_FORK {
            libc::SCHED_FIFO => set_priority(thread_id(), None),
            policy => Err(Error::other(format!("policy {policy}"))),
        }
    });
    if let Err(cause) = granted {
        refused.push(RefusedSetting::Scheduler { priority, cause });
    }
    if let Some(cpu) = settings.cpu {
        // SAFETY: all-zero is the empty set; the settings allow CPUs 0 to 1023 only, which fit into it; the set is
        // valid for the duration of the call.
        let result = unsafe {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(cpu, &mut set);
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set)
        };
        if result != 0 {
            refused.push(RefusedSetting::Cpu { cpu, cause: Error::last_os_error() });
        }
    }
    refused
}

/// Sets or removes SCHED_FIFO with a priority for a thread of this process; threads that it starts do not inherit it.
///
/// # Errors
/// The error of the operating system.
pub fn set_priority(thread: u32, priority: Option<u8>) -> std::io::Result<()> {
    let policy = priority.map_or(libc::SCHED_OTHER, |_| libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK);
    let parameters = libc::sched_param { sched_priority: priority.map_or(0, i32::from) };
    // SAFETY: `parameters` is valid for the duration of the call.
    match unsafe { libc::sched_setscheduler(thread.cast_signed(), policy, &raw const parameters) } {
        0 => Ok(()),
        _ => Err(Error::last_os_error()),
    }
}

/// Makes subnormal results count as 0 in the calling thread: arithmetic with them takes a hundred times as long
/// on some CPUs.
pub fn flush_to_zero() {
    #[cfg(target_arch = "x86_64")]
    {
        /// FTZ and DAZ of MXCSR.
        const BITS: u32 = 1 << 15 | 1 << 6;
        let mut control = 0_u32;
        // SAFETY: reads and writes the control register of this thread, through a valid place; rounding and exception
        // masks stay.
        unsafe {
            std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut control, options(nostack));
            control |= BITS;
            std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const control, options(nostack));
        }
    }
    #[cfg(target_arch = "aarch64")]
    {
        /// FZ of FPCR.
        const BIT: u64 = 1 << 24;
        let mut control: u64;
        // SAFETY: reads and writes the control register of this thread; rounding and exception masks stay.
        unsafe {
            std::arch::asm!("mrs {}, fpcr", out(reg) control, options(nostack));
            control |= BIT;
            std::arch::asm!("msr fpcr, {}", in(reg) control, options(nostack));
        }
    }
}
