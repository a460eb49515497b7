//! Requests of several clients to one server, and its responses. Not for the real-time thread.

use crate::domain::Domain;
use crate::error::{CallError, IpcError};
use crate::node::{MAX_NODES, Node, push_pid};
use iceoryx2::port::DegradationAction;
use iceoryx2::port::client::Client as IoxClient;
use iceoryx2::port::server::Server as IoxServer;
use iceoryx2::prelude::{BackpressureStrategy, PortFactory as _, ServiceName, ZeroCopySend, ipc};
use iceoryx2::service::port_factory::client::ClientCreateError;
use iceoryx2::service::port_factory::request_response::PortFactory;
use iceoryx2::service::port_factory::server::ServerCreateError;
use std::cell::Cell;
use std::fmt::Debug;
use std::time::{Duration, Instant};

type Service<Q> = PortFactory<ipc::Service, Q, (), <Q as RequestPayload>::Response, ()>;

/// Largest number of clients of one server.
const MAX_CLIENTS: usize = 16;
/// How long a client waits without pause: most responses come within a few microseconds.
const EAGER: Duration = Duration::from_micros(50);
/// Shortest and longest pause of a waiting client.
const PAUSE: (Duration, Duration) = (Duration::from_micros(50), Duration::from_millis(1));
/// Bounds of one [`Server::poll`]: the number of requests, and the time after which no further request is begun. The process
/// of a server has other work to do.
const TURN: (usize, Duration) = (MAX_CLIENTS, Duration::from_millis(50));
/// How long a client assumes that a server is alive after the last response or check.
const ALIVE_FOR: Duration = Duration::from_millis(100);

/// A payload that one server answers.
pub trait RequestPayload: ZeroCopySend + Copy + Debug + 'static {
    /// The payload of the response.
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
        client: &Client<Self>,
        request: &Self,
        timeout: Duration,
        keep_waiting: &mut dyn FnMut() -> bool,
    ) -> Result<Self::Response, CallError>;
    #[doc(hidden)]
    fn poll(server: &Server<Self>, handle: Handler<'_, Self>) -> Result<usize, IpcError>;
}

/// Makes the response to a request; its second argument tells whether the client still waits for it.
pub(super) type Handler<'a, Q> = &'a mut dyn FnMut(&Q, &dyn Fn() -> bool) -> <Q as RequestPayload>::Response;

impl Node {
    /// Creates a client of a service, whether or not there is a server.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if there are too many, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot be used,
    /// [`IpcError::Full`] if there is no room.
    pub fn client<Q: RequestPayload>(&self) -> Result<Client<Q>, IpcError> {
        Q::client(self)
    }

    /// Creates the server of a service; one process at a time has it. Takes the place of a server that died.
    ///
    /// # Errors
    /// [`IpcError::Taken`] if another live process serves, [`IpcError::Open`] or [`IpcError::Port`] if the service cannot
    /// be used, [`IpcError::Full`] if there is no room.
    pub fn server<Q: RequestPayload>(&self) -> Result<Server<Q>, IpcError> {
        Q::server(self)
    }
}

/// Sends requests to the server of a service; stays in the thread that created it.
pub struct Client<Q: RequestPayload> {
    port: IoxClient<ipc::Service, Q, (), Q::Response, ()>,
    service: Service<Q>,
    /// When the server was last known to be alive.
    alive: Cell<Option<Instant>>,
    node: Node,
}

impl<Q: RequestPayload> Client<Q> {
    /// Whether there is a live server now; also cleans up after dead processes.
    pub fn has_server(&self) -> bool {
        Q::has_server(self)
    }

    /// As [`Client::has_server`], but checks only if there was no sign of life lately: the check takes much longer than a
    /// request.
    fn had_server_lately(&self) -> bool {
        self.alive.get().is_some_and(|seen| seen.elapsed() < ALIVE_FOR) || has_server(self)
    }

    /// Sends `request` and waits for the response, at most `timeout`. A request that is not yet being handled then is
    /// withdrawn, and a server that handles it can see that nobody waits any more.
    ///
    /// # Errors
    /// [`CallError::NoServer`] at once if there is none, [`CallError::ServerGone`] if it goes away meanwhile,
    /// [`CallError::Timeout`] if it does not respond in time.
    pub fn call(&self, request: &Q, timeout: Duration) -> Result<Q::Response, CallError> {
        self.call_while(request, timeout, || true)
    }

    /// As [`Client::call`], but waits only as long as `keep_waiting` returns true, which is called at each look for the
    /// response.
    ///
    /// # Errors
    /// As [`Client::call`], and [`CallError::Interrupted`].
    pub fn call_while(
        &self,
        request: &Q,
        timeout: Duration,
        mut keep_waiting: impl FnMut() -> bool,
    ) -> Result<Q::Response, CallError> {
        Q::call(self, request, timeout, &mut keep_waiting)
    }

    fn no_server(&self) -> CallError {
        CallError::no_server(Q::SERVICE, self.node.domain())
    }
}

impl CallError {
    /// The error for a service that no process serves in `domain`; names the other domains in which processes run.
    pub fn no_server(service: &'static str, domain: &Domain) -> Self {
        Self::NoServer { service, domain: domain.name().to_owned(), others: domain.others() }
    }
}

/// The only server of a service; stays in the thread that created it.
pub struct Server<Q: RequestPayload> {
    port: IoxServer<ipc::Service, Q, (), Q::Response, ()>,
    _service: Service<Q>,
    _node: Node,
}

impl<Q: RequestPayload> Server<Q> {
    /// Answers waiting requests with `handle`; returns how many. One call is bounded in number and time, so that clients
    /// that always have another request cannot keep the server's process busy with nothing else. Requests for which nobody
    /// waits any more are not handled: a command must not take effect after its sender was told that it did not.
    ///
    /// # Errors
    /// [`IpcError::Receive`] or [`IpcError::Send`].
    pub fn poll(&self, mut handle: impl FnMut(&Q) -> Q::Response) -> Result<usize, IpcError> {
        self.poll_cancellable(|request, _| handle(request))
    }

    /// As [`Server::poll`], for requests that take long: the second argument of `handle` tells whether the client still
    /// waits for the response.
    ///
    /// # Errors
    /// [`IpcError::Receive`] or [`IpcError::Send`].
    pub fn poll_cancellable(
        &self,
        mut handle: impl FnMut(&Q, &dyn Fn() -> bool) -> Q::Response,
    ) -> Result<usize, IpcError> {
        Q::poll(self, &mut handle)
    }
}

// The functions below are compiled once for each payload: see `services`.

/// As [`Node::client`].
pub(super) fn client<Q: RequestPayload>(node: &Node) -> Result<Client<Q>, IpcError> {
    node.reserving(|| {
        let service = open_service::<Q>(node)?;
        let create = || {
            service
                .client_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_request_degradation_handler(|_, _| DegradationAction::Ignore)
                .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.retry(create).map_err(|e| match e {
            ClientCreateError::ExceedsMaxSupportedClients => {
                let mut holders = Vec::new();
                service.dynamic_config().list_clients(|client| push_pid(&mut holders, &client.node_id));
                IpcError::Taken { service: Q::SERVICE.to_owned(), port: "client", max: MAX_CLIENTS, holders }
            }
            e => IpcError::Port { service: Q::SERVICE.to_owned(), port: "client", cause: e.into() },
        })?;
        Ok(Client { port, service, alive: Cell::new(None), node: node.clone() })
    })
}

/// As [`Node::server`].
pub(super) fn server<Q: RequestPayload>(node: &Node) -> Result<Server<Q>, IpcError> {
    node.reserving(|| {
        let service = open_service::<Q>(node)?;
        let create = || {
            service
                .server_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_request_degradation_handler(|_, _| DegradationAction::Ignore)
                .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let port = node.retry(create).map_err(|e| match e {
            ServerCreateError::ExceedsMaxSupportedServers => {
                let mut holders = Vec::new();
                service.dynamic_config().list_servers(|server| push_pid(&mut holders, &server.node_id));
                IpcError::Taken { service: Q::SERVICE.to_owned(), port: "server", max: 1, holders }
            }
            e => IpcError::Port { service: Q::SERVICE.to_owned(), port: "server", cause: e.into() },
        })?;
        Ok(Server { port, _service: service, _node: node.clone() })
    })
}

/// As [`Client::has_server`].
pub(super) fn has_server<Q: RequestPayload>(client: &Client<Q>) -> bool {
    // Dead servers count until somebody cleans up.
    client.node.clean_up();
    let found = client.service.dynamic_config().number_of_servers() > 0;
    client.alive.set(found.then(Instant::now));
    found
}

/// As [`Client::call_while`].
pub(super) fn call<Q: RequestPayload>(
    client: &Client<Q>,
    request: &Q,
    timeout: Duration,
    keep_waiting: &mut dyn FnMut() -> bool,
) -> Result<Q::Response, CallError> {
    if !client.had_server_lately() {
        return Err(client.no_server());
    }
    let pending = client.port.send_copy(*request);
    let pending = pending.map_err(|e| IpcError::Send { service: Q::SERVICE, cause: e.into() })?;
    if pending.number_of_server_connections() == 0 {
        return Err(client.no_server());
    }
    let start = Instant::now();
    let mut pause = PAUSE.0;
    loop {
        // Before the look for the response: a server that responds and goes away must not count as gone.
        let served = pending.is_connected();
        let response = pending.receive();
        if let Some(response) =
            response.map_err(|e| IpcError::Receive { service: Q::SERVICE, cause: e.into() })?
        {
            client.alive.set(Some(Instant::now()));
            return Ok(*response);
        }
        if !served || !client.had_server_lately() {
            return Err(CallError::ServerGone { service: Q::SERVICE });
        }
        if !keep_waiting() {
            return Err(CallError::Interrupted { service: Q::SERVICE });
        }
        let waited = start.elapsed();
        if waited >= timeout {
            return Err(CallError::Timeout { service: Q::SERVICE, waited });
        }
        if waited < EAGER {
            // Not `yield_now`, which may cost the thread a whole time slice of the scheduler.
            std::hint::spin_loop();
        } else {
            std::thread::sleep(pause.min(timeout - waited));
            pause = (2 * pause).min(PAUSE.1);
        }
    }
}

/// As [`Server::poll_cancellable`].
pub(super) fn poll<Q: RequestPayload>(server: &Server<Q>, handle: Handler<'_, Q>) -> Result<usize, IpcError> {
    let receive =
        || server.port.receive().map_err(|e| IpcError::Receive { service: Q::SERVICE, cause: e.into() });
    let begin = Instant::now();
    let mut answered = 0;
    while answered < TURN.0 && (answered == 0 || begin.elapsed() < TURN.1) {
        let Some(pending) = receive()? else { break };
        // A copy: the client could change the request while it is being checked.
        let request: Q = *pending.payload();
        let response = handle(&request, &|| pending.is_connected());
        pending.send_copy(response).map_err(|e| IpcError::Send { service: Q::SERVICE, cause: e.into() })?;
        answered += 1;
    }
    Ok(answered)
}

fn open_service<Q: RequestPayload>(node: &Node) -> Result<Service<Q>, IpcError> {
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
    node.retry(open).map_err(|e| failed(e.into()))
}
