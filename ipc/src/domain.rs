//! A domain: one shared-memory world. Processes of different domains never meet.

use crate::construction::{Site, lock_path, open_lock};
use crate::error::{Cause, IpcError};
use crate::node::Node;
use iceoryx2::prelude::{
    CallbackProgression, Config, FileName, FilePath, LogLevel, Node as IoxNode, NodeBuilder, NodeName,
    NodeState, Path, SemanticString, SignalHandlingMode, ipc, set_log_level,
};
use std::fmt;
use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, PermissionsExt};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use thiserror::Error;

/// Where all of shared memory lives.
const SHM: &str = "/dev/shm";
/// Digits of the hash (SHA-1 of a type name) with which iceoryx2 begins a file name after the prefix.
const TYPE_HASH_DIGITS: usize = 40;
/// How often a directory that vanishes under our hands is created again.
const ENTER_ATTEMPTS: usize = 100;
/// How long a removal waits for the last users to leave, and the pause between looks.
const REMOVAL_PATIENCE: Duration = Duration::from_millis(100);
const PAUSE: Duration = Duration::from_millis(1);

/// Why a domain cannot have this name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DomainError {
    /// Too short or too long.
    #[error("domain name `{name}` has {got} characters: expected 1 to {max}", max = Domain::MAX_NAME)]
    Length {
        /// The name that came.
        name: String,
        /// Its length in characters.
        got: usize,
    },
    /// A character that may not be part of it.
    #[error("domain name `{name}` has {found:?} at character {at}: expected only a-z, 0-9, _ and -")]
    Character {
        /// The name that came.
        name: String,
        /// The first character that may not be part of it.
        found: char,
        /// Its place, counted from 1.
        at: usize,
    },
}

/// A shared-memory world of its own: directory `/dev/shm/upswing.<name>.iox/`, shared memory
/// `/dev/shm/upswing_<name>_*`.
#[derive(Clone, PartialEq, Eq)]
pub struct Domain {
    name: String,
    config: Config,
}

/// A shared lock on a domain's directory: as long as it is held nobody removes the domain. Who drops the last one does.
pub(crate) struct Presence {
    lock: File,
    domain: Domain,
}

impl Drop for Presence {
    fn drop(&mut self) {
        // A shared lock becomes an exclusive one unless somebody else has one, too. What cannot be removed is left to
        // whoever joins next.
        if self.lock.try_lock().is_ok() {
            let _ = self.domain.remove(&self.lock);
        }
    }
}

impl fmt::Debug for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Domain").field(&self.name).finish()
    }
}

impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.name)
    }
}

impl Domain {
    /// Longest name, characters.
    pub const MAX_NAME: usize = 32;

    /// A domain called `name`: 1 to [`Domain::MAX_NAME`] characters of a-z, 0-9, _ and -. Touches no file.
    ///
    /// # Errors
    /// [`DomainError`] with the length or the first character that does not fit.
    pub fn new(name: &str) -> Result<Self, DomainError> {
        let got = name.chars().count();
        if !(1..=Self::MAX_NAME).contains(&got) {
            return Err(DomainError::Length { name: name.to_owned(), got });
        }
        let fits = |c: char| matches!(c, 'a'..='z' | '0'..='9' | '_' | '-');
        if let Some((i, found)) = name.chars().enumerate().find(|&(_, c)| !fits(c)) {
            return Err(DomainError::Character { name: name.to_owned(), found, at: i + 1 });
        }
        // Not `Config::global_config()`: that one looks for files in the working directory.
        let mut config = Config::default();
        // The two conversions cannot fail: the name is short and plain.
        let unreachable = |_| DomainError::Length { name: name.to_owned(), got };
        config.global.set_root_path(&Path::new(root_text(name).as_bytes()).map_err(unreachable)?);
        config.global.prefix = FileName::new(shm_prefix(name).as_bytes()).map_err(unreachable)?;
        // This crate cleans up itself, under the lock of `construction`.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(Self { name: name.to_owned(), config })
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The directory of the domain.
    pub fn root(&self) -> PathBuf {
        PathBuf::from(root_text(&self.name))
    }

    pub(crate) fn config(&self) -> &Config {
        &self.config
    }

    /// The shared memory of this domain, as paths in the file system.
    pub(crate) fn memory(&self) -> impl Iterator<Item = PathBuf> {
        let entries = std::fs::read_dir(SHM).into_iter().flatten().flatten();
        // Nothing else is opened: a pipe would block.
        let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
        let owned = files.filter(|entry| entry.file_name().to_str().is_some_and(|file| self.owns(file)));
        owned.map(|entry| entry.path())
    }

    /// Whether there are traces of the domain: somebody has joined it and not yet left, or died in it.
    pub fn exists(&self) -> bool {
        self.root().symlink_metadata().is_ok()
    }

    /// Joins the domain as `role` ("daemon", "planner", ...; for people and logs) and cleans up after processes
    /// of the domain that died. Who leaves it last, in good order, removes all traces of it.
    ///
    /// Installs no signal handlers and reads no configuration file but the one it writes into the domain's own
    /// directory.
    ///
    /// # Errors
    /// [`IpcError::Root`] or [`IpcError::Foreign`] if the directory cannot be used, [`IpcError::Connect`] if the
    /// node cannot be created, [`IpcError::Full`] if there is no room for it, [`IpcError::Limit`] if the system lets this
    /// process have too little.
    pub fn connect(&self, role: &str) -> Result<Node, IpcError> {
        Self::check_limits()?;
        self.with_room(|| self.join(role))
    }

    fn join(&self, role: &str) -> Result<Node, IpcError> {
        let presence = Presence { lock: self.hold_root()?, domain: self.clone() };
        let failed =
            |cause: Cause| IpcError::Connect { domain: self.name.clone(), role: role.to_owned(), cause };
        let name = NodeName::new(role).map_err(|e| failed(e.into()))?;
        let lock = lock_path(self);
        open_lock(&lock).map_err(|cause| IpcError::Root { action: "use", path: lock, cause })?;
        let site = Site::enter(self);
        self.set_process_defaults(&site)?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&self.config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| failed(e.into()))?;
        let node = Node::new(node, self.clone(), presence);
        node.clean_up_at(&site);
        Ok(node)
    }

    /// Removes all traces of the domain if no process uses it, and says whether there are none now. Needed only where
    /// the last one was killed.
    ///
    /// # Errors
    /// [`IpcError::Root`] or [`IpcError::Foreign`] if a file cannot be removed, [`IpcError::List`] if it cannot be
    /// found out who uses the domain.
    pub fn remove_if_unused(&self) -> Result<bool, IpcError> {
        if !self.exists() && self.memory().next().is_none() {
            return Ok(true);
        }
        let presence = self.open_root()?;
        let start = Instant::now();
        loop {
            match presence.try_lock() {
                Ok(()) => break,
                // A process that is being started holds its parent's locks for an instant.
                Err(TryLockError::WouldBlock) if start.elapsed() < REMOVAL_PATIENCE => {
                    std::thread::sleep(PAUSE)
                }
                Err(TryLockError::WouldBlock) => return Ok(false),
                Err(TryLockError::Error(cause)) => return Err(self.root_error("lock", cause)),
            }
        }
        self.remove(&presence)
    }

    /// Removes all traces of the domain, whose directory is locked by `presence`, unless programs in other languages,
    /// which do not lock it, use it; says whether it did.
    fn remove(&self, presence: &File) -> Result<bool, IpcError> {
        if !self.is_current(presence) || self.is_inhabited()? {
            return Ok(false);
        }
        for path in self.memory() {
            ignore_missing(std::fs::remove_file(&path)).map_err(|cause| IpcError::Root {
                action: "remove",
                path,
                cause,
            })?;
        }
        ignore_missing(std::fs::remove_dir_all(self.root()))
            .map_err(|cause| self.root_error("remove", cause))?;
        Ok(true)
    }

    /// Names of all other domains in which a process runs, in alphabetical order; those that cannot be looked into are left out.
    pub fn others(&self) -> Vec<String> {
        let Ok(files) = std::fs::read_dir(SHM) else { return Vec::new() };
        let names = files.filter_map(|file| {
            let file = file.ok()?.file_name().into_string().ok()?;
            Some(file.strip_prefix("upswing.")?.strip_suffix(".iox")?.to_owned())
        });
        let mut others: Vec<String> = names
            .filter(|name| *name != self.name)
            .filter(|name| Self::new(name).is_ok_and(|domain| domain.is_inhabited().unwrap_or(false)))
            .collect();
        others.sort();
        others
    }

    /// How many processes of the domain died and left something that nobody cleaned up yet. Touches nothing.
    ///
    /// # Errors
    /// [`IpcError::List`] if it cannot be found out.
    pub fn count_dead(&self) -> Result<usize, IpcError> {
        // Without the directory there is nobody; and to list creates nothing then.
        if !self.exists() {
            return Ok(0);
        }
        let mut dead = 0;
        self.for_each_node(|node| dead += usize::from(matches!(node, NodeState::Dead(_))))?;
        Ok(dead)
    }

    /// Whether processes are alive in the domain, also those that do not take part in the lock of its directory (other
    /// languages).
    fn is_inhabited(&self) -> Result<bool, IpcError> {
        let mut alive = false;
        self.for_each_node(|node| alive |= matches!(node, NodeState::Alive(_) | NodeState::Inaccessible(_)))?;
        Ok(alive)
    }

    pub(crate) fn for_each_node(
        &self,
        mut visit: impl FnMut(NodeState<ipc::Service>),
    ) -> Result<(), IpcError> {
        IoxNode::<ipc::Service>::list(&self.config, |node| {
            visit(node);
            CallbackProgression::Continue
        })
        .map_err(|e| IpcError::List { what: "nodes", domain: self.name.clone(), cause: e.into() })
    }

    /// Whether `file` in [`SHM`] is this domain's. The prefix alone does not tell: that of `a` also begins the
    /// files of `a_b`. After it iceoryx2 writes a hash, longer than any name of a domain, so the hash does.
    fn owns(&self, file: &str) -> bool {
        file.strip_prefix(&shm_prefix(&self.name)).and_then(|rest| rest.split_once('_')).is_some_and(
            |(hash, _)| hash.len() == TYPE_HASH_DIGITS && hash.bytes().all(|b| b.is_ascii_hexdigit()),
        )
    }

    /// Opens the directory of the domain, creates it if need be, and insists that only this user can enter it.
    fn open_root(&self) -> Result<File, IpcError> {
        let root = self.root();
        for _ in 0..ENTER_ATTEMPTS {
            match DirBuilder::new().mode(0o700).create(&root) {
                Err(e) if e.kind() != ErrorKind::AlreadyExists => return Err(self.root_error("create", e)),
                _ => {}
            }
            let link = match root.symlink_metadata() {
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                other => other.map_err(|cause| self.root_error("inspect", cause))?,
            };
            // SAFETY: no arguments, cannot fail.
            let expected = unsafe { libc::geteuid() };
            if !link.is_dir() || link.uid() != expected {
                return Err(IpcError::Foreign { path: root, expected });
            }
            let directory = match File::open(&root) {
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                other => other.map_err(|cause| self.root_error("open", cause))?,
            };
            if link.mode() & 0o077 != 0 {
                directory
                    .set_permissions(Permissions::from_mode(0o700))
                    .map_err(|cause| self.root_error("restrict", cause))?;
            }
            if self.is_current(&directory) {
                return Ok(directory);
            }
        }
        Err(self.root_error("enter", ErrorKind::NotFound.into()))
    }

    /// The directory of the domain with a shared lock on it: as long as it is held nobody removes the domain.
    fn hold_root(&self) -> Result<File, IpcError> {
        for _ in 0..ENTER_ATTEMPTS {
            let directory = self.open_root()?;
            directory.lock_shared().map_err(|cause| self.root_error("lock", cause))?;
            // The directory may have been removed before the lock was ours: then it is the lock of a ghost.
            if self.is_current(&directory) {
                return Ok(directory);
            }
        }
        Err(self.root_error("hold", ErrorKind::NotFound.into()))
    }

    /// Whether `directory` is still what the path of the domain leads to.
    fn is_current(&self, directory: &File) -> bool {
        match (directory.metadata(), self.root().symlink_metadata()) {
            (Ok(opened), Ok(named)) => (opened.dev(), opened.ino()) == (named.dev(), named.ino()),
            _ => false,
        }
    }

    /// Sets what iceoryx2 keeps once per process: its log level, and its global configuration.
    ///
    /// All calls of this crate pass their configuration, except inside iceoryx2: the clean-up after a process that
    /// was killed before its node was complete falls back to the global one. Unless that is set, iceoryx2 would
    /// look for it in the working directory. In a process with several domains the first one stays set.
    fn set_process_defaults(&self, _site: &Site) -> Result<(), IpcError> {
        static LOADED: std::sync::Mutex<bool> = std::sync::Mutex::new(false);
        let mut loaded = LOADED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if *loaded {
            return Ok(());
        }
        set_log_level(LogLevel::Error);
        let file = self.root().join("iceoryx2.toml");
        let settings = format!(
            "[global]\nroot-path = \"{}\"\nprefix = \"{}\"\n",
            root_text(&self.name),
            shm_prefix(&self.name)
        );
        let failed = |action| {
            let path = file.clone();
            move |cause| IpcError::Root { action, path, cause }
        };
        // In place, not by a draft that a killed process would leave: on site nobody else reads it. Opened like a lock:
        // what is no regular file could block.
        let written = open_lock(&file).and_then(|opened| {
            opened.set_len(0)?;
            opened.write_all_at(settings.as_bytes(), 0)
        });
        written.map_err(failed("write"))?;
        let path = FilePath::new(file.as_os_str().as_encoded_bytes())
            .map_err(|e| failed("name")(std::io::Error::other(format!("{e:?}"))))?;
        Config::setup_global_config_from_file(&path).map_err(|e| failed("load")(std::io::Error::other(e)))?;
        *loaded = true;
        Ok(())
    }

    fn root_error(&self, action: &'static str, cause: std::io::Error) -> IpcError {
        IpcError::Root { action, path: self.root(), cause }
    }
}

// What makes `Domain::owns` unambiguous.
const _: () = assert!(Domain::MAX_NAME < TYPE_HASH_DIGITS);

fn root_text(name: &str) -> String {
    format!("{SHM}/upswing.{name}.iox")
}

fn shm_prefix(name: &str) -> String {
    format!("upswing_{name}_")
}

fn ignore_missing(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
