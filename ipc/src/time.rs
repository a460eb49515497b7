//! CLOCK_MONOTONIC, the clock that all processes share: reading it, and sleeping until a time.

/// Time on CLOCK_MONOTONIC, ns since the machine started, the same for all processes. For the real-time thread too.
pub fn monotonic_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is a valid place to write to; this clock always exists.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Sleeps until `t_ns` (CLOCK_MONOTONIC, ns), also if signals arrive; returns at once if that is past. For the
/// real-time thread too.
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
