//! The latest value of one writer, wait-free for the writer and without heap or kernel for the reader.
//!
//! A writer that is killed leaves its blackboard locked for good as long as somebody has it open. Therefore every
//! start of a writer creates a blackboard of its own, `<channel>/<epoch>`, and readers look for the newest whose writer
//! lives.
//!
//! # Who owns what
//! Service and port objects stay in the non-real-time thread: in [`WriterPorts`] and [`Finder`]. What may move to
//! the real-time thread ([`WriterEntry`], [`Reader`]) shares its entry with them. While they live, dropping an
//! entry only counts down; the memory is unmapped by the thread that owns the ports. So keep the ports longer than
//! the entries. The other way round is sound, but then the thread that drops the entry does the unmapping.

use crate::construction::Site;
use crate::error::IpcError;
use crate::node::Node;
use crate::services::{Latest, MAX_NODES, MAX_READERS};
use crate::time::monotonic_ns;
use iceoryx2::port::reader::{EntryHandle, Reader as IoxReader};
use iceoryx2::port::writer::{EntryHandleMut, Writer as IoxWriter};
use iceoryx2::prelude::{CallbackProgression, Service as _, ServiceName, ipc};
use iceoryx2::service::builder::blackboard::BlackboardOpenError;
use iceoryx2::service::port_factory::blackboard::PortFactory;
use std::cell::Cell;
use std::marker::PhantomData;
use std::sync::Arc;

/// The only key of every blackboard.
const KEY: u64 = 0;

/// Digits of an epoch in a service name: every u64 fits, so names sort like numbers.
const EPOCH_DIGITS: usize = 20;

/// The writing end of a channel.
pub struct Writer<T: Latest> {
    entry: WriterEntry<T>,
    ports: WriterPorts<T>,
}

/// Writes values; may move to the real-time thread.
pub struct WriterEntry<T: Latest> {
    handle: Arc<EntryHandleMut<ipc::Service, u64, T>>,
    /// One thread at a time: writes must not overlap.
    _not_sync: PhantomData<Cell<()>>,
}

/// Keeps a blackboard open; stays in the thread that created it. See the ownership rule in the module's text.
pub struct WriterPorts<T: Latest> {
    // Order of drop: ports before the shared entry, the node last.
    _port: IoxWriter<ipc::Service, u64>,
    _service: PortFactory<ipc::Service, u64>,
    _handle: Arc<EntryHandleMut<ipc::Service, u64, T>>,
    epoch: u64,
    _node: Node,
}

impl<T: Latest> Writer<T> {
    /// Creates a blackboard for this start of the writer. It holds `T::default()` until the first write.
    ///
    /// # Errors
    /// [`IpcError::Open`] or [`IpcError::Port`] if the blackboard cannot be created.
    pub(crate) fn create(node: &Node) -> Result<Self, IpcError> {
        node.persist(|| Self::attempt(node))
    }

    fn attempt(node: &Node) -> Result<Self, IpcError> {
        // A new epoch at each attempt: what a failed attempt left must not be in the way.
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
        // Without the lock somebody may have taken it for a ruin while it was unfinished: then nobody else could open it,
        // and this process would write for nobody.
        open_service(node, &name).map_err(|e| unopened(e.into()))?;
        Ok(Self {
            entry: WriterEntry { handle: Arc::clone(&handle), _not_sync: PhantomData },
            ports: WriterPorts {
                _port: port,
                _service: service,
                _handle: handle,
                epoch,
                _node: node.clone(),
            },
        })
    }

    /// Start of this writer, CLOCK_MONOTONIC, ns; what distinguishes it from its predecessors.
    pub fn epoch(&self) -> u64 {
        self.ports.epoch
    }

    /// As [`WriterEntry::write`], for writers without a real-time thread.
    pub fn write(&self, value: T) {
        self.entry.write(value);
    }

    /// Parts the end that may move to the real-time thread from what must stay here, and outlive it.
    pub fn split(self) -> (WriterEntry<T>, WriterPorts<T>) {
        (self.entry, self.ports)
    }
}

impl<T: Latest> WriterEntry<T> {
    /// Replaces the value. Wait-free, no heap, no system call; readers see all of it or nothing.
    pub fn write(&self, value: T) {
        self.handle.update_with_copy(value);
    }
}

/// Reads the latest value of one writer start; may move to the real-time thread.
pub struct Reader<T: Latest> {
    handle: Arc<EntryHandle<ipc::Service, u64, T>>,
    epoch: u64,
}

impl<T: Latest> Reader<T> {
    /// The latest value; `T::default()` if nothing was written yet. No heap, no system call, never waits for the
    /// writer; copies again if a write ends during the copy (two writes must end within some 20 ns for a third copy).
    pub fn read(&self) -> T {
        *self.handle.get()
    }

    /// Start of the writer, CLOCK_MONOTONIC, ns; another one than before means another writer.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }
}

/// Finds the newest living writer of a channel; stays in the thread that created it.
pub struct Finder<T: Latest> {
    /// Opened blackboards, in the order in which they were found. All but the last wait for their readers to be dropped.
    open: Vec<Opened<T>>,
    node: Node,
}

struct Opened<T: Latest> {
    // Order of drop: port and service before the shared entry.
    _port: IoxReader<ipc::Service, u64>,
    service: PortFactory<ipc::Service, u64>,
    handle: Arc<EntryHandle<ipc::Service, u64, T>>,
    epoch: u64,
}

impl<T: Latest> Finder<T> {
    /// A finder that has found nothing yet.
    pub(crate) fn new(node: &Node) -> Self {
        Self { open: Vec::new(), node: node.clone() }
    }

    /// Looks for the newest writer that lives; hands out a reader of it unless it is the one found last.
    ///
    /// Also cleans up after dead processes, and closes blackboards of earlier writers whose readers were dropped.
    /// Some 0.5 ms: call it every 20 to 100 ms. Waits for others who create or clean up in the domain, unless they are
    /// stopped: then it finds something only where nothing is under construction.
    ///
    /// An epoch that is still to come is nobody's start, and is not looked at.
    ///
    /// # Errors
    /// [`IpcError::List`] if the services cannot be listed. If no other writer is found: [`IpcError::Open`] or
    /// [`IpcError::Port`] if one that is newer than the last cannot be opened, [`IpcError::Layout`] if it carries another
    /// payload than `T`.
    pub fn poll(&mut self) -> Result<Option<Reader<T>>, IpcError> {
        self.poll_while(&|| true)
    }

    /// As [`Self::poll`], but waits for others only as long as `wanted` says so.
    pub(crate) fn poll_while(&mut self, wanted: &dyn Fn() -> bool) -> Result<Option<Reader<T>>, IpcError> {
        T::poll(self, wanted)
    }

    /// As [`Self::poll_while`], to be compiled once for each payload: see `services`.
    pub(crate) fn look(&mut self, wanted: &dyn Fn() -> bool) -> Result<Option<Reader<T>>, IpcError> {
        let site = Site::enter_while(self.node.domain(), wanted);
        if !site.is_clear() {
            return Ok(None);
        }
        self.node.clean_up_at(&site);
        self.close_unused();
        let current = self.open.last().filter(|o| has_writer(&o.service)).map(|o| o.epoch);
        let now = monotonic_ns();
        let newer = |&e: &u64| e <= now && Some(e) != self.epoch() && current.is_none_or(|c| e > c);
        let mut epochs: Vec<u64> = self.list()?.into_iter().filter(newer).collect();
        epochs.sort_unstable();
        // One that cannot be opened does not hide the others.
        let mut failure = None;
        for epoch in epochs.into_iter().rev() {
            match self.open(epoch) {
                Ok(Some(opened)) => {
                    let reader = Reader { handle: Arc::clone(&opened.handle), epoch };
                    self.open.push(opened);
                    return Ok(Some(reader));
                }
                Ok(None) => {}
                Err(e) => failure = failure.or(Some(e)),
            }
        }
        failure.map_or(Ok(None), Err)
    }

    /// Whether the writer found last lives, as far as the last look tells: the dead count until somebody cleans up.
    pub fn lives(&self) -> bool {
        self.open.last().is_some_and(|o| has_writer(&o.service))
    }

    /// Start of the writer found last, CLOCK_MONOTONIC, ns.
    pub fn epoch(&self) -> Option<u64> {
        self.open.last().map(|o| o.epoch)
    }

    /// The epochs of all services of this channel.
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

    /// Opens a blackboard; None if it is incomplete, vanishing or without a writer.
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

    /// Closes all blackboards but the one found last whose readers were dropped.
    fn close_unused(&mut self) {
        let newest = self.epoch();
        // `get_mut`, not `strong_count`: it also synchronizes with the thread that dropped the reader.
        self.open.retain_mut(|o| Some(o.epoch) == newest || Arc::get_mut(&mut o.handle).is_none());
    }
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

fn service_name<T: Latest>(epoch: u64) -> String {
    format!("{}/{epoch:0width$}", T::CHANNEL, width = EPOCH_DIGITS)
}

fn epoch_of<T: Latest>(service: &str) -> Option<u64> {
    let digits = service.strip_prefix(T::CHANNEL)?.strip_prefix('/')?;
    if digits.len() == EPOCH_DIGITS && digits.bytes().all(|b| b.is_ascii_digit()) {
        digits.parse().ok()
    } else {
        None
    }
}
