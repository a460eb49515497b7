//! Serves the monitor as a web page: [`crate::live::View`]s and the motion between them, as server-sent events.

mod frames;
mod guard;

pub use guard::{HttpRefusal, RequestHead, Token, check};

use crate::http::{self, HttpRequest, HttpResponse, Listener, ServeError};
use crate::live::{Live, RequestSender};
use crate::page;
use frames::{FrameBuffer, MotionSampler};
use hyper::Method;
use hyper::header::{AUTHORIZATION, HOST, ORIGIN};
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use upswing_ipc::IpcError;
use upswing_ipc::operator::OperatorRequest;

/// Period of the server-sent events.
const FRAME: Duration = Duration::from_millis(40);
/// Pause between two reads of the telemetry.
const PAUSE: Duration = Duration::from_millis(5);
/// Most pages that are open at a time.
const PAGES: usize = 16;
/// Longest wait for the answer to an operator's request: the time limits of planner and daemon, one after the other.
const PATIENCE: Duration = Duration::from_secs(30);

const HTML: &str = "text/html; charset=utf-8";
const JSON: &str = "application/json";

struct LivePage {
    page: String,
    frames: Arc<FrameBuffer>,
    token: Option<Token>,
    /// The requests that the page offers; no other is sent.
    offered: Vec<OperatorRequest>,
    requests: RequestSender,
    open: AtomicUsize,
}

#[derive(Serialize)]
struct ErrorDocument {
    success: bool,
    error: String,
}

impl ErrorDocument {
    fn because(error: String) -> Self {
        Self { success: false, error }
    }
}

/// Error that ends the serving of the page.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The server cannot accept connections any more.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The telemetry and status of the system cannot be read any more.
    #[error(transparent)]
    Ipc(#[from] IpcError),
}

/// Serves the page that `setup` describes until `stop` is set. A request needs the `token`; without a token the page is read-only.
///
/// # Errors
/// [`WebError`]
pub fn run(
    live: &mut Live,
    listener: Listener,
    setup: &page::LivePageSetup,
    token: Option<Token>,
    stop: &Arc<AtomicBool>,
) -> Result<(), WebError> {
    let site = Arc::new(LivePage {
        page: page::live(setup),
        frames: FrameBuffer::new(),
        token,
        offered: setup.requests().to_vec(),
        requests: live.request_sender(),
        open: AtomicUsize::new(0),
    });
    let served = Arc::clone(&site);
    let mut server = listener.serve(stop, move |request| Arc::clone(&served).answer(request));
    let mut sampler = MotionSampler::new(setup.sizes());
    let mut next = Instant::now();
    let mut watch = || -> Result<(), WebError> {
        while !stop.load(Ordering::Acquire) {
            server.check()?;
            live.poll(|record| sampler.take(record))?;
            if next <= Instant::now() {
                site.frames.push(sampler.frame(live.view()));
                next = Instant::now() + FRAME;
            }
            std::thread::sleep(PAUSE);
        }
        Ok(())
    };
    let result = watch();
    stop.store(true, Ordering::Release);
    result.and(Ok(server.end()?))
}

impl LivePage {
    async fn answer(self: Arc<Self>, request: HttpRequest) -> HttpResponse {
        let head = RequestHead {
            post: *request.method() == Method::POST,
            get: http::reads(&request),
            host: http::header(&request, HOST),
            origin: http::header(&request, ORIGIN),
            authorization: http::header(&request, AUTHORIZATION),
        };
        match check(&head, self.token.as_ref()) {
            Ok(()) => {}
            Err(HttpRefusal { status: 405, why }) => {
                return http::refuse_method(
                    JSON,
                    json(&ErrorDocument::because(why.into())),
                    "GET, HEAD, POST",
                );
            }
            Err(refusal) => return refuse(refusal.status, refusal.why.into()),
        }
        match (head.get, http::path(&request)) {
            (true, "") => http::respond(200, HTML, self.page.clone()),
            // A HEAD request gets no events: it must not occupy the place of a page.
            (true, "/events") if *request.method() == Method::HEAD => {
                http::respond(200, http::EVENTS, String::new())
            }
            (true, "/events") => self.stream(),
            (false, path) => {
                let name = path.strip_prefix("/request/");
                match self.offered.iter().find(|request| Some(request.name()) == name) {
                    Some(request) => self.ask(*request).await,
                    None => {
                        let names: Vec<_> = self.offered.iter().map(OperatorRequest::name).collect();
                        refuse(404, format!("expected /request/ and one of {}", names.join(", ")))
                    }
                }
            }
            _ => refuse(404, "expected / or /events".into()),
        }
    }

    fn stream(self: Arc<Self>) -> HttpResponse {
        let Some(page) = OpenPage::open(&self) else {
            return refuse(503, format!("{PAGES} pages are open already; close one"));
        };
        let mut reader = self.frames.reader();
        let (mut events, response) = http::stream();
        tokio::spawn(async move {
            let _open = page;
            while let Some(frame) = reader.next().await
                && events.send(&frame).await
            {}
        });
        response
    }

    async fn ask(&self, request: OperatorRequest) -> HttpResponse {
        let answer = self.requests.ask(request);
        match tokio::task::spawn_blocking(move || answer.recv_timeout(PATIENCE)).await {
            Ok(Ok(Ok(accepted))) => http::respond(200, JSON, json(&accepted)),
            Ok(Ok(Err(why))) => refuse(409, why.to_string()),
            _ => refuse(504, "no answer; see the events on the page".into()),
        }
    }
}

/// Place of one open page; dropping it frees the place.
struct OpenPage(Arc<LivePage>);

impl OpenPage {
    fn open(site: &Arc<LivePage>) -> Option<Self> {
        let page = Self(Arc::clone(site));
        (site.open.fetch_add(1, Ordering::AcqRel) < PAGES).then_some(page)
    }
}

impl Drop for OpenPage {
    fn drop(&mut self) {
        self.0.open.fetch_sub(1, Ordering::AcqRel);
    }
}

fn refuse(status: u16, error: String) -> HttpResponse {
    http::respond(status, JSON, json(&ErrorDocument::because(error)))
}

fn json(value: &impl Serialize) -> String {
    // Serialization cannot fail: no value sent here has a map whose keys are not strings.
    serde_json::to_string(value).unwrap_or_default()
}
