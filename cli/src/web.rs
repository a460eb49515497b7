//! The monitor as a page: [`crate::live::View`]s and the motion between them, as server-sent events.

mod feed;
mod guard;

pub use guard::{Head, Refusal, Token, check};

use crate::http::{self, Listener};
use crate::live::{Asker, Live};
use crate::operator::Action;
use crate::page;
use feed::{Feed, Sampler};
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tiny_http::{Method, Request};
use upswing_ipc::IpcError;

/// Time between two events.
const FRAME: Duration = Duration::from_millis(40);
/// Pause between two looks for telemetry.
const PAUSE: Duration = Duration::from_millis(5);
/// Pages that can be open at a time; each keeps a thread busy.
const PAGES: usize = 16;
/// Longest wait for the answer to a request of an operator: those of planner and daemon, one after the other.
const PATIENCE: Duration = Duration::from_secs(30);

const HTML: &str = "text/html; charset=utf-8";
const JSON: &str = "application/json";

struct Site {
    page: String,
    feed: Feed,
    token: Option<Token>,
    asker: Asker,
    open: AtomicUsize,
}

#[derive(Serialize)]
struct No {
    success: bool,
    error: String,
}

/// Serves the page `setup` describes until `stop` is raised. Only who has the `token` can make requests.
///
/// # Errors
/// [`IpcError`] if the system cannot be watched any more.
pub fn run(
    live: &mut Live,
    listener: Listener,
    setup: &page::Setup,
    token: Option<Token>,
    stop: &Arc<AtomicBool>,
) -> Result<(), IpcError> {
    let site = Arc::new(Site {
        page: page::live(setup),
        feed: Feed::default(),
        token,
        asker: live.asker(),
        open: AtomicUsize::new(0),
    });
    let (served, ends) = (Arc::clone(&site), Arc::clone(stop));
    let server = std::thread::spawn(move || listener.serve(&ends, move |request| served.answer(request)));
    let mut sampler = Sampler::default();
    let mut next = Instant::now();
    let mut result = Ok(());
    while !stop.load(Ordering::Acquire) && result.is_ok() {
        result = live.poll(|record| sampler.take(record));
        if next <= Instant::now() {
            site.feed.push(sampler.frame(live.view()));
            next = Instant::now() + FRAME;
        }
        std::thread::sleep(PAUSE);
    }
    stop.store(true, Ordering::Release);
    site.feed.close();
    let _ = server.join();
    result
}

impl Site {
    fn answer(&self, request: Request) {
        let url = request.url().to_owned();
        let head = Head {
            post: *request.method() == Method::Post,
            get: *request.method() == Method::Get,
            host: http::header(&request, "Host"),
            origin: http::header(&request, "Origin"),
            authorization: http::header(&request, "Authorization"),
        };
        if let Err(refusal) = check(&head, self.token.as_ref()) {
            return refuse(request, refusal.status, refusal.why.into());
        }
        match (head.get, url.as_str()) {
            (true, "/") => http::respond(request, 200, HTML, self.page.clone()),
            (true, "/events") => self.stream(request),
            (false, path) => match path.strip_prefix("/request/").and_then(Action::from_name) {
                Some(action) => self.ask(request, action),
                None => refuse(request, 404, format!("expected /request/ and one of {}", names())),
            },
            _ => refuse(request, 404, "expected / or /events".into()),
        }
    }

    fn stream(&self, request: Request) {
        if self.open.fetch_add(1, Ordering::AcqRel) < PAGES {
            let mut reader = self.feed.reader();
            http::stream(request, || reader.next());
        } else {
            refuse(request, 503, format!("{PAGES} pages are open already; close one"));
        }
        self.open.fetch_sub(1, Ordering::AcqRel);
    }

    fn ask(&self, request: Request, action: Action) {
        match self.asker.ask(action).recv_timeout(PATIENCE) {
            Ok(Ok(accepted)) => http::respond(request, 200, JSON, json(&accepted)),
            Ok(Err(why)) => refuse(request, 409, why),
            Err(_) => refuse(request, 504, "no answer; see the events on the page".into()),
        }
    }
}

fn names() -> String {
    Action::ALL.map(Action::name).join(", ")
}

fn refuse(request: Request, status: u16, error: String) {
    http::respond(request, status, JSON, json(&No { success: false, error }));
}

fn json(value: &impl Serialize) -> String {
    // What is sent has no maps with keys that are not texts.
    serde_json::to_string(value).unwrap_or_default()
}
