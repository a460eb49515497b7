//! Monitor of a running system in the terminal (`upswing monitor`).

mod draw;
mod keys;
mod rows;

pub use draw::{Theme, draw};
pub use keys::{KeyAction, KeyState};

use crate::live::Live;
use ratatui::crossterm::event::{self, Event};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two frames.
const FRAME: Duration = Duration::from_millis(40);
/// Longest time for the monitor to end with its terminal restored.
const GRACE: Duration = Duration::from_millis(900);

/// Error that ended the monitor.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The terminal cannot be used.
    #[error("the terminal cannot be used: {0}; `upswing monitor --web` needs none")]
    Terminal(#[from] std::io::Error),
    /// Shared memory cannot be used.
    #[error(transparent)]
    Ipc(#[from] upswing_ipc::IpcError),
}

/// Shows the system until a key, `stop` or the end of the terminal ends the monitor. Afterwards the terminal is restored, also
/// after a panic. If nobody reads the output of the terminal, drawing blocks: then the process ends without restoring it.
///
/// # Errors
/// [`MonitorError`]
pub fn run(
    live: &mut Live,
    keys: KeyState,
    theme: Theme,
    stop: &Arc<AtomicBool>,
) -> Result<(), MonitorError> {
    let mut terminal = ratatui::try_init()?;
    let stopped = Arc::clone(stop);
    std::thread::spawn(move || {
        while !stopped.load(Ordering::Acquire) && !is_hung_up() {
            std::thread::sleep(FRAME);
        }
        std::thread::sleep(GRACE);
        std::process::exit(1);
    });
    let result = watch(live, keys, theme, stop, &mut terminal);
    let restored = ratatui::try_restore();
    if is_hung_up() {
        return Ok(());
    }
    result.and(Ok(restored?))
}

/// Whether the terminal on stdin is gone: a closed window, a dropped connection.
fn is_hung_up() -> bool {
    let mut stdin = libc::pollfd { fd: libc::STDIN_FILENO, events: libc::POLLIN, revents: 0 };
    // SAFETY: one valid pollfd, which the call alone writes to; it returns at once.
    let ready = unsafe { libc::poll(&raw mut stdin, 1, 0) };
    ready > 0 && stdin.revents & (libc::POLLHUP | libc::POLLERR | libc::POLLNVAL) != 0
}

fn watch(
    live: &mut Live,
    mut keys: KeyState,
    theme: Theme,
    stop: &AtomicBool,
    terminal: &mut ratatui::DefaultTerminal,
) -> Result<(), MonitorError> {
    let requests = live.request_sender();
    // Checked before each poll for keys: crossterm spins on a terminal that is gone.
    while !stop.load(Ordering::Acquire) && !is_hung_up() {
        live.poll(|_| ())?;
        let view = live.view();
        terminal.draw(|frame| draw(frame, &view, &keys, theme))?;
        if !event::poll(FRAME)? {
            continue;
        }
        if let Event::Key(key) = event::read()? {
            match keys.press(&key) {
                KeyAction::Nothing => {}
                KeyAction::Quit => break,
                // Its result is an event of the view.
                KeyAction::Ask(action) => drop(requests.ask(action)),
            }
        }
    }
    Ok(())
}
