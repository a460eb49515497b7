//! Nodes: what a process holds of a domain that it has joined.

use crate::domain::Domain;
use crate::error::{Cause, IpcError};
use crate::iox::{CreationLock, leftovers, open_regular_file, process_defaults, reservation};
use crate::membership::Membership;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::prelude::{
    CallbackProgression, Node as IoxNode, NodeBuilder, NodeName, NodeState, SignalHandlingMode, ipc,
};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// Largest number of nodes (in practice: processes) that have one service open at a time.
pub const MAX_NODES: usize = 24;
/// Number of attempts to open what other processes may be creating or removing at the same moment.
const ATTEMPTS: usize = 10;
/// Pause between two attempts; a clean-up takes a few milliseconds.
const PAUSE: Duration = Duration::from_millis(10);
/// How long a clean-up waits for another thread, or a program in another language, that cleans up after the same process.
const CLEANUP_PATIENCE: Duration = Duration::from_millis(200);

/// Membership of this process in a domain; creates the ports of services.
///
/// Clones are the same node. The process leaves the domain when the last clone and the last port that came from it are
/// dropped. A node may move to another thread; ports stay in the thread that created them. None of its methods are for the
/// real-time thread.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
}

struct Inner {
    // Order of drop: the node goes before the membership, whose end may remove the domain.
    iox: IoxNode<ipc::Service>,
    _membership: Membership,
    domain: Domain,
}

impl fmt::Debug for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Node").field("domain", &self.inner.domain).field("role", self.iox().name()).finish()
    }
}

impl Domain {
    /// Joins the domain as `role` ("daemon", "planner", ...; for people and logs) and cleans up after processes of the
    /// domain that died. The last process that leaves in good order removes all files of the domain.
    ///
    /// Installs no signal handlers and reads no configuration file but the one that it writes into the domain's own
    /// directory.
    ///
    /// # Errors
    /// [`IpcError::Root`] or [`IpcError::Foreign`] if the directory cannot be used, [`IpcError::Join`] if the node cannot
    /// be created, [`IpcError::Full`] if there is no room for it, [`IpcError::Limit`] if a limit of the operating system on
    /// this process is too low.
    pub fn join(&self, role: &str) -> Result<Node, IpcError> {
        Self::check_limits()?;
        reservation::reserving(self.layout(), || Node::create(self, role))
    }
}

impl Node {
    fn create(domain: &Domain, role: &str) -> Result<Self, IpcError> {
        let membership = Membership::begin(domain)?;
        let failed =
            |cause: Cause| IpcError::Join { domain: domain.name().to_owned(), role: role.to_owned(), cause };
        let name = NodeName::new(role).map_err(|e| failed(e.into()))?;
        let path = domain.layout().creation_lock();
        open_regular_file(&path).map_err(|cause| IpcError::Root { action: "use", path, cause })?;
        let lock = CreationLock::acquire(domain.layout());
        process_defaults::set(domain.layout())?;
        let iox = NodeBuilder::new()
            .name(&name)
            .config(domain.config())
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| failed(e.into()))?;
        let inner = Inner { iox, _membership: membership, domain: domain.clone() };
        let node = Self { inner: Arc::new(inner) };
        if let Some(lock) = &lock {
            node.clean_up_under(lock);
        }
        Ok(node)
    }

    pub(crate) fn iox(&self) -> &IoxNode<ipc::Service> {
        &self.inner.iox
    }

    /// The domain that this node joined.
    pub fn domain(&self) -> &Domain {
        &self.inner.domain
    }

    /// Removes the files of processes of the domain that died; iceoryx2 does not do so in the background. Takes about 0.1 ms
    /// if none died, milliseconds otherwise. Does nothing if the creation lock cannot be acquired.
    pub fn clean_up(&self) {
        if let Some(lock) = CreationLock::acquire(self.domain().layout()) {
            self.clean_up_under(&lock);
        }
    }

    /// As [`Node::clean_up`], for callers that hold the creation lock.
    pub(crate) fn clean_up_under(&self, _lock: &CreationLock) {
        let mut dead = Vec::new();
        // Nodes that cannot be listed now are left to the next clean-up.
        let _ = self.domain().for_each_node(|node| {
            if let NodeState::Dead(node) = node {
                dead.push(node);
            }
        });
        if !dead.is_empty() {
            // After the list: dead processes make no more connections.
            leftovers::fill_empty_connections(self.domain().layout());
        }
        for node in dead {
            // A node that another process is cleaning up is left to that process.
            let _ = node.blocking_remove_stale_resources(CLEANUP_PATIENCE);
        }
    }

    /// Runs `create` and reserves the shared memory that it created.
    ///
    /// # Errors
    /// [`IpcError::Full`] if there is no room; those of `create`.
    pub(crate) fn reserving<T>(&self, create: impl FnOnce() -> Result<T, IpcError>) -> Result<T, IpcError> {
        reservation::reserving(self.domain().layout(), create)
    }

    /// Repeats `attempt` until it succeeds, under the creation lock and with a clean-up in between: another process may be
    /// dropping at that moment what this one opens, and a dead process keeps its port until somebody cleans up. Returns the
    /// last error after [`ATTEMPTS`] attempts.
    pub(crate) fn retry<T, E>(&self, mut attempt: impl FnMut() -> Result<T, E>) -> Result<T, E> {
        for _ in 1..ATTEMPTS {
            let lock = CreationLock::acquire(self.domain().layout());
            if let Ok(done) = attempt() {
                return Ok(done);
            }
            if let Some(lock) = &lock {
                self.clean_up_under(lock);
            }
            if let Ok(done) = attempt() {
                return Ok(done);
            }
            drop(lock);
            std::thread::sleep(PAUSE);
        }
        let _lock = CreationLock::acquire(self.domain().layout());
        attempt()
    }
}

/// Appends the id of the process that a node belongs to.
pub(crate) fn push_pid(pids: &mut Vec<u32>, node: &UniqueNodeId) -> CallbackProgression {
    pids.extend(node.pid::<ipc::Service>().ok().and_then(|pid| u32::try_from(pid.value()).ok()));
    CallbackProgression::Continue
}
