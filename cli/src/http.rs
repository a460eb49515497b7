//! The little of HTTP that page and metrics need.

use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tiny_http::{Header, Request, Response, Server};

/// How often to look whether to end.
const PAUSE: Duration = Duration::from_millis(100);

/// Sent with every answer: nothing is cached, framed, guessed or told to other sites.
const HEADERS: [(&str, &str); 5] = [
    ("Cache-Control", "no-store"),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    (
        "Content-Security-Policy",
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; \
         frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    ),
];

/// The address cannot be listened to.
#[derive(Debug, thiserror::Error)]
#[error("cannot listen at {address}: {cause}; choose a free port of this machine, for example 127.0.0.1:0")]
pub struct ListenError {
    address: SocketAddr,
    cause: String,
}

/// A socket that listens.
pub struct Listener {
    server: Server,
    /// Where it listens, with the port that the system chose for port 0.
    pub address: SocketAddr,
}

impl Listener {
    /// Listens at `address`.
    ///
    /// # Errors
    /// [`ListenError`]
    pub fn bind(address: SocketAddr) -> Result<Self, ListenError> {
        let failed = |cause: String| ListenError { address, cause };
        let server = Server::http(address).map_err(|e| failed(e.to_string()))?;
        let bound = server.server_addr().to_ip().ok_or_else(|| failed("no IP address".into()))?;
        Ok(Self { server, address: bound })
    }

    /// Answers requests, each in a thread of its own, until `stop` is raised.
    pub fn serve(&self, stop: &AtomicBool, answer: impl Fn(Request) + Send + Sync + 'static) {
        let answer = Arc::new(answer);
        while !stop.load(Ordering::Acquire) {
            match self.server.recv_timeout(PAUSE) {
                Ok(Some(request)) => {
                    let answer = Arc::clone(&answer);
                    // A client that reads or writes slowly keeps only itself waiting.
                    std::thread::spawn(move || answer(request));
                }
                Ok(None) => {}
                Err(e) => {
                    tracing::warn!("cannot take a connection: {e}");
                    std::thread::sleep(PAUSE);
                }
            }
        }
    }
}

/// Value of a header of a request; `None`, too, if it comes more than once.
pub fn header<'a>(request: &'a Request, name: &'static str) -> Option<&'a str> {
    let mut values = request.headers().iter().filter(|h| h.field.equiv(name)).map(|h| h.value.as_str());
    values.next().filter(|_| values.next().is_none())
}

/// Answers with a text. A client that has gone away is no error.
pub fn respond(request: Request, status: u16, kind: &str, body: String) {
    let mut response = Response::from_string(body).with_status_code(status);
    // The default of `from_string` gives way.
    for (name, value) in HEADERS.into_iter().chain([("Content-Type", kind)]) {
        if let Ok(header) = Header::from_bytes(name, value) {
            response.add_header(header);
        }
    }
    let _ = request.respond(response);
}

/// Answers with an endless stream of server-sent events: each text that `next` gives is one event. Ends with `next`,
/// or when the client goes away.
pub fn stream(request: Request, mut next: impl FnMut() -> Option<String>) {
    let mut to = request.into_writer();
    let mut head =
        String::from("HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nConnection: close\r\n");
    for (name, value) in HEADERS {
        head.push_str(&format!("{name}: {value}\r\n"));
    }
    head.push_str("\r\n");
    let mut send = |text: &str| to.write_all(text.as_bytes()).and_then(|()| to.flush());
    let mut sent = send(&head);
    while let (Ok(()), Some(event)) = (&sent, next()) {
        sent = send(&format!("data: {event}\n\n"));
    }
}
