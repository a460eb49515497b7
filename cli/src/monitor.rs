//! The monitor in the terminal.

mod draw;
mod keys;
mod rows;

pub use draw::{Look, draw};
pub use keys::{Keys, Wish};

use crate::live::Live;
use ratatui::crossterm::event::{self, Event};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two pictures.
const FRAME: Duration = Duration::from_millis(40);

/// Why the monitor ended.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The terminal.
    #[error("the terminal cannot be used: {0}; `upswing monitor --web` needs none")]
    Terminal(#[from] std::io::Error),
    /// Shared memory.
    #[error(transparent)]
    Ipc(#[from] upswing_ipc::IpcError),
}

/// Shows the system until a key or `stop` ends it. The terminal is as before then, also after a panic.
///
/// # Errors
/// [`MonitorError`]
pub fn run(live: &mut Live, look: Look, stop: &AtomicBool) -> Result<(), MonitorError> {
    let mut terminal = ratatui::try_init()?;
    let result = watch(live, look, stop, &mut terminal);
    let restored = ratatui::try_restore();
    result.and(Ok(restored?))
}

fn watch(
    live: &mut Live,
    look: Look,
    stop: &AtomicBool,
    terminal: &mut ratatui::DefaultTerminal,
) -> Result<(), MonitorError> {
    let asker = live.asker();
    let mut keys = Keys::default();
    while !stop.load(Ordering::Acquire) {
        live.poll(|_| ())?;
        let view = live.view();
        terminal.draw(|frame| draw(frame, &view, &keys, look))?;
        if !event::poll(FRAME)? {
            continue;
        }
        if let Event::Key(key) = event::read()? {
            match keys.press(&key) {
                Wish::Nothing => {}
                Wish::Quit => break,
                // What comes of it is among the events.
                Wish::Ask(action) => drop(asker.ask(action)),
            }
        }
    }
    Ok(())
}
