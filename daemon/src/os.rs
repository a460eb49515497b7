//! Clock, scheduler and memory calls.

use std::io::Error;
use upswing_config::RealtimeSettings;

/// CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is a valid place to write to; this clock always exists.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Sleeps until `t_ns` (CLOCK_MONOTONIC, ns); not at all if that is past.
pub fn sleep_until(t_ns: u64) {
    let seconds = libc::time_t::try_from(t_ns / 1_000_000_000).unwrap_or(libc::time_t::MAX);
    let until = libc::timespec { tv_sec: seconds, tv_nsec: (t_ns % 1_000_000_000) as libc::c_long };
    let sleep = || {
        // SAFETY: `until` is a valid absolute time; no remaining time is asked for.
        unsafe {
            libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &until, std::ptr::null_mut())
        }
    };
    while sleep() == libc::EINTR {}
}

/// Keeps all memory of the process, also that of the future, out of swap and free of page faults.
///
/// # Errors
/// What was refused, and how to grant it.
pub fn lock_memory() -> Result<(), String> {
    let unlimited = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };
    let mut limit = unlimited;
    // With a finite limit the lock could be granted now and a later allocation fail, so it has to go first. Setting
    // it needs a privilege; somebody else may have set it before.
    // SAFETY: both limits are valid for the duration of the calls.
    unsafe {
        libc::setrlimit(libc::RLIMIT_MEMLOCK, &unlimited);
        libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit);
    }
    const GRANT: &str = "set LimitMEMLOCK=infinity in the unit, or memlock unlimited in limits.conf";
    if limit.rlim_cur != libc::RLIM_INFINITY {
        return Err(format!("memory lock (at most {} bytes; {GRANT})", limit.rlim_cur));
    }
    // SAFETY: no pointers; it changes the residency of memory, not its contents.
    match unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) } {
        0 => Ok(()),
        _ => Err(format!("memory lock ({}; {GRANT})", Error::last_os_error())),
    }
}

/// Gives the calling thread the priority, CPU and timer precision of the settings.
///
/// # Errors
/// What was refused, and how to grant it; the rest is done nevertheless.
pub fn make_realtime(settings: &RealtimeSettings) -> Result<(), String> {
    // SAFETY: no pointers. Matters only without real-time priority, where sleeps last 50 us longer by default.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1_u64) };
    let mut refused = Vec::new();
    let priority = libc::sched_param { sched_priority: i32::from(settings.priority) };
    // SAFETY: `priority` is valid for the duration of the call; 0 means this thread.
    if unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &priority) } != 0 {
        refused.push(format!(
            "SCHED_FIFO priority {} ({}; set LimitRTPRIO={} in the unit, or rtprio in limits.conf)",
            settings.priority,
            Error::last_os_error(),
            settings.priority
        ));
    }
    if let Some(cpu) = settings.cpu {
        // SAFETY: all-zero is the empty set; the settings allow CPUs 0 to 1023 only, which fit into it; the set is
        // valid for the duration of the call.
        let result = unsafe {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(cpu, &mut set);
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &set)
        };
        if result != 0 {
            let cause = Error::last_os_error();
            refused.push(format!(
                "CPU {cpu} ({cause}; choose another realtime.cpu, or allow it in AllowedCPUs)"
            ));
        }
    }
    if refused.is_empty() { Ok(()) } else { Err(refused.join(", ")) }
}
