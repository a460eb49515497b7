//! One builder at a time, so that the ruins of a killed one can be told from a building site.
//!
//! A process that is killed while it creates a service leaves unfinished files. iceoryx2 0.10 takes them for the
//! work of somebody who is still at it: opening that service fails for good, and for root even listing services or
//! cleaning up waits without end. So every creation in a domain happens under one lock, and whoever gets the lock
//! removes what is unfinished: nobody is building it. The same goes for nodes, which iceoryx2 takes for starting ones for
//! good, and for connections of ports that are gone, which it forgets.
//!
//! A process that is stopped (by a debugger, by Ctrl-Z) keeps its lock. Nobody waits for one that is, and for a lock that
//! is not given back otherwise each process waits once: see [`Site`].

use crate::domain::Domain;
use std::collections::HashSet;
use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// How long to wait for the lock. Its holders need milliseconds, on a loaded machine some hundred.
const PATIENCE: Duration = Duration::from_secs(2);
/// Pause between looks at the lock, and how many of them pass between two looks at its holder.
const PAUSE: Duration = Duration::from_micros(500);
const LOOKS: u32 = 16;
/// Inode of the lock that this process gave up waiting for; 0: none. It does not wait for it again before it has had it.
static GIVEN_UP: AtomicU64 = AtomicU64::new(0);
/// From this age on an unfinished connection or node is an orphan. iceoryx2 creates connections while it sends and
/// receives, and programs in other languages create nodes: both without the lock, within milliseconds.
const ORPHAN_AGE: Duration = Duration::from_secs(2);
/// Permission bits.
const OWNER_READ: u32 = 0o400;
const OWNER_WRITE: u32 = 0o200;

/// The right to create, list and clean up in a domain, until dropped. Not reentrant.
pub(crate) struct Site {
    lock: Option<File>,
    /// Whether nothing is under construction: iceoryx2 does not hang when it lists services.
    clear: bool,
}

impl Site {
    /// Waits for the right and clears the site. If its holder is stopped, or that takes too long, it does without: then
    /// creation is no safer than iceoryx2 makes it.
    pub(crate) fn enter(domain: &Domain) -> Self {
        Self::enter_while(domain, &|| true)
    }

    /// As [`Self::enter`], but waits only as long as `wanted` says so.
    pub(crate) fn enter_while(domain: &Domain, wanted: &dyn Fn() -> bool) -> Self {
        let lock = acquire(domain, wanted);
        if lock.is_some() {
            domain.memory().for_each(|path| remove_if(&path, is_unfinished_memory));
            descriptions(domain)
                .for_each(|path| remove_if(&path, |_, state| is_unfinished_description(state)));
            let ports = clear_nodes(&domain.root().join("nodes"));
            domain.memory().for_each(|path| {
                remove_if(&path, |path, state| is_old(state) && is_without_port(path, &ports));
            });
        }
        let clear = lock.is_some() || is_clear(domain);
        Self { lock, clear }
    }

    /// Whether nobody else creates or cleans up.
    pub(crate) fn is_own(&self) -> bool {
        self.lock.is_some()
    }

    /// Whether services can be listed and opened.
    pub(crate) fn is_clear(&self) -> bool {
        self.clear
    }
}

fn descriptions(domain: &Domain) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(domain.root().join("services")).into_iter().flatten().flatten();
    entries.map(|entry| entry.path())
}

/// Whether nothing is unfinished, as far as can be seen without the lock.
fn is_clear(domain: &Domain) -> bool {
    let state = |path: &Path| path.symlink_metadata();
    domain.memory().all(|path| state(&path).is_ok_and(|state| !is_unfinished_memory(&path, &state)))
        && descriptions(domain).all(|path| state(&path).is_ok_and(|state| !is_unfinished_description(&state)))
}

/// Gives connections that are still without any memory a byte of it.
///
/// To clean up after a port, iceoryx2 0.10 opens its connections; it takes an unfinished one for what it is, unless it is
/// empty: then, as root, it waits for its creator without end, even for one that was killed. A creator that lives sets
/// the size itself.
pub(crate) fn fill_empty_connections(domain: &Domain) {
    let connections = domain.memory().filter(|path| is_connection(path));
    for path in connections.filter(|path| path.metadata().is_ok_and(|state| state.len() == 0)) {
        // One that cannot be opened is gone, or complete by now.
        let _ = OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(1));
    }
}

fn remove_if(path: &Path, condition: impl FnOnce(&Path, &Metadata) -> bool) {
    if path.symlink_metadata().is_ok_and(|state| state.is_file() && condition(path, &state)) {
        // If it cannot be removed it is gone already, or this user cannot open it anyway.
        let _ = std::fs::remove_file(path);
    }
}

/// Opens the file that is locked, at `path`.
///
/// # Errors
/// Also if it is no regular file: a pipe without a reader would otherwise block for good.
pub(crate) fn open_lock(path: &Path) -> std::io::Result<File> {
    let odd = || Error::new(ErrorKind::InvalidInput, "it is not a regular file");
    if path.symlink_metadata().is_ok_and(|state| !state.is_file()) {
        return Err(odd());
    }
    // Whatever it may have become meanwhile.
    let flags = libc::O_NONBLOCK | libc::O_NOFOLLOW;
    let file = OpenOptions::new().create(true).truncate(false).write(true).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(odd()) }
}

/// Path of the lock of a domain.
pub(crate) fn lock_path(domain: &Domain) -> PathBuf {
    domain.root().join("construction.lock")
}

fn acquire(domain: &Domain, wanted: &dyn Fn() -> bool) -> Option<File> {
    let file = open_lock(&lock_path(domain)).ok()?;
    let state = file.metadata().ok()?;
    let given_up = || GIVEN_UP.load(Ordering::Relaxed) == state.ino();
    let start = Instant::now();
    let mut looks = 0_u32;
    loop {
        match file.try_lock() {
            Ok(()) => {
                if given_up() {
                    GIVEN_UP.store(0, Ordering::Relaxed);
                }
                return Some(file);
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(_)) => return None,
        }
        if given_up() || !wanted() || (looks.is_multiple_of(LOOKS) && holder_is_stopped(&state)) {
            return None;
        }
        if start.elapsed() > PATIENCE {
            GIVEN_UP.store(state.ino(), Ordering::Relaxed);
            return None;
        }
        looks += 1;
        std::thread::sleep(PAUSE);
    }
}

/// Whether the process that has the lock of a file is stopped: proc_locks(5), and the state in proc_pid_stat(5).
fn holder_is_stopped(file: &Metadata) -> bool {
    let (major, minor) = (libc::major(file.dev()), libc::minor(file.dev()));
    let id = format!("{major:02x}:{minor:02x}:{}", file.ino());
    let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
    let holder = locks.lines().find_map(|line| {
        let fields: Vec<_> = line.split_whitespace().collect();
        (fields.get(1) == Some(&"FLOCK") && fields.get(5) == Some(&id.as_str())).then(|| fields[4].to_owned())
    });
    let stat = holder.and_then(|pid| std::fs::read_to_string(format!("/proc/{pid}/stat")).ok());
    let state = stat.as_ref().and_then(|stat| stat.rsplit_once(')')).map(|(_, rest)| rest.trim_start());
    state.is_some_and(|rest| rest.starts_with(['T', 't']))
}

/// iceoryx2 lets the owner read shared memory only when it is complete.
fn is_unfinished_memory(path: &Path, state: &Metadata) -> bool {
    state.mode() & OWNER_READ == 0 && (!is_connection(path) || is_old(state))
}

fn is_connection(path: &Path) -> bool {
    path.extension().is_some_and(|suffix| suffix == "connection")
}

/// iceoryx2 forbids the owner to write to the description of a service, and to a tag, when it is complete.
fn is_unfinished_description(state: &Metadata) -> bool {
    state.mode() & OWNER_WRITE != 0
}

/// Removes the nodes that were never finished, and such tags of the others, which iceoryx2 overlooks when it removes the
/// rest of a dead node; returns the ports of the finished.
///
/// iceoryx2 first makes a folder `<id>` with the details of a node and the tags of its ports, then files `*_<id>.*`, and
/// makes the context, one of them, readable last.
fn clear_nodes(nodes: &Path) -> HashSet<String> {
    let entries = || std::fs::read_dir(nodes).into_iter().flatten().flatten().map(|entry| entry.path());
    let kind =
        |suffix: &'static str| entries().filter(move |path| path.extension().is_some_and(|s| s == suffix));
    // Its monitor goes before its context: who is killed in between leaves a context that nobody looks at. Where nothing
    // came or went lately, nobody is at it.
    let calm = nodes.symlink_metadata().is_ok_and(|state| is_old(&state));
    let monitored: HashSet<_> = kind("node_monitor").filter_map(|path| id(&path)).collect();
    let finished: HashSet<_> = kind("node_monitor_context")
        .filter(|path| path.metadata().is_ok_and(|state| state.mode() & OWNER_READ != 0))
        .filter_map(|path| id(&path))
        .filter(|id| monitored.contains(id) || !calm)
        .collect();
    let mut ports = HashSet::new();
    for path in entries() {
        let Some(node) = id(&path) else { continue };
        if finished.contains(&node) {
            let tags = || std::fs::read_dir(&path).into_iter().flatten().flatten().map(|tag| tag.path());
            tags().for_each(|tag| {
                remove_if(&tag, |_, state| is_unfinished_description(state) && is_old(state))
            });
            ports.extend(
                tags().filter(|tag| tag.extension().is_some_and(|s| s == "port_tag")).filter_map(|p| id(&p)),
            );
        } else if path.symlink_metadata().is_ok_and(|state| is_old(&state)) {
            let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        }
    }
    ports
}

/// Whether it is a connection, `*_<sender>_<receiver>.connection`, one end of which has no port.
fn is_without_port(path: &Path, ports: &HashSet<String>) -> bool {
    let Some(ends) = path.file_stem().and_then(|stem| stem.to_str()) else { return false };
    is_connection(path) && ends.rsplit('_').take(2).any(|port| !ports.contains(port))
}

/// The number with which iceoryx2 ends the name of what belongs to one node or port.
fn id(path: &Path) -> Option<String> {
    let number = path.file_stem()?.to_str()?.rsplit('_').next()?;
    number.bytes().all(|b| b.is_ascii_digit()).then(|| number.to_owned())
}

fn is_old(state: &Metadata) -> bool {
    state.modified().ok().and_then(|t| t.elapsed().ok()).is_some_and(|age| age > ORPHAN_AGE)
}
