//! Domains: separate worlds of shared memory on one machine. Processes of different domains never meet.

use crate::error::IpcError;
use crate::iox::{Layout, TYPE_HASH_DIGITS, reservation};
use iceoryx2::prelude::{
    CallbackProgression, Config, FileName, Node as IoxNode, NodeState, Path as IoxPath, SemanticString, ipc,
};
use std::fmt;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;
use thiserror::Error;

/// Why a text is not the name of a domain.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DomainError {
    /// It is too short or too long.
    #[error("domain name `{name}` has {got} characters: expected 1 to {max}", max = Domain::MAX_NAME)]
    Length {
        /// The text.
        name: String,
        /// Its length, characters.
        got: usize,
    },
    /// It has a character that names of domains do not have.
    #[error("domain name `{name}` has {found:?} at character {at}: expected only a-z, 0-9, _ and -")]
    Character {
        /// The text.
        name: String,
        /// The first such character.
        found: char,
        /// Position of that character, counted from 1.
        at: usize,
    },
}

/// The name of a separate world of shared memory: all processes of one system use the same domain, and systems in
/// different domains run side by side.
///
/// Its files are the directory `/dev/shm/upswing.<name>.iox/` and the shared memory `/dev/shm/upswing_<name>_*`.
#[derive(Clone, PartialEq, Eq)]
pub struct Domain {
    name: String,
    layout: Layout,
    config: Config,
}

// What makes the owner of a shared-memory file unambiguous: see `Layout::memory`.
const _: () = assert!(Domain::MAX_NAME < TYPE_HASH_DIGITS);

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
    /// Shared memory of a system of three processes and the largest number of clients, bytes; compare with
    /// [`Domain::free_memory`].
    pub const MEMORY: u64 = reservation::SYSTEM;

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
        let layout = Layout::new(name);
        // Not `Config::global_config()`: that one looks for files in the working directory.
        let mut config = Config::default();
        // The two conversions cannot fail: the name is short and plain.
        let unreachable = |_| DomainError::Length { name: name.to_owned(), got };
        let root = IoxPath::new(layout.root.as_os_str().as_bytes()).map_err(unreachable)?;
        config.global.set_root_path(&root);
        config.global.prefix = FileName::new(layout.prefix.as_bytes()).map_err(unreachable)?;
        // This crate cleans up itself, under the creation lock.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(Self { name: name.to_owned(), layout, config })
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The directory of the domain.
    pub fn root(&self) -> PathBuf {
        self.layout.root.clone()
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The configuration that every call to iceoryx2 gets.
    pub(crate) fn config(&self) -> &Config {
        &self.config
    }

    /// Bytes that are free in the file system of shared memory, `/dev/shm`.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn free_memory() -> std::io::Result<u64> {
        reservation::free_memory()
    }

    /// Whether the directory of the domain exists: processes have joined it and not yet left, or died in it.
    pub fn exists(&self) -> bool {
        self.root().symlink_metadata().is_ok()
    }

    /// Names of all other domains in which a process runs, in alphabetical order. Domains of other users are left out.
    pub fn others(&self) -> Vec<String> {
        let mut others: Vec<String> = Layout::names()
            .filter(|name| *name != self.name)
            .filter(|name| Self::new(name).is_ok_and(|domain| domain.has_live_nodes().unwrap_or(false)))
            .collect();
        others.sort();
        others
    }

    /// Number of processes of the domain that died and whose files nobody has removed yet. Changes nothing.
    ///
    /// # Errors
    /// [`IpcError::List`] if the nodes of the domain cannot be listed.
    pub fn count_dead(&self) -> Result<usize, IpcError> {
        // Without the directory there are no nodes, and iceoryx2 would create it.
        if !self.exists() {
            return Ok(0);
        }
        let mut dead = 0;
        self.for_each_node(|node| dead += usize::from(matches!(node, NodeState::Dead(_))))?;
        Ok(dead)
    }

    /// Whether processes live in the domain, also programs in other languages that do not lock its directory.
    pub(crate) fn has_live_nodes(&self) -> Result<bool, IpcError> {
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
}
