//! The latest value of one writer, wait-free for the writer and without heap or kernel for the reader.
//!
//! A writer that is killed leaves its blackboard locked for good as long as somebody has it open. Therefore every
//! start of a writer creates a blackboard of its own, `<channel>/<epoch>`, and readers look for the newest.
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

    /// Start of the writer, CLOCK_MONOTONIC, ns; a larger one than before means that the writer restarted.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }
}

/// Finds the newest writer of a channel; stays in the thread that created it.
pub struct Finder<T: Latest> {
    /// Opened blackboards, oldest first. All but the last wait for their readers to be dropped.
    open: Vec<Opened<T>>,
    node: Node,
}

struct Opened<T: Latest> {
    // Order of drop: port and service before the shared entry.
    _port: IoxReader<ipc::Service, u64>,
    _service: PortFactory<ipc::Service, u64>,
    handle: Arc<EntryHandle<ipc::Service, u64, T>>,
    epoch: u64,
}

impl<T: Latest> Finder<T> {
    /// A finder that has found nothing yet.
    pub(crate) fn new(node: &Node) -> Self {
        Self { open: Vec::new(), node: node.clone() }
    }

    /// Looks for a writer that started after the one found last; if there is one, hands out a reader of it.
    ///
    /// Also cleans up after dead processes, and closes blackboards of earlier writers whose readers were dropped.
    /// Some 0.5 ms: call it every 20 to 100 ms.
    ///
    /// # Errors
    /// [`IpcError::List`] if the services cannot be listed, [`IpcError::Open`] or [`IpcError::Port`] if the newest
    /// cannot be opened, [`IpcError::Layout`] if it carries another payload than `T`.
    pub fn poll(&mut self) -> Result<Option<Reader<T>>, IpcError> {
        T::poll(self)
    }

    /// As [`Self::poll`], to be compiled once for each payload: see `services`.
    pub(crate) fn look(&mut self) -> Result<Option<Reader<T>>, IpcError> {
        let site = Site::enter(self.node.domain());
        self.node.clean_up_at(&site);
        self.close_unused();
        let current = self.epoch();
        let mut epochs: Vec<u64> =
            self.list()?.into_iter().filter(|&e| current.is_none_or(|c| e > c)).collect();
        epochs.sort_unstable();
        for epoch in epochs.into_iter().rev() {
            if let Some(opened) = self.open(epoch)? {
                let reader = Reader { handle: Arc::clone(&opened.handle), epoch };
                self.open.push(opened);
                return Ok(Some(reader));
            }
        }
        Ok(None)
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
        let service_name = ServiceName::new(&name).map_err(|e| failed(e.into()))?;
        let opened = self.node.iox().service_builder(&service_name).blackboard_opener::<u64>().open();
        let service = match opened {
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
        Ok(Some(Opened { _port: port, _service: service, handle: Arc::new(entry), epoch }))
    }

    /// Closes all blackboards but the newest whose readers were dropped.
    fn close_unused(&mut self) {
        let newest = self.epoch();
        // `get_mut`, not `strong_count`: it also synchronizes with the thread that dropped the reader.
        self.open.retain_mut(|o| Some(o.epoch) == newest || Arc::get_mut(&mut o.handle).is_none());
    }
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
