//! Progress bars with an estimate of the remaining time; without a terminal on stderr, nothing is drawn.

use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;

/// A progress bar for counted items.
pub(super) fn progress_bar(length: u64, what: &str) -> ProgressBar {
    styled(ProgressBar::new(length), &format!("{{bar:40}} {{human_pos}}/{{human_len}} {what}, {{eta}} left"))
}

/// A progress bar for time, in ms.
pub(super) fn time_bar(seconds: f64, what: &str) -> ProgressBar {
    styled(ProgressBar::new((seconds * 1e3) as u64), &format!("{{bar:40}} {what}{{msg}}, {{eta}} left"))
}

/// A progress bar for bytes read.
pub(super) fn byte_bar() -> ProgressBar {
    styled(ProgressBar::new(0), "{bar:40} {bytes}/{total_bytes} read, {eta} left")
}

/// A spinner with the elapsed time, for work of unknown duration.
pub(super) fn spinner(what: &'static str) -> ProgressBar {
    let bar = styled(ProgressBar::new_spinner().with_message(what), "{spinner} {elapsed} {msg}");
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn styled(bar: ProgressBar, template: &str) -> ProgressBar {
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
