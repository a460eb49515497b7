//! What the keys mean.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use upswing_ipc::operator::{Manoeuvre, Request};

/// Key, name and request, in the order of the bottom line.
pub(super) const REQUESTS: [(char, Request); 6] = [
    ('e', Request::Enable),
    ('u', Request::Manoeuvre(Manoeuvre::SwingUp)),
    ('d', Request::Manoeuvre(Manoeuvre::SwingDown)),
    ('h', Request::Hold),
    ('s', Request::Stop),
    ('r', Request::Reset),
];

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Nothing yet.
    Nothing,
    /// The end.
    Quit,
    /// A request.
    Ask(Request),
}

/// All but a stop has to be confirmed: it waits here for `y`, and any other key forgets it. Likewise any key ends the help.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Keys {
    waiting: Option<Request>,
    help: bool,
}

impl Keys {
    /// What waits for `y`.
    pub fn waiting(&self) -> Option<Request> {
        self.waiting
    }

    /// Whether what the keys do is explained.
    pub fn help(&self) -> bool {
        self.help
    }

    /// A key was pressed.
    pub fn press(&mut self, key: &KeyEvent) -> Wish {
        if key.kind != KeyEventKind::Press {
            return Wish::Nothing;
        }
        let waiting = self.waiting.take();
        let helped = std::mem::take(&mut self.help);
        match (key.code, waiting) {
            (KeyCode::Char('c'), _) if key.modifiers.contains(KeyModifiers::CONTROL) => Wish::Quit,
            (KeyCode::Char('s'), _) => Wish::Ask(Request::Stop),
            (KeyCode::Char('y'), Some(request)) => Wish::Ask(request),
            // Any other key forgets what waits, and does nothing else.
            (_, Some(_)) => Wish::Nothing,
            _ if helped => Wish::Nothing,
            (KeyCode::Char('?') | KeyCode::F(1), None) => {
                self.help = true;
                Wish::Nothing
            }
            (KeyCode::Char('q') | KeyCode::Esc, None) => Wish::Quit,
            (KeyCode::Char(c), None) => {
                self.waiting = REQUESTS.into_iter().find(|(key, _)| *key == c).map(|(_, request)| request);
                Wish::Nothing
            }
            _ => Wish::Nothing,
        }
    }
}
