//! Requests to one server and its answers. Nothing here is for the real-time thread.

use crate::error::{CallError, IpcError};
use crate::node::{Node, note_pid};
use crate::services::{Handler, MAX_CLIENTS, MAX_NODES, Request};
use iceoryx2::port::DegradationAction;
use iceoryx2::port::client::Client as IoxClient;
use iceoryx2::port::server::Server as IoxServer;
use iceoryx2::prelude::{BackpressureStrategy, PortFactory as _, ServiceName, ipc};
use iceoryx2::service::port_factory::client::ClientCreateError;
use iceoryx2::service::port_factory::request_response::PortFactory;
use iceoryx2::service::port_factory::server::ServerCreateError;
use std::cell::Cell;
use std::time::{Duration, Instant};

type Service<Q> = PortFactory<ipc::Service, Q, (), <Q as Request>::Response, ()>;

/// How long a client waits without pause: most answers come in a few microseconds.
const EAGER: Duration = Duration::from_micros(50);
/// Shortest and longest pause of a waiting client.
const PAUSE: (Duration, Duration) = (Duration::from_micros(50), Duration::from_millis(1));
/// What one turn of a server is bounded by: as many requests as there can be clients, and the time after which no further
/// one is begun. Its process has other things to do.
const TURN: (usize, Duration) = (MAX_CLIENTS, Duration::from_millis(50));
/// How long a sign of life of the server counts.
const ROLL_CALL: Duration = Duration::from_millis(100);

/// Asks a server; stays in the thread that created it.
pub struct Client<Q: Request> {
    port: IoxClient<ipc::Service, Q, (), Q::Response, ()>,
    service: Service<Q>,
    /// When the server was last known to be alive.
    alive: Cell<Option<Instant>>,
    node: Node,
}

impl<Q: Request> Client<Q> {
    /// Becomes a client, whether or not there is a server.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if there are too many, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot
    /// be used.
    pub(crate) fn create(node: &Node) -> Result<Self, IpcError> {
        let service = open::<Q>(node)?;
        let create = || {
            service
                .client_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_request_degradation_handler(|_, _| DegradationAction::Ignore)
                .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.persist(create).map_err(|e| match e {
            ClientCreateError::ExceedsMaxSupportedClients => {
                let mut holders = Vec::new();
                service.dynamic_config().list_clients(|client| note_pid(&mut holders, &client.node_id));
                IpcError::Taken { service: Q::SERVICE.to_owned(), port: "client", max: MAX_CLIENTS, holders }
            }
            e => IpcError::Port { service: Q::SERVICE.to_owned(), port: "client", cause: e.into() },
        })?;
        Ok(Self { port, service, alive: Cell::new(None), node: node.clone() })
    }

    /// Whether a live server is there now.
    pub fn has_server(&self) -> bool {
        Q::has_server(self)
    }

    /// As [`Self::has_server`], to be compiled once for each payload: see `services`.
    pub(crate) fn look(&self) -> bool {
        // The dead ones count until somebody cleans up.
        self.node.clean_up();
        let found = self.service.dynamic_config().number_of_servers() > 0;
        self.alive.set(found.then(Instant::now));
        found
    }

    /// As [`Client::has_server`], but looks only if there was no sign of life lately: looking takes much longer
    /// than a request.
    fn had_server_lately(&self) -> bool {
        self.alive.get().is_some_and(|seen| seen.elapsed() < ROLL_CALL) || self.look()
    }

    /// Sends `request` and waits for the answer, at most `timeout`. A request that is not yet being handled when
    /// the time is up is withdrawn, and a server that handles it can see that nobody waits any more.
    ///
    /// # Errors
    /// [`CallError::NoServer`] at once if there is none, [`CallError::ServerGone`] if it goes away meanwhile,
    /// [`CallError::Timeout`] if it does not answer in time.
    pub fn call(&self, request: &Q, timeout: Duration) -> Result<Q::Response, CallError> {
        self.call_while(request, timeout, || true)
    }

    /// As [`Client::call`], but asks `wanted` at each look for the answer, and gives up once that says no.
    ///
    /// # Errors
    /// As [`Client::call`], and [`CallError::Interrupted`].
    pub fn call_while(
        &self,
        request: &Q,
        timeout: Duration,
        mut wanted: impl FnMut() -> bool,
    ) -> Result<Q::Response, CallError> {
        request.call(self, timeout, &mut wanted)
    }

    /// As [`Self::call_while`], to be compiled once for each payload: see `services`.
    pub(crate) fn ask(
        &self,
        request: &Q,
        timeout: Duration,
        wanted: &mut dyn FnMut() -> bool,
    ) -> Result<Q::Response, CallError> {
        if !self.had_server_lately() {
            return Err(self.no_server());
        }
        let pending = self.port.send_copy(*request);
        let pending = pending.map_err(|e| IpcError::Send { service: Q::SERVICE, cause: e.into() })?;
        if pending.number_of_server_connections() == 0 {
            return Err(self.no_server());
        }
        let start = Instant::now();
        let mut pause = PAUSE.0;
        loop {
            // Before the look at the answer: a server that answers and goes away must not count as gone.
            let served = pending.is_connected();
            let answer = pending.receive();
            if let Some(answer) =
                answer.map_err(|e| IpcError::Receive { service: Q::SERVICE, cause: e.into() })?
            {
                self.alive.set(Some(Instant::now()));
                return Ok(*answer);
            }
            if !served || !self.had_server_lately() {
                return Err(CallError::ServerGone { service: Q::SERVICE });
            }
            if !wanted() {
                return Err(CallError::Interrupted { service: Q::SERVICE });
            }
            let waited = start.elapsed();
            if waited >= timeout {
                return Err(CallError::Timeout { service: Q::SERVICE, waited });
            }
            if waited < EAGER {
                std::thread::yield_now();
            } else {
                std::thread::sleep(pause.min(timeout - waited));
                pause = (2 * pause).min(PAUSE.1);
            }
        }
    }

    fn no_server(&self) -> CallError {
        CallError::no_server(Q::SERVICE, self.node.domain())
    }
}

/// The only server of a service; stays in the thread that created it.
pub struct Server<Q: Request> {
    port: IoxServer<ipc::Service, Q, (), Q::Response, ()>,
    _service: Service<Q>,
    _node: Node,
}

impl<Q: Request> Server<Q> {
    /// Becomes the server; takes the place of one that died.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if another live process serves, [`IpcError::Open`] or [`IpcError::Port`] if the service
    /// cannot be used.
    pub(crate) fn create(node: &Node) -> Result<Self, IpcError> {
        let service = open::<Q>(node)?;
        let create = || {
            service
                .server_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_request_degradation_handler(|_, _| DegradationAction::Ignore)
                .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.persist(create).map_err(|e| match e {
            ServerCreateError::ExceedsMaxSupportedServers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_servers(|server| note_pid(&mut holders, &server.node_id));
                IpcError::Taken { service: Q::SERVICE.to_owned(), port: "server", max: 1, holders }
            }
            e => IpcError::Port { service: Q::SERVICE.to_owned(), port: "server", cause: e.into() },
        })?;
        Ok(Self { port, _service: service, _node: node.clone() })
    }

    /// Answers waiting requests with `handle`; returns how many. One turn is bounded in number and time, so that clients
    /// who always have another one cannot keep the server's process busy with nothing else. Requests that nobody waits for
    /// any more are not handled: a command must not take effect after its sender was told that it did not.
    ///
    /// # Errors
    /// [`IpcError::Receive`] or [`IpcError::Send`].
    pub fn poll(&self, mut handle: impl FnMut(&Q) -> Q::Response) -> Result<usize, IpcError> {
        self.poll_while_wanted(|request, _| handle(request))
    }

    /// As [`Server::poll`], for requests that take long: the second argument of `handle` tells whether somebody still
    /// waits for the answer.
    ///
    /// # Errors
    /// [`IpcError::Receive`] or [`IpcError::Send`].
    pub fn poll_while_wanted(
        &self,
        mut handle: impl FnMut(&Q, &dyn Fn() -> bool) -> Q::Response,
    ) -> Result<usize, IpcError> {
        Q::poll(self, &mut handle)
    }

    /// As [`Self::poll_while_wanted`], to be compiled once for each payload: see `services`.
    pub(crate) fn answer(&self, handle: Handler<'_, Q>) -> Result<usize, IpcError> {
        let receive =
            || self.port.receive().map_err(|e| IpcError::Receive { service: Q::SERVICE, cause: e.into() });
        let begin = Instant::now();
        let mut answered = 0;
        while answered < TURN.0 && (answered == 0 || begin.elapsed() < TURN.1) {
            let Some(request) = receive()? else { break };
            // A copy: the client could change the request while it is being checked.
            let question: Q = *request.payload();
            let answer = handle(&question, &|| request.is_connected());
            request.send_copy(answer).map_err(|e| IpcError::Send { service: Q::SERVICE, cause: e.into() })?;
            answered += 1;
        }
        Ok(answered)
    }
}

fn open<Q: Request>(node: &Node) -> Result<Service<Q>, IpcError> {
    let failed = |cause| IpcError::Open { service: Q::SERVICE.to_owned(), cause };
    let name = ServiceName::new(Q::SERVICE).map_err(|e| failed(e.into()))?;
    let open = || {
        node.iox()
            .service_builder(&name)
            .request_response::<Q, Q::Response>()
            .max_servers(1)
            .max_clients(MAX_CLIENTS)
            .max_nodes(MAX_NODES)
            .enable_fire_and_forget_requests(false)
            .open_or_create()
    };
    node.persist(open).map_err(|e| failed(e.into()))
}
