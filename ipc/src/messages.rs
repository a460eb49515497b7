//! Samples from one publisher to several subscribers. Nothing here is for the real-time thread: when a peer joins
//! or leaves, sending and receiving open files and map memory.

use crate::error::{Cause, IpcError};
use crate::node::{Node, note_pid};
use crate::services::{MAX_BORROWED, MAX_NODES, MAX_SUBSCRIBERS, Topic};
use iceoryx2::port::DegradationAction;
use iceoryx2::port::publisher::{Publisher as IoxPublisher, PublisherCreateError};
use iceoryx2::port::subscriber::{Subscriber as IoxSubscriber, SubscriberCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{BackpressureStrategy, PortFactory as _, ServiceName, ipc};
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use std::ops::Deref;

/// The only publisher of a topic; stays in the thread that created it.
pub struct Publisher<T: Topic> {
    port: IoxPublisher<ipc::Service, T, ()>,
    _service: PortFactory<ipc::Service, T, ()>,
    _node: Node,
}

impl<T: Topic> Publisher<T> {
    /// Becomes the publisher of the topic.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if another live process is, [`IpcError::Open`] or [`IpcError::Port`] if the service
    /// cannot be used.
    pub(crate) fn create(node: &Node) -> Result<Self, IpcError> {
        let service = open::<T>(node)?;
        let create = || {
            service
                .publisher_builder()
                .max_loaned_samples(1)
                // A slow subscriber loses its oldest samples; it never stops the publisher.
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.persist(create).map_err(|e| match e {
            PublisherCreateError::ExceedsMaxSupportedPublishers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_publishers(|p| note_pid(&mut holders, &p.node_id));
                IpcError::Taken { service: T::SERVICE.to_owned(), port: "publisher", max: 1, holders }
            }
            e => IpcError::Port { service: T::SERVICE.to_owned(), port: "publisher", cause: e.into() },
        })?;
        Ok(Self { port, _service: service, _node: node.clone() })
    }

    /// Sends a copy of `value`, written directly into shared memory, to all subscribers.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish(&self, value: &T) -> Result<(), IpcError> {
        value.publish(self)
    }

    /// As [`Self::publish`], to be compiled once for each payload: see `services`.
    pub(crate) fn send(&self, value: &T) -> Result<(), IpcError> {
        let mut sample = self.port.loan_uninit().map_err(|e| send_error::<T>(e.into()))?;
        // SAFETY: the sample is memory for one `T` that nobody else uses yet; `T` is `Copy`.
        let sample = unsafe {
            std::ptr::copy_nonoverlapping(value, sample.payload_mut().as_mut_ptr(), 1);
            sample.assume_init()
        };
        sample.send().map(drop).map_err(|e| send_error::<T>(e.into()))
    }

    /// Hands the history to subscribers that came after the last [`Publisher::publish`]. iceoryx2 does so only
    /// inside a call of the publisher: one that publishes rarely should call this every now and then.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn greet(&self) -> Result<(), IpcError> {
        T::greet(self)
    }

    /// As [`Self::greet`], to be compiled once for each payload: see `services`.
    pub(crate) fn update(&self) -> Result<(), IpcError> {
        self.port.update_connections().map_err(|e| send_error::<T>(e.into()))
    }
}

/// One of the subscribers of a topic; stays in the thread that created it.
pub struct Subscriber<T: Topic> {
    port: IoxSubscriber<ipc::Service, T, ()>,
    _service: PortFactory<ipc::Service, T, ()>,
    _node: Node,
}

impl<T: Topic> Subscriber<T> {
    /// Becomes a subscriber of the topic, whether or not there is a publisher.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if there are too many, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot
    /// be used.
    pub(crate) fn create(node: &Node) -> Result<Self, IpcError> {
        let service = open::<T>(node)?;
        let create = || {
            service
                .subscriber_builder()
                .buffer_size(T::BUFFER)
                .set_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.persist(create).map_err(|e| match e {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_subscribers(|s| note_pid(&mut holders, &s.node_id));
                IpcError::Taken {
                    service: T::SERVICE.to_owned(),
                    port: "subscriber",
                    max: MAX_SUBSCRIBERS,
                    holders,
                }
            }
            e => IpcError::Port { service: T::SERVICE.to_owned(), port: "subscriber", cause: e.into() },
        })?;
        Ok(Self { port, _service: service, _node: node.clone() })
    }

    /// The oldest sample not yet received, in shared memory. Hold at most two at a time; a sample outlives its
    /// publisher. The publisher's process can still write into it: copy it before it is checked.
    ///
    /// # Errors
    /// [`IpcError::Receive`], also if too many samples are held.
    pub fn receive(&self) -> Result<Option<Received<T>>, IpcError> {
        T::receive(self)
    }

    /// As [`Self::receive`], to be compiled once for each payload: see `services`.
    pub(crate) fn take(&self) -> Result<Option<Received<T>>, IpcError> {
        let sample = self.port.receive();
        let sample = sample.map_err(|e| IpcError::Receive { service: T::SERVICE, cause: e.into() })?;
        Ok(sample.map(Received))
    }
}

/// A received sample; its place in shared memory is free again when it is dropped.
pub struct Received<T: Topic>(Sample<ipc::Service, T, ()>);

impl<T: Topic> Deref for Received<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.payload()
    }
}

fn open<T: Topic>(node: &Node) -> Result<PortFactory<ipc::Service, T, ()>, IpcError> {
    let failed = |cause| IpcError::Open { service: T::SERVICE.to_owned(), cause };
    let name = ServiceName::new(T::SERVICE).map_err(|e| failed(e.into()))?;
    let open = || {
        node.iox()
            .service_builder(&name)
            .publish_subscribe::<T>()
            .max_publishers(1)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(T::BUFFER)
            .subscriber_max_borrowed_samples(MAX_BORROWED)
            .history_size(T::HISTORY)
            .enable_safe_overflow(true)
            .open_or_create()
    };
    node.persist(open).map_err(|e| failed(e.into()))
}

fn send_error<T: Topic>(cause: Cause) -> IpcError {
    IpcError::Send { service: T::SERVICE, cause }
}
