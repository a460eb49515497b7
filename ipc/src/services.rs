//! The services of upswing: which payload travels over which service, and their ports.
//!
//! Functions that need iceoryx2 are instantiated here, once for each payload: the methods of the ports call them through the
//! traits of their payloads. Plain generic methods would be compiled again, with all of iceoryx2 beneath them, in every
//! program and every test that uses them.

mod blackboard;
mod finder_thread;
mod publish_subscribe;
mod request_response;

pub use blackboard::{BlackboardPayload, Finder, MAX_READERS, Reader, Writer, WriterEntry, WriterPorts};
pub use finder_thread::FinderThread;
pub use publish_subscribe::{Publisher, Sample, Subscriber, TopicPayload};
pub use request_response::{Client, RequestPayload, Server};

use crate::error::{CallError, IpcError};
use crate::node::Node;
use crate::payload::{
    Command, ControlRequest, ControlResponse, Measurement, PlanHeader, PlanMessage, PlannerRequest,
    PlannerResponse, PlantRequest, PlantResponse, StepBatch, TelemetryBatch,
};
use iceoryx2::prelude::AllocationStrategy;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;
use publish_subscribe::{Service, ServiceBuilder};
use request_response::Handler;
use std::time::Duration;

macro_rules! blackboard {
    ($payload:ty, $channel:literal) => {
        impl BlackboardPayload for $payload {
            const CHANNEL: &'static str = $channel;

            fn writer(node: &Node) -> Result<Writer<Self>, IpcError> {
                blackboard::writer(node)
            }

            fn poll(
                finder: &mut Finder<Self>,
                keep_waiting: &dyn Fn() -> bool,
            ) -> Result<Option<Reader<Self>>, IpcError> {
                blackboard::poll(finder, keep_waiting)
            }
        }
    };
}

blackboard!(Measurement, "measurement");
blackboard!(Command, "command");

macro_rules! topic {
    (
        $message:ty, $service:literal, buffer $buffer:literal, history $history:literal,
        $header:ty, $shared:ty, $publish:path, |$builder:ident, $longest:ident| $with_length:expr
    ) => {
        impl TopicPayload for $message {
            const SERVICE: &'static str = $service;
            const BUFFER: usize = $buffer;
            const HISTORY: usize = $history;
            type Shared = $shared;
            type Header = $header;

            fn open_or_create(
                builder: ServiceBuilder<Self>,
            ) -> Result<Service<Self>, PublishSubscribeOpenOrCreateError> {
                builder.open_or_create()
            }

            fn publisher(node: &Node, $longest: usize) -> Result<Publisher<Self>, IpcError> {
                publish_subscribe::publisher(node, |$builder| $with_length)
            }

            fn subscriber(node: &Node) -> Result<Subscriber<Self>, IpcError> {
                publish_subscribe::subscriber(node)
            }

            fn publish(publisher: &Publisher<Self>, value: &Self) -> Result<(), IpcError> {
                $publish(publisher, value)
            }

            fn deliver_history(publisher: &Publisher<Self>) -> Result<(), IpcError> {
                publish_subscribe::deliver_history(publisher)
            }

            fn receive(subscriber: &Subscriber<Self>) -> Result<Option<Sample<Self>>, IpcError> {
                publish_subscribe::received(subscriber.port.receive())
            }
        }
    };
    ($message:ty, $service:literal, buffer $buffer:literal, history $history:literal) => {
        topic!(
            $message, $service, buffer $buffer, history $history,
            (), $message, publish_subscribe::publish, |builder, _longest| builder
        );
    };
}

topic!(
    PlanMessage, "plan", buffer 2, history 1,
    PlanHeader, [f64], publish_subscribe::publish_plan,
    |builder, longest| builder.initial_max_slice_len(longest).allocation_strategy(AllocationStrategy::Static)
);
topic!(TelemetryBatch, "telemetry", buffer 256, history 0);
topic!(StepBatch, "steps", buffer 128, history 0);

macro_rules! request {
    ($request:ty, $service:literal, $response:ty) => {
        impl RequestPayload for $request {
            type Response = $response;
            const SERVICE: &'static str = $service;

            fn client(node: &Node) -> Result<Client<Self>, IpcError> {
                request_response::client(node)
            }

            fn server(node: &Node) -> Result<Server<Self>, IpcError> {
                request_response::server(node)
            }

            fn has_server(client: &Client<Self>) -> bool {
                request_response::has_server(client)
            }

            fn call(
                client: &Client<Self>,
                request: &Self,
                timeout: Duration,
                keep_waiting: &mut dyn FnMut() -> bool,
            ) -> Result<$response, CallError> {
                request_response::call(client, request, timeout, keep_waiting)
            }

            fn poll(server: &Server<Self>, handle: Handler<'_, Self>) -> Result<usize, IpcError> {
                request_response::poll(server, handle)
            }
        }
    };
}

request!(ControlRequest, "control", ControlResponse);
request!(PlannerRequest, "planner", PlannerResponse);
request!(PlantRequest, "plant", PlantResponse);
