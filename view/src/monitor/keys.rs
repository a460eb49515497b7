//! Keys of the monitor in the terminal.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use upswing_ipc::operator::{Manoeuvre, OperatorRequest};

/// Key and request, in the order of the bottom line.
pub(super) const REQUESTS: [(char, OperatorRequest); 6] = [
    ('e', OperatorRequest::Enable),
    ('u', OperatorRequest::Manoeuvre(Manoeuvre::SwingUp)),
    ('d', OperatorRequest::Manoeuvre(Manoeuvre::SwingDown)),
    ('h', OperatorRequest::Hold),
    ('s', OperatorRequest::Stop),
    ('r', OperatorRequest::Reset),
];

/// Action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyAction {
    /// No action.
    Nothing,
    /// End the monitor.
    Quit,
    /// Make a request.
    Ask(OperatorRequest),
}

/// State of the keys. Each request but a stop has to be confirmed by `y`; any other key cancels it. Any key closes the help.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KeyState {
    waiting: Option<OperatorRequest>,
    help: bool,
}

impl KeyState {
    /// The request that waits for `y`.
    pub fn waiting(&self) -> Option<OperatorRequest> {
        self.waiting
    }

    /// Whether the help is shown.
    pub fn help(&self) -> bool {
        self.help
    }

    /// Takes a key; returns its action.
    pub fn press(&mut self, key: &KeyEvent) -> KeyAction {
        if key.kind != KeyEventKind::Press {
            return KeyAction::Nothing;
        }
        let waiting = self.waiting.take();
        let helped = std::mem::take(&mut self.help);
        match (key.code, waiting) {
            (KeyCode::Char('c'), _) if key.modifiers.contains(KeyModifiers::CONTROL) => KeyAction::Quit,
            (KeyCode::Char('s'), _) => KeyAction::Ask(OperatorRequest::Stop),
            (KeyCode::Char('y'), Some(request)) => KeyAction::Ask(request),
            // Any other key cancels the waiting request, and does nothing else.
            (_, Some(_)) => KeyAction::Nothing,
            _ if helped => KeyAction::Nothing,
            (KeyCode::Char('?') | KeyCode::F(1), None) => {
                self.help = true;
                KeyAction::Nothing
            }
            (KeyCode::Char('q') | KeyCode::Esc, None) => KeyAction::Quit,
            (KeyCode::Char(c), None) => {
                self.waiting = REQUESTS.into_iter().find(|(key, _)| *key == c).map(|(_, request)| request);
                KeyAction::Nothing
            }
            _ => KeyAction::Nothing,
        }
    }
}
