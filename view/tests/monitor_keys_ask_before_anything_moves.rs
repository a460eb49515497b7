//! For any sequence of keys, a request is sent only by `y` directly after its key; only stop is sent at once, always.

use proptest::prelude::*;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind};
use upswing_config::Config;
use upswing_ipc::ManoeuvreRequest;
use upswing_ipc::operator::OperatorRequest;
use upswing_view::monitor::{KeyAction, KeyState};

fn action_of(key: char) -> Option<OperatorRequest> {
    let keys = "eudhr".chars();
    let manoeuvre = |name| OperatorRequest::Manoeuvre(ManoeuvreRequest::new(name, &[]).unwrap());
    let actions = [
        OperatorRequest::Enable,
        manoeuvre("swing-up"),
        manoeuvre("swing-down"),
        OperatorRequest::Hold,
        OperatorRequest::Reset,
    ];
    keys.zip(actions).find(|(k, _)| *k == key).map(|(_, request)| request)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

    #[test]
    fn any_keys(typed in prop::collection::vec(prop::sample::select("eudhrsyqnxYS ".chars().collect::<Vec<_>>()), 1..60)) {
        let mut keys = KeyState::new(&Config::embedded().unwrap());
        // What our own reading of the rule says waits for `y`.
        let mut waiting = None;
        for key in typed {
            let wish = keys.press(&KeyEvent::from(KeyCode::Char(key)));
            let expected = match (key, waiting.take()) {
                ('s', _) => KeyAction::Ask(OperatorRequest::Stop),
                ('y', Some(request)) => KeyAction::Ask(request),
                ('q', None) => KeyAction::Quit,
                (_, Some(_)) => KeyAction::Nothing,
                (key, None) => {
                    waiting = action_of(key);
                    KeyAction::Nothing
                }
            };
            prop_assert_eq!(wish, expected);
            prop_assert_eq!(keys.waiting(), waiting);
        }
    }
}

#[test]
fn a_key_that_is_let_go_does_nothing() {
    let mut keys = KeyState::new(&Config::embedded().unwrap());
    let mut key = KeyEvent::from(KeyCode::Char('s'));
    key.kind = KeyEventKind::Release;
    assert_eq!(keys.press(&key), KeyAction::Nothing);
}
