//! Topics: samples from one publisher to several subscribers. Not for the real-time thread: when a peer joins or leaves,
//! sending and receiving open files and map memory.

use crate::error::{Cause, IpcError};
use crate::node::{MAX_NODES, Node, push_pid};
use crate::payload::{DamagedPlan, PlanHeader, PlanMessage};
use iceoryx2::port::publisher::{Publisher as IoxPublisher, PublisherCreateError};
use iceoryx2::port::subscriber::{Subscriber as IoxSubscriber, SubscriberCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, ReceiveError};
use iceoryx2::prelude::{
    BackpressureStrategy, IceoryxSend, PortFactory as _, ServiceName, ZeroCopySend, ipc,
};
use iceoryx2::sample::Sample as IoxSample;
use iceoryx2::service::builder::publish_subscribe::{Builder, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::port_factory::publisher::PortFactoryPublisher;
use std::fmt::Debug;
use std::ops::Deref;
use upswing_model::Sizes;

/// Largest number of subscribers of one topic.
const MAX_SUBSCRIBERS: usize = 8;
/// Samples of one topic that a subscriber may hold at a time.
const MAX_HELD: usize = 2;

/// A message that one process publishes and several receive.
pub trait TopicPayload: Sized + Debug + 'static {
    /// Name of the service.
    const SERVICE: &'static str;
    /// Samples that wait for a slow subscriber before the oldest is replaced.
    const BUFFER: usize;
    /// Samples that a late subscriber still gets.
    const HISTORY: usize;
    /// What lies in shared memory: the message itself, or the slice in it that differs in length.
    #[doc(hidden)]
    type Shared: IceoryxSend + Debug + ?Sized;
    /// What lies before it; `()` if there is no slice.
    #[doc(hidden)]
    type Header: ZeroCopySend + Debug + Default;

    #[doc(hidden)]
    fn open_or_create(
        builder: ServiceBuilder<Self>,
    ) -> Result<Service<Self>, PublishSubscribeOpenOrCreateError>;
    #[doc(hidden)]
    fn publisher(node: &Node, longest: usize) -> Result<Publisher<Self>, IpcError>;
    #[doc(hidden)]
    fn subscriber(node: &Node) -> Result<Subscriber<Self>, IpcError>;
    #[doc(hidden)]
    fn publish(publisher: &Publisher<Self>, value: &Self) -> Result<(), IpcError>;
    #[doc(hidden)]
    fn deliver_history(publisher: &Publisher<Self>) -> Result<(), IpcError>;
    #[doc(hidden)]
    fn receive(subscriber: &Subscriber<Self>) -> Result<Option<Sample<Self>>, IpcError>;
}

pub(super) type Service<T> =
    PortFactory<ipc::Service, <T as TopicPayload>::Shared, <T as TopicPayload>::Header>;
pub(super) type PublisherBuilder<'a, T> =
    PortFactoryPublisher<'a, ipc::Service, <T as TopicPayload>::Shared, <T as TopicPayload>::Header>;
pub(super) type ServiceBuilder<T> =
    Builder<<T as TopicPayload>::Shared, <T as TopicPayload>::Header, ipc::Service>;

impl Node {
    /// Creates the publisher of a topic; one process at a time has it.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if another live process has it, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot
    /// be used, [`IpcError::Full`] if there is no room.
    pub fn publisher<T: TopicPayload<Shared = T>>(&self) -> Result<Publisher<T>, IpcError> {
        T::publisher(self, 1)
    }

    /// Creates the publisher of plans, with memory for plans of a chain of `sizes` with N = `intervals` at most.
    ///
    /// # Errors
    /// As [`Self::publisher`].
    pub fn plan_publisher(&self, sizes: Sizes, intervals: usize) -> Result<Publisher<PlanMessage>, IpcError> {
        PlanMessage::publisher(self, PlanMessage::length(sizes, intervals))
    }

    /// Creates a subscriber of a topic, whether or not there is a publisher.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if there are too many, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot be used,
    /// [`IpcError::Full`] if there is no room.
    pub fn subscriber<T: TopicPayload>(&self) -> Result<Subscriber<T>, IpcError> {
        T::subscriber(self)
    }
}

/// The only publisher of a topic; stays in the thread that created it.
pub struct Publisher<T: TopicPayload> {
    port: IoxPublisher<ipc::Service, T::Shared, T::Header>,
    _service: Service<T>,
    _node: Node,
}

impl<T: TopicPayload> Publisher<T> {
    /// Publishes a copy of `value`, written directly into shared memory, to all subscribers.
    ///
    /// # Errors
    /// [`IpcError::Send`], also if a plan is longer than the publisher has memory for.
    pub fn publish(&self, value: &T) -> Result<(), IpcError> {
        T::publish(self, value)
    }

    /// Delivers the history to subscribers that came after the last [`Publisher::publish`]. iceoryx2 does so only inside a
    /// call of the publisher: a process that publishes rarely should call this regularly.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn deliver_history(&self) -> Result<(), IpcError> {
        T::deliver_history(self)
    }
}

/// A subscriber of a topic; stays in the thread that created it.
pub struct Subscriber<T: TopicPayload> {
    pub(super) port: IoxSubscriber<ipc::Service, T::Shared, T::Header>,
    _service: Service<T>,
    _node: Node,
}

impl<T: TopicPayload> Subscriber<T> {
    /// Receives the oldest sample not yet received, in shared memory. Hold at most two at a time; a sample outlives its
    /// publisher. The publisher's process can still write into it: copy it before it is checked.
    ///
    /// # Errors
    /// [`IpcError::Receive`], also if too many samples are held.
    pub fn receive(&self) -> Result<Option<Sample<T>>, IpcError> {
        T::receive(self)
    }
}

/// A received sample; its place in shared memory is free again when it is dropped.
pub struct Sample<T: TopicPayload>(SharedSample<T>);

type SharedSample<T> = IoxSample<ipc::Service, <T as TopicPayload>::Shared, <T as TopicPayload>::Header>;

impl<T: TopicPayload<Shared = T> + ZeroCopySend> Deref for Sample<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.payload()
    }
}

impl Sample<PlanMessage> {
    /// A copy of the header.
    pub fn header(&self) -> PlanHeader {
        *self.0.user_header()
    }

    /// A copy, which no other process can change. Of the contents only the length is checked.
    ///
    /// # Errors
    /// [`DamagedPlan::Sizes`], [`DamagedPlan::Length`].
    pub fn copied(&self) -> Result<PlanMessage, DamagedPlan> {
        PlanMessage::copied(self.header(), self.0.payload())
    }
}

// The functions below are compiled once for each payload: see `services`.

/// As [`Node::publisher`].
pub(super) fn publisher<T: TopicPayload>(
    node: &Node,
    with_length: impl Fn(PublisherBuilder<'_, T>) -> PublisherBuilder<'_, T>,
) -> Result<Publisher<T>, IpcError> {
    node.reserving(|| {
        let service = open_service::<T>(node)?;
        let create = || {
            with_length(service.publisher_builder())
                .max_loaned_samples(1)
                // The buffers of all subscribers have the newest samples, so that these count once; iceoryx2 counts them for
                // each subscriber. Besides there are those that subscribers hold, the history and the next sample.
                .override_sample_preallocation(|_| T::BUFFER + MAX_SUBSCRIBERS * MAX_HELD + T::HISTORY + 1)
                // A slow subscriber loses its oldest samples; it never stops the publisher.
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.retry(create).map_err(|e| match e {
            PublisherCreateError::ExceedsMaxSupportedPublishers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_publishers(|p| push_pid(&mut holders, &p.node_id));
                IpcError::Taken { service: T::SERVICE.to_owned(), port: "publisher", max: 1, holders }
            }
            e => IpcError::Port { service: T::SERVICE.to_owned(), port: "publisher", cause: e.into() },
        })?;
        Ok(Publisher { port, _service: service, _node: node.clone() })
    })
}

/// As [`Node::subscriber`].
pub(super) fn subscriber<T: TopicPayload>(node: &Node) -> Result<Subscriber<T>, IpcError> {
    node.reserving(|| {
        let service = open_service::<T>(node)?;
        let create = || {
            service
                .subscriber_builder()
                .buffer_size(T::BUFFER)
                .set_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.retry(create).map_err(|e| match e {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_subscribers(|s| push_pid(&mut holders, &s.node_id));
                IpcError::Taken {
                    service: T::SERVICE.to_owned(),
                    port: "subscriber",
                    max: MAX_SUBSCRIBERS,
                    holders,
                }
            }
            e => IpcError::Port { service: T::SERVICE.to_owned(), port: "subscriber", cause: e.into() },
        })?;
        Ok(Subscriber { port, _service: service, _node: node.clone() })
    })
}

/// As [`Publisher::publish`], of messages of a fixed length.
pub(super) fn publish<T>(publisher: &Publisher<T>, value: &T) -> Result<(), IpcError>
where
    T: TopicPayload<Shared = T> + ZeroCopySend + Copy,
{
    let mut sample = publisher.port.loan_uninit().map_err(|e| send_error::<T>(e.into()))?;
    // SAFETY: the sample is memory for one `T` that nobody else uses yet; `T` is `Copy`.
    let sample = unsafe {
        std::ptr::copy_nonoverlapping(value, sample.payload_mut().as_mut_ptr(), 1);
        sample.assume_init()
    };
    sample.send().map(drop).map_err(|e| send_error::<T>(e.into()))
}

/// As [`Publisher::publish`], of plans.
pub(super) fn publish_plan(publisher: &Publisher<PlanMessage>, plan: &PlanMessage) -> Result<(), IpcError> {
    let failed = |cause| send_error::<PlanMessage>(cause);
    let sample = publisher.port.loan_slice_uninit(plan.values.len());
    let mut sample = sample.map_err(|e| failed(e.into()))?;
    *sample.user_header_mut() = plan.header;
    sample.write_from_slice(&plan.values).send().map(drop).map_err(|e| failed(e.into()))
}

/// As [`Publisher::deliver_history`].
pub(super) fn deliver_history<T: TopicPayload>(publisher: &Publisher<T>) -> Result<(), IpcError> {
    publisher.port.update_connections().map_err(|e| send_error::<T>(e.into()))
}

/// The result of [`Subscriber::receive`], of that of iceoryx2.
pub(super) fn received<T: TopicPayload>(
    sample: Result<Option<SharedSample<T>>, ReceiveError>,
) -> Result<Option<Sample<T>>, IpcError> {
    let sample = sample.map_err(|e| IpcError::Receive { service: T::SERVICE, cause: e.into() })?;
    Ok(sample.map(Sample))
}

fn open_service<T: TopicPayload>(node: &Node) -> Result<Service<T>, IpcError> {
    let failed = |cause| IpcError::Open { service: T::SERVICE.to_owned(), cause };
    let name = ServiceName::new(T::SERVICE).map_err(|e| failed(e.into()))?;
    let open = || {
        let builder = node
            .iox()
            .service_builder(&name)
            .publish_subscribe::<T::Shared>()
            .user_header::<T::Header>()
            .max_publishers(1)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(T::BUFFER)
            .subscriber_max_borrowed_samples(MAX_HELD)
            .history_size(T::HISTORY)
            .enable_safe_overflow(true);
        T::open_or_create(builder)
    };
    node.retry(open).map_err(|e| failed(e.into()))
}

fn send_error<T: TopicPayload>(cause: Cause) -> IpcError {
    IpcError::Send { service: T::SERVICE, cause }
}
