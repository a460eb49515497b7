//! Blackboards: the latest value of one writer, wait-free for the writer, without heap or system calls for the reader.
//!
//! A writer that is killed leaves its blackboard locked for good as long as another process has it open. Therefore every
//! start of a writer creates a blackboard of its own, `<channel>/<epoch>`, and readers look for the newest one whose writer
//! lives.
//!
//! # Ownership
//! Service and port objects stay in the non-real-time thread: in [`WriterPorts`] and [`Finder`]. The objects that may move
//! to the real-time thread ([`WriterEntry`], [`Reader`]) share the entry with them. While the ports live, dropping an entry
//! only decrements a count; the memory is unmapped by the thread that owns the ports. So keep the ports longer than the
//! entries. The other order is sound, but then the thread that drops the entry unmaps the memory.

use crate::error::IpcError;
use crate::iox::{CreationLock, leftovers};
use crate::node::{MAX_NODES, Node};
use crate::time::monotonic_ns;
use iceoryx2::port::reader::{EntryHandle, Reader as IoxReader};
use iceoryx2::port::writer::{EntryHandleMut, Writer as IoxWriter};
use iceoryx2::prelude::{CallbackProgression, Service as _, ServiceName, ZeroCopySend, ipc};
use iceoryx2::service::builder::blackboard::BlackboardOpenError;
use iceoryx2::service::port_factory::blackboard::PortFactory;
use std::cell::Cell;
use std::fmt::Debug;
use std::marker::PhantomData;
use std::sync::Arc;

/// Largest number of readers of one blackboard.
pub const MAX_READERS: usize = 8;

/// A payload of which only the latest value counts: written every cycle, read every cycle.
pub trait BlackboardPayload: ZeroCopySend + Copy + Debug + Default + Send + 'static {
    /// Name of the channel; each start of a writer has its own service `<channel>/<epoch>`.
    const CHANNEL: &'static str;

    #[doc(hidden)]
    fn writer(node: &Node) -> Result<Writer<Self>, IpcError>;
    #[doc(hidden)]
    fn poll(
        finder: &mut Finder<Self>,
        keep_waiting: &dyn Fn() -> bool,
    ) -> Result<Option<Reader<Self>>, IpcError>;
}

impl Node {
    /// Creates the writer of a channel, with a new blackboard that holds `T::default()` until the first write.
    ///
    /// # Errors
    /// [`IpcError::Open`] or [`IpcError::Port`] if the blackboard cannot be created, [`IpcError::Full`] if there is no room.
    pub fn writer<T: BlackboardPayload>(&self) -> Result<Writer<T>, IpcError> {
        T::writer(self)
    }

    /// Creates a finder of the newest writer of a channel. Threads that must not wait for other processes use a
    /// [`crate::FinderThread`].
    pub fn finder<T: BlackboardPayload>(&self) -> Finder<T> {
        Finder { open: Vec::new(), node: self.clone() }
    }
}

/// The only key of every blackboard.
const KEY: u64 = 0;

/// Digits of an epoch in the name of a service: every u64 fits, so names sort like numbers.
const EPOCH_DIGITS: usize = 20;

/// The writer of a channel; stays in the thread that created it.
pub struct Writer<T: BlackboardPayload> {
    entry: WriterEntry<T>,
    ports: WriterPorts<T>,
}

/// Writes the values of a channel; may move to the real-time thread.
pub struct WriterEntry<T: BlackboardPayload> {
    handle: Arc<EntryHandleMut<ipc::Service, u64, T>>,
    /// Not `Sync`: writes of two threads must not overlap.
    _not_sync: PhantomData<Cell<()>>,
}

/// Keeps the blackboard of a [`WriterEntry`] open; stays in the thread that created it and outlives the entry.
pub struct WriterPorts<T: BlackboardPayload> {
    // Order of drop: ports before the shared entry, the node last.
    _port: IoxWriter<ipc::Service, u64>,
    _service: PortFactory<ipc::Service, u64>,
    _handle: Arc<EntryHandleMut<ipc::Service, u64, T>>,
    epoch: u64,
    _node: Node,
}

/// As [`Node::writer`]; compiled once for each payload, see `services`.
pub(super) fn writer<T: BlackboardPayload>(node: &Node) -> Result<Writer<T>, IpcError> {
    node.reserving(|| node.retry(|| create_writer(node)))
}

fn create_writer<T: BlackboardPayload>(node: &Node) -> Result<Writer<T>, IpcError> {
    // A new epoch at each attempt: the files of a failed attempt must not be in the way.
    let epoch = monotonic_ns();
    let name = service_name::<T>(epoch);
    let unopened = |cause| IpcError::Open { service: name.clone(), cause };
    let failed = |cause| IpcError::Port { service: name.clone(), port: "writer", cause };
    let service = node
        .iox()
        .service_builder(&ServiceName::new(&name).map_err(|e| unopened(e.into()))?)
        .blackboard_creator::<u64>()
        .max_readers(MAX_READERS)
        .max_nodes(MAX_NODES)
        .add::<T>(KEY, T::default())
        .create()
        .map_err(|e| unopened(e.into()))?;
    let port = service.writer_builder().create().map_err(|e| failed(e.into()))?;
    let handle = Arc::new(port.entry::<T>(&KEY).map_err(|e| failed(e.into()))?);
    // Without the creation lock another process may have removed it while it was unfinished: then nobody else could open
    // it, and this process would write for nobody.
    open_service(node, &name).map_err(|e| unopened(e.into()))?;
    Ok(Writer {
        entry: WriterEntry { handle: Arc::clone(&handle), _not_sync: PhantomData },
        ports: WriterPorts { _port: port, _service: service, _handle: handle, epoch, _node: node.clone() },
    })
}

impl<T: BlackboardPayload> Writer<T> {
    /// Start of this writer, CLOCK_MONOTONIC, ns; its predecessors have smaller ones.
    pub fn epoch(&self) -> u64 {
        self.ports.epoch
    }

    /// Replaces the value, as [`WriterEntry::write`]; for processes without a real-time thread.
    pub fn write(&self, value: T) {
        self.entry.write(value);
    }

    /// Separates the entry, which may move to the real-time thread, from the ports, which stay in this thread and must live
    /// longer.
    pub fn split(self) -> (WriterEntry<T>, WriterPorts<T>) {
        (self.entry, self.ports)
    }
}

impl<T: BlackboardPayload> WriterEntry<T> {
    /// Replaces the value. Wait-free, no heap, no system call; readers see either the whole new value or the old one.
    pub fn write(&self, value: T) {
        self.handle.update_with_copy(value);
    }
}

/// Reads the latest value of one start of a writer; may move to the real-time thread.
pub struct Reader<T: BlackboardPayload> {
    handle: Arc<EntryHandle<ipc::Service, u64, T>>,
    epoch: u64,
}

impl<T: BlackboardPayload> Reader<T> {
    /// The latest value; `T::default()` if nothing was written yet. No heap, no system call. Never waits for
    /// the writer; copies again if a write ends during the copy, which is rare: a copy takes about 20 ns.
    pub fn read(&self) -> T {
        *self.handle.get()
    }

    /// Start of the writer, CLOCK_MONOTONIC, ns; a new value means a new writer.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }
}

/// Finds the newest living writer of a channel; stays in the thread that created it.
pub struct Finder<T: BlackboardPayload> {
    /// Opened blackboards, in the order in which they were found. All but the last are kept until their readers are dropped.
    open: Vec<Opened<T>>,
    node: Node,
}

struct Opened<T: BlackboardPayload> {
    // Order of drop: port and service before the shared entry.
    _port: IoxReader<ipc::Service, u64>,
    service: PortFactory<ipc::Service, u64>,
    handle: Arc<EntryHandle<ipc::Service, u64, T>>,
    epoch: u64,
}

impl<T: BlackboardPayload> Finder<T> {
    /// Looks for the newest living writer; returns a reader of it, or `None` if it is the one found last or there is none.
    ///
    /// Also cleans up after dead processes, and closes blackboards of earlier writers whose readers were dropped.
    /// Takes about 0.5 ms: call it every 20 to 100 ms. Waits for the creation lock of the domain; without it, finds a writer
    /// only if no process is creating. An epoch in the future belongs to no start of a writer and is ignored.
    ///
    /// # Errors
    /// [`IpcError::List`] if the services cannot be listed. If no other writer is found: [`IpcError::Open`] or
    /// [`IpcError::Port`] if one that is newer than the last cannot be opened, [`IpcError::Layout`] if it carries another
    /// payload than `T`.
    pub fn poll(&mut self) -> Result<Option<Reader<T>>, IpcError> {
        self.poll_while(&|| true)
    }

    /// As [`Self::poll`], but waits for the creation lock only as long as `keep_waiting` returns true.
    pub(super) fn poll_while(
        &mut self,
        keep_waiting: &dyn Fn() -> bool,
    ) -> Result<Option<Reader<T>>, IpcError> {
        T::poll(self, keep_waiting)
    }

    /// Whether the writer found last was alive at the last [`Self::poll`], which cleans up after dead writers.
    pub fn writer_is_alive(&self) -> bool {
        self.open.last().is_some_and(|o| has_writer(&o.service))
    }

    /// Start of the writer found last, CLOCK_MONOTONIC, ns.
    pub fn epoch(&self) -> Option<u64> {
        self.open.last().map(|o| o.epoch)
    }

    /// The epochs of all blackboards of the channel.
    fn list(&self) -> Result<Vec<u64>, IpcError> {
        let mut epochs = Vec::new();
        let domain = self.node.domain();
        ipc::Service::list(domain.config(), |service| {
            epochs.extend(epoch_of::<T>(service.static_details.name().as_str()));
            CallbackProgression::Continue
        })
        .map_err(|e| IpcError::List {
            what: "services",
            domain: domain.name().to_owned(),
            cause: e.into(),
        })?;
        Ok(epochs)
    }

    /// Opens the blackboard of one epoch; `None` if it is unfinished, being removed, or without a writer.
    fn open(&self, epoch: u64) -> Result<Option<Opened<T>>, IpcError> {
        let name = service_name::<T>(epoch);
        let failed = |cause| IpcError::Open { service: name.clone(), cause };
        let service = match open_service(&self.node, &name) {
            Ok(service) => service,
            Err(
                BlackboardOpenError::DoesNotExist
                | BlackboardOpenError::IsMarkedForDestruction
                | BlackboardOpenError::HangsInCreation
                | BlackboardOpenError::ServiceInCorruptedState,
            ) => return Ok(None),
            Err(e) => return Err(failed(e.into())),
        };
        if !has_writer(&service) {
            return Ok(None);
        }
        let port = service.reader_builder().create().map_err(|e| IpcError::Port {
            service: name.clone(),
            port: "reader",
            cause: e.into(),
        })?;
        let entry = port.entry::<T>(&KEY);
        let entry =
            entry.map_err(|_| IpcError::Layout { service: name, expected: std::any::type_name::<T>() })?;
        Ok(Some(Opened { _port: port, service, handle: Arc::new(entry), epoch }))
    }

    /// Closes the blackboards whose readers were dropped, except the one found last.
    fn close_unused(&mut self) {
        let newest = self.epoch();
        // `get_mut`, not `strong_count`: it also synchronizes with the thread that dropped the reader.
        self.open.retain_mut(|o| Some(o.epoch) == newest || Arc::get_mut(&mut o.handle).is_none());
    }
}

/// As [`Finder::poll_while`]; compiled once for each payload, see `services`.
pub(super) fn poll<T: BlackboardPayload>(
    finder: &mut Finder<T>,
    keep_waiting: &dyn Fn() -> bool,
) -> Result<Option<Reader<T>>, IpcError> {
    let layout = finder.node.domain().layout();
    let lock = CreationLock::acquire_while(layout, keep_waiting);
    match &lock {
        Some(lock) => finder.node.clean_up_under(lock),
        // iceoryx2 might wait without end for what is unfinished.
        None if !leftovers::are_none(layout) => return Ok(None),
        None => {}
    }
    finder.close_unused();
    let current = finder.open.last().filter(|o| has_writer(&o.service)).map(|o| o.epoch);
    let now = monotonic_ns();
    let newer = |&e: &u64| e <= now && Some(e) != finder.epoch() && current.is_none_or(|c| e > c);
    let mut epochs: Vec<u64> = finder.list()?.into_iter().filter(newer).collect();
    epochs.sort_unstable();
    // One that cannot be opened does not hide the others.
    let mut failure = None;
    for epoch in epochs.into_iter().rev() {
        match finder.open(epoch) {
            Ok(Some(opened)) => {
                let reader = Reader { handle: Arc::clone(&opened.handle), epoch };
                finder.open.push(opened);
                return Ok(Some(reader));
            }
            Ok(None) => {}
            Err(e) => failure = failure.or(Some(e)),
        }
    }
    failure.map_or(Ok(None), Err)
}

fn open_service(node: &Node, name: &str) -> Result<PortFactory<ipc::Service, u64>, BlackboardOpenError> {
    // A channel and a number: short and plain.
    let name = ServiceName::new(name).map_err(|_| BlackboardOpenError::DoesNotExist)?;
    node.iox().service_builder(&name).blackboard_opener::<u64>().open()
}

fn has_writer(service: &PortFactory<ipc::Service, u64>) -> bool {
    use iceoryx2::prelude::PortFactory as _;
    service.dynamic_config().number_of_writers() > 0
}

fn service_name<T: BlackboardPayload>(epoch: u64) -> String {
    format!("{}/{epoch:0width$}", T::CHANNEL, width = EPOCH_DIGITS)
}

fn epoch_of<T: BlackboardPayload>(service: &str) -> Option<u64> {
    let digits = service.strip_prefix(T::CHANNEL)?.strip_prefix('/')?;
    if digits.len() == EPOCH_DIGITS && digits.bytes().all(|b| b.is_ascii_digit()) {
        digits.parse().ok()
    } else {
        None
    }
}
