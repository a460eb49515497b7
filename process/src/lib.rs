//! Common functions of all programs: command-line options, logging, the shutdown flag, exit codes, notifications to the service
//! manager, output files and shards.

pub mod notify;
pub mod number;
pub mod output;
pub mod shard;

use clap::builder::{OsStringValueParser, TypedValueParser as _};
use std::fmt::Display;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{Format, FormatEvent, FormatFields, Full, Writer};
use tracing_subscriber::registry::LookupSpan;
use upswing_config::{Config, ConfigError, System};

/// Options of every process.
#[derive(Clone, Debug, clap::Args)]
pub struct ProcessArgs {
    /// Robot with its settings and manoeuvres: name of a shipped system, or folder of another one (`upswing config export DIR` writes one)
    #[arg(long, value_name = "NAME|DIR", default_value_t, value_parser = OsStringValueParser::new().try_map(System::try_from))]
    pub system: System,
    /// Domain: daemon, planner, plant and clients with the same name share memory
    #[arg(long, value_name = "NAME", default_value = "upswing")]
    pub domain: String,
}

impl ProcessArgs {
    /// Reads the settings of the system.
    ///
    /// # Errors
    /// [`Failure::BadInput`] with the message of the [`ConfigError`].
    pub fn load(&self) -> Result<Config, Failure> {
        Ok(Config::load(&self.system)?)
    }
}

/// Failure of a process; determines its exit code.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// An input (command line, file, request) cannot be used: exit code 2.
    #[error("{0}")]
    BadInput(String),
    /// The program ran, but its result is negative: exit code 1.
    #[error("{0}")]
    Failed(String),
}

impl From<ConfigError> for Failure {
    fn from(e: ConfigError) -> Self {
        Self::bad_input(e)
    }
}

impl Failure {
    /// [`Failure::BadInput`] with the message of an error.
    pub fn bad_input(e: impl Display) -> Self {
        Self::BadInput(e.to_string())
    }

    /// [`Failure::Failed`] with the message of an error.
    pub fn failed(e: impl Display) -> Self {
        Self::Failed(e.to_string())
    }

    /// Exit code of the process.
    pub fn code(&self) -> u8 {
        match self {
            Self::Failed(_) => 1,
            Self::BadInput(_) => 2,
        }
    }
}

/// Ends `main`: prints the failure as one line on stderr and returns the exit code (0, 1 or 2).
pub fn finish(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let level = if stderr_is_journal() { "<3>" } else { "" };
            note(&format!("{level}error: {failure}"));
            ExitCode::from(failure.code())
        }
    }
}

/// Writes a line on stderr; errors are ignored, because they could be reported on stderr only.
pub fn note(line: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Whether to write colours to `stream`: a terminal, and NO_COLOR (<https://no-color.org>) is not set.
pub fn colours(stream: &impl std::io::IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Sends logs to stderr, one line each, from level `info` on or by the filter in RUST_LOG (invalid parts of it are reported
/// on stderr and ignored). If journald reads stderr, lines begin with its levels.
pub fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::builder()
        .with_default_directive(tracing_subscriber::filter::LevelFilter::INFO.into())
        .from_env_lossy();
    // Without internal errors: the logger would report an unwritable stderr on stderr, and panic.
    let logger = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .log_internal_errors(false);
    // A second call (several roles in one test process) leaves the first logger in place.
    let _ = if stderr_is_journal() {
        logger.with_ansi(false).event_format(JournalFormat::default()).try_init()
    } else {
        logger.with_ansi(colours(&std::io::stderr())).with_target(false).try_init()
    };
}

/// Whether stderr is the stream that systemd connected to journald, systemd.exec(5); it may have been redirected since.
fn stderr_is_journal() -> bool {
    use std::os::unix::fs::MetadataExt;
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    std::fs::metadata("/proc/self/fd/2").is_ok_and(|fd| stream == format!("{}:{}", fd.dev(), fd.ino()))
}

/// Format of log lines for journald: each begins with its level as in sd-daemon(3); journald adds the time.
struct JournalFormat(Format<Full, ()>);

impl Default for JournalFormat {
    fn default() -> Self {
        Self(Format::default().without_time().with_level(false).with_target(false))
    }
}

impl<S, N> FormatEvent<S, N> for JournalFormat
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut line: Writer<'_>,
        event: &Event<'_>,
    ) -> std::fmt::Result {
        let priority = match *event.metadata().level() {
            Level::ERROR => 3,
            Level::WARN => 4,
            Level::INFO => 6,
            _ => 7,
        };
        write!(line, "<{priority}>")?;
        self.0.format_event(context, line, event)
    }
}

/// Installs handlers of SIGINT, SIGTERM and SIGHUP, and returns the flag that they raise.
///
/// # Errors
/// [`Failure::Failed`] if a handler is already installed.
pub fn shutdown_flag() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&flag);
    ctrlc::set_handler(move || raised.store(true, Ordering::Release))
        .map_err(|e| Failure::Failed(format!("cannot install a signal handler: {e}")))?;
    Ok(flag)
}
