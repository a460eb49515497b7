//! A process' seat in a domain, and the ends of services that it can ask for.

use crate::blackboard::{Finder, Writer};
use crate::construction::{Site, fill_empty_connections};
use crate::domain::{Domain, Presence};
use crate::error::IpcError;
use crate::messages::{Publisher, Subscriber};
use crate::request::{Client, Server};
use crate::services::{Latest, Request, Topic};
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::prelude::{CallbackProgression, Node as IoxNode, NodeState, ipc};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// Attempts at what other processes may be creating or cleaning up at the same moment.
const ATTEMPTS: usize = 10;
/// Pause between attempts; a clean-up takes a few milliseconds.
const PAUSE: Duration = Duration::from_millis(10);
/// How long to wait for another thread or another language that is cleaning up after the same dead process.
const CLEANUP_PATIENCE: Duration = Duration::from_millis(200);

/// A process' seat in a domain. Clones are the same seat; it is vacated when the last clone and the last end of a
/// service that came from it are dropped.
///
/// A node may move to another thread; the ends of services stay in the thread that created them. None of its
/// methods are for the real-time thread.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
}

struct Inner {
    // Order of drop: the node goes before the look at who is left.
    iox: IoxNode<ipc::Service>,
    _presence: Presence,
    domain: Domain,
}

impl fmt::Debug for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Node").field("domain", &self.inner.domain).field("role", self.iox().name()).finish()
    }
}

impl Node {
    pub(crate) fn new(iox: IoxNode<ipc::Service>, domain: Domain, presence: Presence) -> Self {
        Self { inner: Arc::new(Inner { iox, _presence: presence, domain }) }
    }

    pub(crate) fn iox(&self) -> &IoxNode<ipc::Service> {
        &self.inner.iox
    }

    /// The domain that this node joined.
    pub fn domain(&self) -> &Domain {
        &self.inner.domain
    }

    /// Removes what dead processes of the domain left behind; nobody does it in the background. Some 0.1 ms when
    /// nobody died, milliseconds otherwise.
    pub fn clean_up(&self) {
        self.clean_up_at(&Site::enter(self.domain()));
    }

    /// As [`Node::clean_up`], for those who are on site already; does nothing beside somebody else's work.
    pub(crate) fn clean_up_at(&self, site: &Site) {
        if !site.is_own() {
            return;
        }
        let mut dead = Vec::new();
        // What cannot be listed, or is being cleaned up by somebody else, is left to the next time.
        let _ = self.domain().for_each_node(|node| {
            if let NodeState::Dead(node) = node {
                dead.push(node);
            }
        });
        if !dead.is_empty() {
            // After they died: they make no more connections.
            fill_empty_connections(self.domain());
        }
        for node in dead {
            let _ = node.blocking_remove_stale_resources(CLEANUP_PATIENCE);
        }
    }

    /// The end of a channel that writes the latest value: a new blackboard at each start.
    ///
    /// # Errors
    /// [`IpcError::Taken`] where there is no more place, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot be
    /// used, [`IpcError::Full`] if there is no room; those of the other ends are the same.
    pub fn writer<T: Latest>(&self) -> Result<Writer<T>, IpcError> {
        T::writer(self)
    }

    /// Finds the newest blackboard of a channel, again whenever its writer has started anew. What must not wait for other
    /// processes looks through [`crate::Search`].
    pub fn finder<T: Latest>(&self) -> Finder<T> {
        Finder::new(self)
    }

    /// The end of a topic that publishes: one process at a time has it.
    ///
    /// # Errors
    /// As of [`Self::writer`].
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, IpcError> {
        T::publisher(self)
    }

    /// An end of a topic that receives.
    ///
    /// # Errors
    /// As of [`Self::writer`].
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, IpcError> {
        T::subscriber(self)
    }

    /// An end of a service that asks, whether or not there is a server.
    ///
    /// # Errors
    /// As of [`Self::writer`].
    pub fn client<R: Request>(&self) -> Result<Client<R>, IpcError> {
        R::client(self)
    }

    /// The end of a service that answers: one process at a time has it.
    ///
    /// # Errors
    /// As of [`Self::writer`].
    pub fn server<R: Request>(&self) -> Result<Server<R>, IpcError> {
        R::server(self)
    }

    /// Repeats `attempt`, on site and cleaning up after dead processes: what one process opens another may be
    /// dropping at the same moment, and the place of a dead process is taken until somebody cleans up.
    pub(crate) fn persist<T, E>(&self, mut attempt: impl FnMut() -> Result<T, E>) -> Result<T, E> {
        for _ in 1..ATTEMPTS {
            let site = Site::enter(self.domain());
            if let Ok(done) = attempt() {
                return Ok(done);
            }
            self.clean_up_at(&site);
            if let Ok(done) = attempt() {
                return Ok(done);
            }
            drop(site);
            std::thread::sleep(PAUSE);
        }
        let _site = Site::enter(self.domain());
        attempt()
    }
}

/// Adds the id of the process that a node belongs to.
pub(crate) fn note_pid(pids: &mut Vec<u32>, node: &UniqueNodeId) -> CallbackProgression {
    pids.extend(node.pid::<ipc::Service>().ok().and_then(|pid| u32::try_from(pid.value()).ok()));
    CallbackProgression::Continue
}
