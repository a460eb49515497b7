//! HTTP/1.1 server for the live page and the metrics. Clients are not trusted: whether they send too much, withhold data or do
//! not read, a client takes bounded memory and time, and delays no other client.

use http_body_util::channel::{self, Channel};
use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt, Full};
use hyper::body::{Body as _, Bytes, Incoming};
use hyper::header::{self, HeaderName, HeaderValue};
use hyper::server::conn::http1;
use hyper::{Method, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::task::AbortHandle;
use tokio_io_timeout::TimeoutStream;

/// Most open connections; fewer if the limit of open files of the process is low.
const CONNECTIONS: usize = 128;
/// Largest share of the process's open files for connections.
const FILES: f64 = 0.25;
/// Longest wait for a complete header, also between two requests of a connection.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time in which a client may take no data of an answer.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);
/// Largest header, bytes.
const HEADER_BYTES: usize = 16 << 10;
const HEADER_FIELDS: usize = 64;
/// Most threads for answers that block.
const BLOCKING: usize = 16;
/// Longest time between two checks of `stop`.
const PAUSE: Duration = Duration::from_millis(100);

/// Headers of every answer: no caching, no frames, no guessing of types, no access by other sites.
const HEADERS: [(HeaderName, &str); 5] = [
    (header::CACHE_CONTROL, "no-store"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; \
         frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    ),
];

/// Content type of server-sent events.
pub const EVENTS: &str = "text/event-stream";

/// HTTP request without a body: the server refuses a request with a body before it calls `answer`.
pub type HttpRequest = hyper::Request<Incoming>;
/// HTTP response with a body of text or a stream.
pub type HttpResponse = hyper::Response<BoxBody<Bytes, Infallible>>;

/// Error of a server that cannot listen at its address.
#[derive(Debug, thiserror::Error)]
#[error("cannot listen at {address}: {cause}; choose a free port of this machine, for example 127.0.0.1:0")]
pub struct ListenError {
    address: SocketAddr,
    cause: io::Error,
}

/// Error of a server that cannot accept connections any more.
#[derive(Debug, thiserror::Error)]
#[error("the listener at {address} has failed: {cause}; start it again")]
pub struct ServeError {
    address: SocketAddr,
    cause: io::Error,
}

/// Listening socket of an HTTP server.
pub struct Listener {
    socket: TcpListener,
    /// Address of the socket, with the port that the system chose for port 0.
    pub address: SocketAddr,
}

impl Listener {
    /// Binds a socket to `address` and listens.
    ///
    /// # Errors
    /// [`ListenError`] if the address cannot be bound.
    pub fn bind(address: SocketAddr) -> Result<Self, ListenError> {
        let bind = || {
            let socket = TcpListener::bind(address)?;
            socket.set_nonblocking(true)?;
            let address = socket.local_addr()?;
            Ok(Self { socket, address })
        };
        bind().map_err(|cause| ListenError { address, cause })
    }

    /// Starts a thread that answers requests until `stop` is set. `answer` runs in that thread and must not block it.
    pub fn serve<F>(
        self,
        stop: &Arc<AtomicBool>,
        answer: impl Fn(HttpRequest) -> F + Send + Sync + 'static,
    ) -> HttpServer
    where
        F: Future<Output = HttpResponse> + Send + 'static,
    {
        let (stop, address) = (Arc::clone(stop), self.address);
        let serve = move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_io()
                .enable_time()
                .max_blocking_threads(BLOCKING)
                .build();
            let served = runtime.and_then(|runtime| {
                let served = runtime.block_on(accept(self.socket, &stop, Arc::new(answer)));
                // The connections are closed; a blocking thread that still waits for an operator's request is not joined.
                runtime.shutdown_background();
                served
            });
            served.map_err(|cause| ServeError { address, cause })
        };
        HttpServer { thread: Some(std::thread::spawn(serve)), address }
    }
}

/// Thread of a running HTTP server.
pub struct HttpServer {
    thread: Option<std::thread::JoinHandle<Result<(), ServeError>>>,
    address: SocketAddr,
}

impl HttpServer {
    /// Checks that the server still answers.
    ///
    /// # Errors
    /// [`ServeError`] if its thread has ended before `stop` was set.
    pub fn check(&mut self) -> Result<(), ServeError> {
        if self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Ok(());
        }
        self.end()
    }

    /// Joins the thread of the server, after `stop` was set.
    ///
    /// # Errors
    /// [`ServeError`] if the thread ended with an error or a panic.
    pub fn end(&mut self) -> Result<(), ServeError> {
        let died =
            |_| Err(ServeError { address: self.address, cause: io::Error::other("its thread panicked") });
        self.thread.take().map_or(Ok(()), |thread| thread.join().unwrap_or_else(died))
    }
}

/// Open connections, oldest first.
struct Connections {
    open: VecDeque<Connection>,
    most: usize,
}

struct Connection {
    task: AbortHandle,
    /// Number of answers under way on this connection.
    answers: Arc<AtomicUsize>,
}

impl Connections {
    /// Makes room for one more connection, if need be by closing the oldest without an answer under way. Clients that never finish
    /// a request thus push out each other, and a client that sends its request at once is answered. Returns whether there is room.
    fn make_room(&mut self) -> bool {
        self.open.retain(|connection| !connection.task.is_finished());
        self.open.len() < self.most || self.close_one()
    }

    fn close_one(&mut self) -> bool {
        let waits = |connection: &Connection| connection.answers.load(Ordering::Acquire) == 0;
        let oldest = self.open.iter().position(waits).and_then(|i| self.open.remove(i));
        oldest.map(|connection| connection.task.abort()).is_some()
    }
}

async fn accept<F>(
    socket: TcpListener,
    stop: &AtomicBool,
    answer: Arc<impl Fn(HttpRequest) -> F + Send + Sync + 'static>,
) -> io::Result<()>
where
    F: Future<Output = HttpResponse> + Send + 'static,
{
    let socket = tokio::net::TcpListener::from_std(socket)?;
    let most = CONNECTIONS.min((FILES * files() as f64) as usize).max(1);
    let mut connections = Connections { open: VecDeque::new(), most };
    while !stop.load(Ordering::Acquire) {
        match tokio::time::timeout(PAUSE, socket.accept()).await {
            Err(_) => {}
            Ok(Ok((stream, _))) => {
                // If every connection has an answer under way, the new connection is closed.
                if connections.make_room() {
                    let answers = Arc::new(AtomicUsize::new(0));
                    let serve = connection(stream, Arc::clone(&answers), Arc::clone(&answer));
                    let task = tokio::spawn(serve).abort_handle();
                    connections.open.push_back(Connection { task, answers });
                }
            }
            Ok(Err(e)) if is_of_client(&e) => {}
            Ok(Err(e)) if is_shortage(&e) => {
                tracing::warn!("cannot take a connection: {e}");
                connections.close_one();
                tokio::time::sleep(PAUSE).await;
            }
            Ok(Err(e)) => return Err(e),
        }
    }
    Ok(())
}

/// Whether accept(2) reports an error of a single connection, before it was accepted.
fn is_of_client(e: &io::Error) -> bool {
    const NETWORK: [i32; 11] = [
        libc::ECONNABORTED,
        libc::EINTR,
        libc::EAGAIN,
        libc::ENETDOWN,
        libc::EPROTO,
        libc::ENOPROTOOPT,
        libc::EHOSTDOWN,
        libc::ENONET,
        libc::EHOSTUNREACH,
        libc::EPERM,
        libc::ENETUNREACH,
    ];
    e.raw_os_error().is_some_and(|code| NETWORK.contains(&code))
}

/// Whether accepting failed from a passing shortage of file descriptors or memory.
fn is_shortage(e: &io::Error) -> bool {
    const SHORTAGE: [i32; 4] = [libc::EMFILE, libc::ENFILE, libc::ENOBUFS, libc::ENOMEM];
    e.raw_os_error().is_some_and(|code| SHORTAGE.contains(&code))
}

/// Number of files that the process may open; 0 if unknown.
fn files() -> u64 {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the pointer is valid for the call.
    match unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &raw mut limit) } {
        0 => limit.rlim_cur,
        _ => 0,
    }
}

async fn connection<F>(
    stream: TcpStream,
    answers: Arc<AtomicUsize>,
    answer: Arc<impl Fn(HttpRequest) -> F + Send + Sync + 'static>,
) where
    F: Future<Output = HttpResponse> + Send + 'static,
{
    // Small events are sent at once. On failure they are sent, but later.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let service = hyper::service::service_fn(|request: HttpRequest| {
        let under_way = UnderWay::begin(&answers);
        // A body is never read: a request with a body is refused.
        let answer = request.body().is_end_stream().then(|| answer(request));
        async move {
            let response = match answer {
                Some(answer) => answer.await,
                None => {
                    let mut refused =
                        respond(413, "text/plain", "expected a request without a body\n".into());
                    refused.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
                    refused
                }
            };
            // The answer counts as under way until its last frame is sent.
            Ok::<_, Infallible>(response.map(|body| {
                body.map_frame(move |frame| {
                    let _until_sent = &under_way;
                    frame
                })
            }))
        }
    });
    let stream = pin!(TokioIo::new(stream));
    let serve = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
        .max_headers(HEADER_FIELDS)
        .max_buf_size(HEADER_BYTES)
        .title_case_headers(true)
        .serve_connection(stream, service);
    // A client that disconnects, or does not send HTTP, is no error of the server.
    let _ = serve.await;
}

/// One answer under way on a connection; dropping it ends the count.
struct UnderWay(Arc<AtomicUsize>);

impl UnderWay {
    fn begin(answers: &Arc<AtomicUsize>) -> Self {
        answers.fetch_add(1, Ordering::AcqRel);
        Self(Arc::clone(answers))
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Whether a request only reads: GET, or HEAD, whose answer is sent without its body.
pub fn reads(request: &HttpRequest) -> bool {
    matches!(*request.method(), Method::GET | Method::HEAD)
}

/// Path of a request without query and trailing slash: `/` gives an empty text.
pub fn path(request: &HttpRequest) -> &str {
    let path = request.uri().path();
    path.strip_suffix('/').unwrap_or(path)
}

/// Value of a request header; `None` if it is absent, occurs more than once or is no text.
pub fn header(request: &HttpRequest, name: HeaderName) -> Option<&str> {
    let mut values = request.headers().get_all(name).iter();
    values.next().filter(|_| values.next().is_none())?.to_str().ok()
}

fn with_headers(status: u16, kind: &str, body: BoxBody<Bytes, Infallible>) -> HttpResponse {
    let mut response = hyper::Response::new(body);
    *response.status_mut() = StatusCode::from_u16(status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    for (name, value) in HEADERS.into_iter().chain([(header::CONTENT_TYPE, kind)]) {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// Builds a response with a text of the content type `kind` as its body.
pub fn respond(status: u16, kind: &str, body: String) -> HttpResponse {
    let length = body.len();
    let mut response = with_headers(status, kind, Full::new(Bytes::from(body)).boxed());
    response.headers_mut().insert(header::CONTENT_LENGTH, length.into());
    response
}

/// Builds a response that refuses the method of a request; `allowed`: the allowed methods, separated by commas.
pub fn refuse_method(kind: &str, body: String, allowed: &'static str) -> HttpResponse {
    let mut response = respond(405, kind, body);
    response.headers_mut().insert(header::ALLOW, HeaderValue::from_static(allowed));
    response
}

/// Builds a response that is an endless stream of server-sent events.
pub fn stream() -> (EventStream, HttpResponse) {
    let (events, body) = Channel::new(1);
    (EventStream(events), with_headers(200, EVENTS, body.boxed()))
}

/// Sender of the events of a stream; dropping it ends the stream.
pub struct EventStream(channel::Sender<Bytes>);

impl EventStream {
    /// Sends an event, once the previous event has been taken. Returns whether the client is still connected.
    pub async fn send(&mut self, event: &str) -> bool {
        self.0.send_data(Bytes::from(format!("data: {event}\n\n"))).await.is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::os::fd::AsRawFd;
    use tokio::sync::watch;

    /// HTTP server of a test; it ends when the test drops it.
    struct TestServer {
        address: SocketAddr,
        stop: Arc<AtomicBool>,
        server: HttpServer,
        /// Number of requests received.
        came: Arc<AtomicUsize>,
        /// Releases the answer to `/held`.
        release: watch::Sender<bool>,
    }

    impl TestServer {
        fn begin() -> (Self, TcpListener) {
            let listener = Listener::bind(([127, 0, 0, 1], 0).into()).expect("a free port");
            let (address, socket) = (listener.address, listener.socket.try_clone().expect("a copy"));
            let stop = Arc::new(AtomicBool::new(false));
            let came = Arc::new(AtomicUsize::new(0));
            let (release, held) = watch::channel(false);
            let counted = Arc::clone(&came);
            let server = listener.serve(&stop, move |request| {
                counted.fetch_add(1, Ordering::AcqRel);
                let mut held = held.clone();
                async move {
                    match path(&request) {
                        "/held" => drop(held.wait_for(|over| *over).await),
                        "/endless" => {
                            let (mut events, response) = stream();
                            tokio::spawn(async move { while events.send(&"x".repeat(1 << 16)).await {} });
                            return response;
                        }
                        _ => {}
                    }
                    respond(200, "text/plain", "done".into())
                }
            });
            (Self { address, stop, server, came, release }, socket)
        }

        /// Connects and sends a text.
        fn send(&self, text: &str) -> TcpStream {
            let mut stream = TcpStream::connect(self.address).expect("it listens");
            // If the server closed the connection at once, reading shows it.
            let _ = stream.write_all(text.as_bytes());
            stream
        }

        fn ask(&self, path: &str) -> TcpStream {
            self.send(&format!("GET {path} HTTP/1.1\r\nHost: robot\r\nConnection: close\r\n\r\n"))
        }

        fn wait_for(&self, requests: usize) {
            while self.came.load(Ordering::Acquire) < requests {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }

    impl Drop for TestServer {
        fn drop(&mut self) {
            self.stop.store(true, Ordering::Release);
            self.server.end().expect("it was asked to end");
        }
    }

    /// Status of the answer; `None` if the connection was closed without one.
    fn status(mut stream: TcpStream) -> Option<u16> {
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).split(' ').nth(1).map(|status| status.parse().expect("a number"))
    }

    #[test]
    fn bodies_and_large_headers_are_refused() {
        let (site, _) = TestServer::begin();
        for (length, expected) in
            [("99999999999999", 413), ("1", 413), ("18446744073709551616", 400), ("0", 200)]
        {
            let request = format!(
                "POST /x HTTP/1.1\r\nHost: robot\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
            );
            assert_eq!(status(site.send(&request)), Some(expected), "{length}");
        }
        let chunked = "POST /x HTTP/1.1\r\nHost: robot\r\nTransfer-Encoding: chunked\r\n\r\n";
        assert_eq!(status(site.send(chunked)), Some(413));
        let fields = "X: y\r\n".repeat(HEADER_FIELDS + 1);
        assert_eq!(status(site.send(&format!("GET / HTTP/1.1\r\n{fields}\r\n"))), Some(431));
        let field = "y".repeat(HEADER_BYTES);
        assert_ne!(status(site.send(&format!("GET / HTTP/1.1\r\nX: {field}\r\n\r\n"))), Some(200));
        assert_eq!(status(site.ask("/")), Some(200));
    }

    #[test]
    fn clients_that_never_finish_a_request_push_out_each_other() {
        let (site, _) = TestServer::begin();
        let half_open: Vec<_> = (0..CONNECTIONS + 20).map(|_| site.send("GET / HTTP/1.1\r\nX: ")).collect();
        assert_eq!(status(site.ask("/")), Some(200));
        // The oldest connections are closed, the newest stay open.
        half_open[..20].iter().for_each(|mut stream| assert!(!matches!(stream.read(&mut [0]), Ok(1..))));
    }

    #[test]
    fn clients_that_do_not_read_keep_no_other_waiting() {
        let (site, _) = TestServer::begin();
        let _deaf: Vec<_> = (0..32).map(|_| site.ask("/endless")).collect();
        site.wait_for(32);
        assert_eq!(status(site.ask("/")), Some(200));
    }

    #[test]
    fn what_is_being_answered_is_not_pushed_out() {
        let (site, _) = TestServer::begin();
        let held: Vec<_> = (0..CONNECTIONS).map(|_| site.ask("/held")).collect();
        site.wait_for(CONNECTIONS);
        assert_eq!(status(site.ask("/")), None);
        site.release.send_replace(true);
        assert!(held.into_iter().all(|stream| status(stream) == Some(200)));
        assert_eq!(status(site.ask("/")), Some(200));
    }

    #[test]
    fn the_end_of_a_listener_is_an_error() {
        let (mut site, socket) = TestServer::begin();
        assert_eq!(status(site.ask("/")), Some(200));
        site.server.check().expect("it listens");
        // SAFETY: plain system call on an open socket; it also affects the server's copies of the socket.
        assert_eq!(unsafe { libc::shutdown(socket.as_raw_fd(), libc::SHUT_RDWR) }, 0);
        let failure = loop {
            match site.server.check() {
                Ok(()) => std::thread::sleep(Duration::from_millis(1)),
                Err(e) => break e.to_string(),
            }
        };
        assert!(failure.contains(&site.address.to_string()), "{failure}");
    }
}
