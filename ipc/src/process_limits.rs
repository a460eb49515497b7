//! Limits of the operating system on a process (rlimits), checked before something fails because of them.

use crate::domain::Domain;
use crate::error::IpcError;

/// Open files of a process that is connected to the largest number of peers: the daemon has about 40 of its own, and two for
/// each connection.
const OPEN_FILES: libc::rlim_t = 256;
/// Address space of a process that has mapped the shared memory of all these peers, bytes.
const ADDRESS_SPACE: libc::rlim_t = 512 << 20;

impl Domain {
    /// Checks that the limits of the operating system on this process are high enough for a domain; raises them where this
    /// process may do so.
    ///
    /// # Errors
    /// [`IpcError::Limit`] names the limit that is too low.
    pub fn check_limits() -> Result<(), IpcError> {
        require(libc::RLIMIT_NOFILE, OPEN_FILES, "open files", "ulimit -n, LimitNOFILE= of a unit")?;
        require(libc::RLIMIT_AS, ADDRESS_SPACE, "bytes of address space", "ulimit -v, LimitAS= of a unit")
    }
}

fn require(
    resource: libc::__rlimit_resource_t,
    needed: libc::rlim_t,
    what: &'static str,
    setting: &'static str,
) -> Result<(), IpcError> {
    let mut limit = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };
    // SAFETY: `limit` is valid for the duration of the calls. A limit that cannot be read is not checked.
    unsafe {
        if libc::getrlimit(resource, &raw mut limit) == 0 && limit.rlim_cur < needed {
            limit.rlim_cur = needed.min(limit.rlim_max);
            libc::setrlimit(resource, &raw const limit);
            libc::getrlimit(resource, &raw mut limit);
        }
    }
    if limit.rlim_cur < needed {
        return Err(IpcError::Limit { what, allowed: limit.rlim_cur, needed, setting });
    }
    Ok(())
}
