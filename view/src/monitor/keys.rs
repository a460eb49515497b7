//! Keys of the monitor in the terminal.

use crate::requests::offered;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;

/// Keys of commands, in the order of the bottom line: before the manoeuvres, and after them.
const FIRST: [(char, OperatorRequest); 1] = [('e', OperatorRequest::Enable)];
const LAST: [(char, OperatorRequest); 3] =
    [('h', OperatorRequest::Hold), ('s', OperatorRequest::Stop), ('r', OperatorRequest::Reset)];
/// Further keys that no manoeuvre can have.
const TAKEN: [char; 4] = ['q', 'y', '?', '-'];

/// Key of each request that the monitor offers. A manoeuvre has the first letter of the last word of its name (`u` for swing-up), or
/// the next free letter, or else a digit.
fn keys(config: &Config) -> Vec<(char, OperatorRequest)> {
    let mut keys = FIRST.to_vec();
    for request in offered(config) {
        if let OperatorRequest::Manoeuvre(manoeuvre) = request {
            let name = manoeuvre.name.as_str();
            let last = name.rsplit('-').next().unwrap_or_default();
            let free =
                |key: &char| !TAKEN.contains(key) && !keys.iter().chain(&LAST).any(|(taken, _)| taken == key);
            let key = last.chars().chain(name.chars()).chain('1'..='9').find(free);
            keys.extend(key.map(|key| (key, request)));
        }
    }
    keys.extend(LAST);
    keys
}

/// Action of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KeyAction {
    /// No action.
    Nothing,
    /// End the monitor.
    Quit,
    /// Make a request.
    Ask(OperatorRequest),
}

/// State of the keys. Each request but a stop has to be confirmed by `y`; any other key cancels it. Any key closes the help.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyState {
    /// Key and request, in the order of the bottom line.
    keys: Vec<(char, OperatorRequest)>,
    waiting: Option<OperatorRequest>,
    help: bool,
}

impl KeyState {
    /// The keys of a system before the first one is pressed.
    pub fn new(config: &Config) -> Self {
        Self { keys: keys(config), waiting: None, help: false }
    }

    /// Key and request, in the order of the bottom line.
    pub(super) fn requests(&self) -> &[(char, OperatorRequest)] {
        &self.keys
    }

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
                self.waiting = self.keys.iter().find(|(key, _)| *key == c).map(|(_, request)| *request);
                KeyAction::Nothing
            }
            _ => KeyAction::Nothing,
        }
    }
}
