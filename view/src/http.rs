//! HTTP/1.1 for the monitor's page and the metrics. Clients are not trusted: what one of them sends, withholds or does
//! not read costs bounded memory and time, and keeps no other waiting.

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

/// Connections at a time; fewer where the process may open few files.
const CONNECTIONS: usize = 128;
/// Share of the files of the process that connections may take.
const FILES: f64 = 0.25;
/// Longest wait for a complete header, also between two requests of a connection.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time in which a client takes nothing of an answer.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);
/// Bytes and fields of a header.
const HEADER_BYTES: usize = 16 << 10;
const HEADER_FIELDS: usize = 64;
/// Threads for answers that block.
const BLOCKING: usize = 16;
/// How often to look whether to end.
const PAUSE: Duration = Duration::from_millis(100);

/// Sent with every answer: nothing is cached, framed, guessed or told to other sites.
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

/// Type of a stream of events.
pub const EVENTS: &str = "text/event-stream";

/// A request. None has a body: those with one are refused before they get here.
pub type Request = hyper::Request<Incoming>;
/// An answer.
pub type Response = hyper::Response<BoxBody<Bytes, Infallible>>;

/// The address cannot be listened to.
#[derive(Debug, thiserror::Error)]
#[error("cannot listen at {address}: {cause}; choose a free port of this machine, for example 127.0.0.1:0")]
pub struct ListenError {
    address: SocketAddr,
    cause: io::Error,
}

/// Connections are accepted no more.
#[derive(Debug, thiserror::Error)]
#[error("the listener at {address} has failed: {cause}; start it again")]
pub struct ServeError {
    address: SocketAddr,
    cause: io::Error,
}

/// A socket that listens.
pub struct Listener {
    socket: TcpListener,
    /// Where it listens, with the port that the system chose for port 0.
    pub address: SocketAddr,
}

impl Listener {
    /// Listens at `address`.
    ///
    /// # Errors
    /// [`ListenError`]
    pub fn bind(address: SocketAddr) -> Result<Self, ListenError> {
        let bind = || {
            let socket = TcpListener::bind(address)?;
            socket.set_nonblocking(true)?;
            let address = socket.local_addr()?;
            Ok(Self { socket, address })
        };
        bind().map_err(|cause| ListenError { address, cause })
    }

    /// Answers requests in a thread of its own until `stop` is raised. `answer` runs in that thread and must not block it.
    pub fn serve<F>(
        self,
        stop: &Arc<AtomicBool>,
        answer: impl Fn(Request) -> F + Send + Sync + 'static,
    ) -> Server
    where
        F: Future<Output = Response> + Send + 'static,
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
                // Connections end with it; a thread that waits for an operator's request is left behind.
                runtime.shutdown_background();
                served
            });
            served.map_err(|cause| ServeError { address, cause })
        };
        Server { thread: Some(std::thread::spawn(serve)), address }
    }
}

/// The thread that answers.
pub struct Server {
    thread: Option<std::thread::JoinHandle<Result<(), ServeError>>>,
    address: SocketAddr,
}

impl Server {
    /// Whether it still answers.
    ///
    /// # Errors
    /// [`ServeError`] if it has ended without being asked to.
    pub fn check(&mut self) -> Result<(), ServeError> {
        if self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Ok(());
        }
        self.end()
    }

    /// Waits for its end, once `stop` is raised.
    ///
    /// # Errors
    /// [`ServeError`] if that is not why it ended.
    pub fn end(&mut self) -> Result<(), ServeError> {
        let died =
            |_| Err(ServeError { address: self.address, cause: io::Error::other("its thread panicked") });
        self.thread.take().map_or(Ok(()), |thread| thread.join().unwrap_or_else(died))
    }
}

/// Connections, oldest first.
struct Connections {
    open: VecDeque<Connection>,
    most: usize,
}

struct Connection {
    task: AbortHandle,
    /// Answers under way.
    answers: Arc<AtomicUsize>,
}

impl Connections {
    /// Makes room for one more: of those that wait for a request the oldest has to go. Clients that begin a request and never
    /// finish it push out each other, and whoever asks at once is answered.
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
    answer: Arc<impl Fn(Request) -> F + Send + Sync + 'static>,
) -> io::Result<()>
where
    F: Future<Output = Response> + Send + 'static,
{
    let socket = tokio::net::TcpListener::from_std(socket)?;
    let most = CONNECTIONS.min((FILES * files() as f64) as usize).max(1);
    let mut connections = Connections { open: VecDeque::new(), most };
    while !stop.load(Ordering::Acquire) {
        match tokio::time::timeout(PAUSE, socket.accept()).await {
            Err(_) => {}
            Ok(Ok((stream, _))) => {
                // Without room, and all others being answered, it is closed.
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

/// Errors of a connection before it was accepted, accept(2).
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

/// Too few files or too little memory, which pass.
fn is_shortage(e: &io::Error) -> bool {
    const SHORTAGE: [i32; 4] = [libc::EMFILE, libc::ENFILE, libc::ENOBUFS, libc::ENOMEM];
    e.raw_os_error().is_some_and(|code| SHORTAGE.contains(&code))
}

/// Files that the process may open.
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
    answer: Arc<impl Fn(Request) -> F + Send + Sync + 'static>,
) where
    F: Future<Output = Response> + Send + 'static,
{
    // Small events go out at once; without it they are only later.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let service = hyper::service::service_fn(|request: Request| {
        let under_way = UnderWay::begin(&answers);
        // Nothing here takes one, so that none is waited for.
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
            // The answer is under way as long as there is something to send.
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
    // A client that goes away, or sends something else than HTTP, is no error of ours.
    let _ = serve.await;
}

/// One of the answers of a connection.
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

/// Whether a request reads: GET, or HEAD, whose answer is sent without its body.
pub fn reads(request: &Request) -> bool {
    matches!(*request.method(), Method::GET | Method::HEAD)
}

/// Path of a request, without query and the slash at its end: `/` is empty.
pub fn path(request: &Request) -> &str {
    let path = request.uri().path();
    path.strip_suffix('/').unwrap_or(path)
}

/// Value of a header of a request; `None`, too, if it comes more than once.
pub fn header(request: &Request, name: HeaderName) -> Option<&str> {
    let mut values = request.headers().get_all(name).iter();
    values.next().filter(|_| values.next().is_none())?.to_str().ok()
}

fn with_headers(status: u16, kind: &str, body: BoxBody<Bytes, Infallible>) -> Response {
    let mut response = hyper::Response::new(body);
    *response.status_mut() = StatusCode::from_u16(status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    for (name, value) in HEADERS.into_iter().chain([(header::CONTENT_TYPE, kind)]) {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// A text.
pub fn respond(status: u16, kind: &str, body: String) -> Response {
    let length = body.len();
    let mut response = with_headers(status, kind, Full::new(Bytes::from(body)).boxed());
    response.headers_mut().insert(header::CONTENT_LENGTH, length.into());
    response
}

/// Refuses a method: `allowed` are those that are not, with commas between them.
pub fn refuse_method(kind: &str, body: String, allowed: &'static str) -> Response {
    let mut response = respond(405, kind, body);
    response.headers_mut().insert(header::ALLOW, HeaderValue::from_static(allowed));
    response
}

/// An endless stream of server-sent events.
pub fn stream() -> (Events, Response) {
    let (events, body) = Channel::new(1);
    (Events(events), with_headers(200, EVENTS, body.boxed()))
}

/// Where the events of a stream go; the stream ends with it.
pub struct Events(channel::Sender<Bytes>);

impl Events {
    /// Sends an event, as soon as the one before it has been taken; whether the client is still there, and reads.
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

    /// Ends with the test.
    struct Site {
        address: SocketAddr,
        stop: Arc<AtomicBool>,
        server: Server,
        /// Requests that have come.
        came: Arc<AtomicUsize>,
        /// Lets `/held` be answered.
        release: watch::Sender<bool>,
    }

    impl Site {
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

        /// Sends a text.
        fn send(&self, text: &str) -> TcpStream {
            let mut stream = TcpStream::connect(self.address).expect("it listens");
            // One that was closed at once is found when it is read.
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

    impl Drop for Site {
        fn drop(&mut self) {
            self.stop.store(true, Ordering::Release);
            self.server.end().expect("it was asked to end");
        }
    }

    /// The status of the answer; `None`: it was closed.
    fn status(mut stream: TcpStream) -> Option<u16> {
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).split(' ').nth(1).map(|status| status.parse().expect("a number"))
    }

    #[test]
    fn bodies_and_large_headers_are_refused() {
        let (site, _) = Site::begin();
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
        let (site, _) = Site::begin();
        let half_open: Vec<_> = (0..CONNECTIONS + 20).map(|_| site.send("GET / HTTP/1.1\r\nX: ")).collect();
        assert_eq!(status(site.ask("/")), Some(200));
        // The oldest are closed, the newest wait.
        half_open[..20].iter().for_each(|mut stream| assert!(!matches!(stream.read(&mut [0]), Ok(1..))));
    }

    #[test]
    fn clients_that_do_not_read_keep_no_other_waiting() {
        let (site, _) = Site::begin();
        let _deaf: Vec<_> = (0..32).map(|_| site.ask("/endless")).collect();
        site.wait_for(32);
        assert_eq!(status(site.ask("/")), Some(200));
    }

    #[test]
    fn what_is_being_answered_is_not_pushed_out() {
        let (site, _) = Site::begin();
        let held: Vec<_> = (0..CONNECTIONS).map(|_| site.ask("/held")).collect();
        site.wait_for(CONNECTIONS);
        assert_eq!(status(site.ask("/")), None);
        site.release.send_replace(true);
        assert!(held.into_iter().all(|stream| status(stream) == Some(200)));
        assert_eq!(status(site.ask("/")), Some(200));
    }

    #[test]
    fn the_end_of_a_listener_is_an_error() {
        let (mut site, socket) = Site::begin();
        assert_eq!(status(site.ask("/")), Some(200));
        site.server.check().expect("it listens");
        // SAFETY: plain system call on an open socket; its copies in the server are affected, too.
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
