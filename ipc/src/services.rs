//! Which payload travels over which service: the only place where a service is named.
//!
//! What needs iceoryx2 is a function of each payload's own here: generic functions would be compiled again, with all of
//! iceoryx2 beneath them, in every program and every test that uses them.

use crate::blackboard::{Finder, Reader, Writer};
use crate::error::{CallError, IpcError};
use crate::messages::{Publisher, Received, Subscriber};
use crate::node::Node;
use crate::payload::{
    Command, ControlRequest, ControlResponse, Measurement, Plan, PlannerRequest, PlannerResponse,
    PlantRequest, PlantResponse, StepBatch, TelemetryBatch,
};
use crate::request::{Client, Server};
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;
use std::time::Duration;

/// A payload of which only the latest value counts: written every cycle, read every cycle.
pub trait Latest: ZeroCopySend + Copy + Debug + Default + Send + 'static {
    /// Name of the channel; each writer start has its own service `<channel>/<epoch>`.
    const CHANNEL: &'static str;

    #[doc(hidden)]
    fn writer(node: &Node) -> Result<Writer<Self>, IpcError>;
    #[doc(hidden)]
    fn poll(finder: &mut Finder<Self>, wanted: &dyn Fn() -> bool) -> Result<Option<Reader<Self>>, IpcError>;
}

macro_rules! latest {
    ($payload:ty, $channel:literal) => {
        impl Latest for $payload {
            const CHANNEL: &'static str = $channel;

            fn writer(node: &Node) -> Result<Writer<Self>, IpcError> {
                node.domain().with_room(|| Writer::create(node))
            }

            fn poll(
                finder: &mut Finder<Self>,
                wanted: &dyn Fn() -> bool,
            ) -> Result<Option<Reader<Self>>, IpcError> {
                finder.look(wanted)
            }
        }
    };
}

latest!(Measurement, "measurement");
latest!(Command, "command");

/// A payload that one process publishes and several receive.
pub trait Topic: ZeroCopySend + Copy + Debug + 'static {
    /// Name of the service.
    const SERVICE: &'static str;
    /// Samples that wait for a slow subscriber before the oldest is replaced.
    const BUFFER: usize;
    /// Samples that a late subscriber still gets.
    const HISTORY: usize;

    #[doc(hidden)]
    fn publisher(node: &Node) -> Result<Publisher<Self>, IpcError>;
    #[doc(hidden)]
    fn subscriber(node: &Node) -> Result<Subscriber<Self>, IpcError>;
    #[doc(hidden)]
    fn publish(&self, publisher: &Publisher<Self>) -> Result<(), IpcError>;
    #[doc(hidden)]
    fn greet(publisher: &Publisher<Self>) -> Result<(), IpcError>;
    #[doc(hidden)]
    fn receive(subscriber: &Subscriber<Self>) -> Result<Option<Received<Self>>, IpcError>;
}

macro_rules! topic {
    ($payload:ty, $service:literal, buffer $buffer:literal, history $history:literal) => {
        impl Topic for $payload {
            const SERVICE: &'static str = $service;
            const BUFFER: usize = $buffer;
            const HISTORY: usize = $history;

            fn publisher(node: &Node) -> Result<Publisher<Self>, IpcError> {
                node.domain().with_room(|| Publisher::create(node))
            }

            fn subscriber(node: &Node) -> Result<Subscriber<Self>, IpcError> {
                node.domain().with_room(|| Subscriber::create(node))
            }

            fn publish(&self, publisher: &Publisher<Self>) -> Result<(), IpcError> {
                publisher.send(self)
            }

            fn greet(publisher: &Publisher<Self>) -> Result<(), IpcError> {
                publisher.update()
            }

            fn receive(subscriber: &Subscriber<Self>) -> Result<Option<Received<Self>>, IpcError> {
                subscriber.take()
            }
        }
    };
}

topic!(Plan, "plan", buffer 2, history 1);
topic!(TelemetryBatch, "telemetry", buffer 256, history 0);
topic!(StepBatch, "steps", buffer 128, history 0);

/// A payload that one server answers.
pub trait Request: ZeroCopySend + Copy + Debug + 'static {
    /// The answer.
    type Response: ZeroCopySend + Copy + Debug + 'static;
    /// Name of the service.
    const SERVICE: &'static str;

    #[doc(hidden)]
    fn client(node: &Node) -> Result<Client<Self>, IpcError>;
    #[doc(hidden)]
    fn server(node: &Node) -> Result<Server<Self>, IpcError>;
    #[doc(hidden)]
    fn has_server(client: &Client<Self>) -> bool;
    #[doc(hidden)]
    fn call(
        &self,
        client: &Client<Self>,
        timeout: Duration,
        wanted: &mut dyn FnMut() -> bool,
    ) -> Result<Self::Response, CallError>;
    #[doc(hidden)]
    fn poll(server: &Server<Self>, handle: Handler<'_, Self>) -> Result<usize, IpcError>;
}

/// Answers a request; its second argument tells whether somebody still waits for the answer.
pub(crate) type Handler<'a, Q> = &'a mut dyn FnMut(&Q, &dyn Fn() -> bool) -> <Q as Request>::Response;

macro_rules! request {
    ($request:ty, $service:literal, $response:ty) => {
        impl Request for $request {
            type Response = $response;
            const SERVICE: &'static str = $service;

            fn client(node: &Node) -> Result<Client<Self>, IpcError> {
                node.domain().with_room(|| Client::create(node))
            }

            fn server(node: &Node) -> Result<Server<Self>, IpcError> {
                node.domain().with_room(|| Server::create(node))
            }

            fn has_server(client: &Client<Self>) -> bool {
                client.look()
            }

            fn call(
                &self,
                client: &Client<Self>,
                timeout: Duration,
                wanted: &mut dyn FnMut() -> bool,
            ) -> Result<Self::Response, CallError> {
                client.ask(self, timeout, wanted)
            }

            fn poll(server: &Server<Self>, handle: Handler<'_, Self>) -> Result<usize, IpcError> {
                server.answer(handle)
            }
        }
    };
}

request!(ControlRequest, "control", ControlResponse);
request!(PlannerRequest, "planner", PlannerResponse);
request!(PlantRequest, "plant", PlantResponse);

/// Nodes (in practice: processes) that may have one service open at a time.
pub const MAX_NODES: usize = 24;
/// Readers of one blackboard.
pub const MAX_READERS: usize = 8;
/// Subscribers of one topic.
pub(crate) const MAX_SUBSCRIBERS: usize = 8;
/// Samples of one topic that a subscriber may hold at a time.
pub(crate) const MAX_BORROWED: usize = 2;
/// Clients of one server.
pub(crate) const MAX_CLIENTS: usize = 16;
