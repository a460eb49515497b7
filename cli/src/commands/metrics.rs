//! `upswing metrics`: exports the metrics of a running system for Prometheus.

use super::{CommonArgs, print_json, print_line, writable};
use serde::Serialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_view::http::{self, HttpRequest, HttpResponse, HttpServer, Listener};
use upswing_view::live::Live;
use upswing_view::metrics::{self, CONTENT_TYPE};

/// Pause between two reads of telemetry, whose buffer holds two seconds.
const PAUSE: Duration = Duration::from_millis(20);
const TEXT: &str = "text/plain; charset=utf-8";
/// Largest age of the values in an answer to a scrape.
const FRESH: Duration = Duration::from_millis(200);

/// Exports the values of the monitor as OpenMetrics: once, over HTTP, or as a file; units s, rad, N m.
///
/// Without --listen and --file the metrics are printed once. docs/grafana.json is a Grafana dashboard.
///
/// Example: upswing metrics --listen 127.0.0.1:9464
#[derive(Clone, Debug, clap::Args)]
pub struct MetricsArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Serve GET /metrics at this address until Ctrl-C
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<SocketAddr>,
    /// Update this file until Ctrl-C, for node_exporter's textfile collector; it is removed at the end
    #[arg(long, value_name = "FILE.prom")]
    pub file: Option<Destination>,
    /// Time between two updates of the file, s, 0.1 to 3600
    #[arg(long, value_name = "S", default_value_t = 5.0, requires = "file", value_parser = within(0.1, 3600.0))]
    pub every: f64,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct MetricsResult {
    metrics: Vec<metrics::MetricFamily>,
}

#[derive(Serialize)]
struct MetricsStarted {
    url: Option<String>,
    file: Option<PathBuf>,
}

impl std::fmt::Display for MetricsStarted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let file = self.file.as_ref().map(|file| file.display().to_string());
        let places: Vec<_> = self.url.iter().cloned().chain(file).collect();
        write!(f, "metrics at {}; Ctrl-C ends them", places.join(" and "))
    }
}

/// Exports the metrics until Ctrl-C, or prints them once.
///
/// # Errors
/// [`Failure::BadInput`] for an unusable address or file, [`Failure::Failed`] if the file cannot be updated
/// any more.
pub fn run(args: &MetricsArgs) -> Result<(), Failure> {
    if let Some(file) = args.file.as_deref().filter(|f| f.extension().is_none_or(|e| e != "prom")) {
        let got = file.display();
        return Err(Failure::BadInput(format!("--file: expected a name that ends in .prom, got {got}")));
    }
    let file = writable("--file", args.file.as_ref(), args.overwrite)?;
    let config = args.common.process.load()?;
    if args.listen.is_none() && args.file.is_none() {
        let mut live = Live::open(&args.common.join()?, &config).map_err(Failure::failed)?;
        live.settle().map_err(Failure::failed)?;
        let metrics = metrics::families(&live.view());
        return if args.common.json {
            print_json(&MetricsResult { metrics })
        } else {
            print_line(&metrics::text(&metrics).trim_end())
        };
    }
    let stop = shutdown_flag()?;
    let listener = args.listen.map(Listener::bind).transpose();
    let listener = listener.map_err(|e| Failure::BadInput(format!("--listen: {e}")))?;
    let mut live = Live::open(&args.common.join()?, &config).map_err(Failure::failed)?;
    live.settle().map_err(Failure::failed)?;
    let text = |live: &Live| metrics::text(&metrics::families(&live.view()));
    if let Some(file) = &file {
        file.write(text(&live).as_bytes()).map_err(|e| Failure::BadInput(format!("--file: {e}")))?;
    }
    // The file now belongs to this process, which may overwrite it.
    let file = file.map(|file| Overwrite { force: true }.output(file.path()));
    let newest = Arc::new(Mutex::new(text(&live)));
    args.common.print(&MetricsStarted {
        url: listener.as_ref().map(|l| format!("http://{}/metrics", l.address)),
        file: args.file.as_deref().map(Path::to_path_buf),
    })?;
    let mut server = listener.map(|listener| {
        let newest = Arc::clone(&newest);
        listener.serve(&stop, move |request| std::future::ready(answer(&request, &newest)))
    });
    let every = Duration::from_secs_f64(args.every);
    let (mut shown, mut written) = (Instant::now(), Instant::now());
    let mut watch = || -> Result<(), Failure> {
        while !stop.load(Ordering::Acquire) {
            if let Some(server) = &mut server {
                server.check().map_err(Failure::failed)?;
            }
            live.poll(|_| ()).map_err(Failure::failed)?;
            if shown.elapsed() >= FRESH {
                *newest.lock().unwrap_or_else(PoisonError::into_inner) = text(&live);
                shown = Instant::now();
            }
            if let Some(file) = file.as_ref().filter(|_| written.elapsed() >= every) {
                file.write(text(&live).as_bytes()).map_err(Failure::failed)?;
                written = Instant::now();
            }
            std::thread::sleep(PAUSE);
        }
        Ok(())
    };
    let result = watch();
    stop.store(true, Ordering::Release);
    let ended = server.as_mut().map_or(Ok(()), HttpServer::end).map_err(Failure::failed);
    // The file is removed: values without updates would look like a system that stands still.
    if let Some(file) = &file {
        let _ = std::fs::remove_file(file.path());
    }
    result.and(ended)
}

fn answer(request: &HttpRequest, newest: &Mutex<String>) -> HttpResponse {
    match (http::reads(request), http::path(request)) {
        (true, "/metrics") => {
            http::respond(200, CONTENT_TYPE, newest.lock().unwrap_or_else(PoisonError::into_inner).clone())
        }
        (true, _) => http::respond(404, TEXT, "expected /metrics\n".into()),
        (false, _) => http::refuse_method(TEXT, "expected GET\n".into(), "GET, HEAD"),
    }
}
