//! The little of HTTP that page and metrics need.

use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tiny_http::{Header, Request, Response, Server};

/// Requests that are answered at a time. As many again are told to come back later, all others wait.
const MOST: usize = 64;
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
        // Each thread holds it: its owners but this one are the requests that are being answered.
        let answer = Arc::new(answer);
        while !stop.load(Ordering::Acquire) {
            let busy = || Arc::strong_count(&answer) - 1;
            if busy() >= 2 * MOST {
                std::thread::sleep(PAUSE);
                continue;
            }
            match self.server.recv_timeout(PAUSE) {
                Ok(Some(request)) => {
                    let (full, answer) = (busy() >= MOST, Arc::clone(&answer));
                    // A client that reads or writes slowly keeps only itself waiting, with a refusal, too.
                    let work = move || match full {
                        false => answer(request),
                        true => respond(request, 503, "text/plain", "too many requests at a time\n".into()),
                    };
                    if let Err(e) = std::thread::Builder::new().spawn(work) {
                        tracing::warn!("no thread to answer a request: {e}");
                    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader};
    use std::net::TcpStream;
    use std::sync::atomic::AtomicUsize;

    /// Makes a request.
    fn ask(address: SocketAddr) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(address).expect("it listens");
        stream.write_all(b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n").expect("sent");
        BufReader::new(stream)
    }

    /// The status of the answer.
    fn status(stream: &mut BufReader<TcpStream>) -> String {
        let mut line = String::new();
        stream.read_line(&mut line).expect("an answer");
        line.split(' ').nth(1).expect("a status").to_owned()
    }

    #[test]
    fn many_requests_at_a_time_are_refused_and_the_next_ones_answered() {
        let listener = Listener::bind(([127, 0, 0, 1], 0).into()).expect("a free port");
        let address = listener.address;
        let [stop, over] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let held = Arc::new(AtomicUsize::new(0));
        let (stopped, ended, holds) = (Arc::clone(&stop), Arc::clone(&over), Arc::clone(&held));
        let server = std::thread::spawn(move || {
            listener.serve(&stopped, move |request| {
                holds.fetch_add(1, Ordering::AcqRel);
                while !ended.load(Ordering::Acquire) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                respond(request, 200, "text/plain", "done".into());
            });
        });
        let hold = |i| {
            let stream = ask(address);
            while held.load(Ordering::Acquire) == i {
                std::thread::sleep(Duration::from_millis(1));
            }
            stream
        };
        let mut streams: Vec<_> = (0..MOST).map(hold).collect();
        assert_eq!(status(&mut ask(address)), "503");
        over.store(true, Ordering::Release);
        assert!(streams.iter_mut().all(|stream| status(stream) == "200"));
        assert_eq!(status(&mut ask(address)), "200");
        stop.store(true, Ordering::Release);
        server.join().expect("it ends");
    }
}
