//! Every pair of mode and event has the result that docs/daemon.md names.

use upswing_config::Config;
use upswing_ipc::Mode::{self, Balance, Fault, Hold, Idle, Stop, Track};
use upswing_ipc::operator::{NextAction, OperatorRequest};
use upswing_model::Posture;
use upswingd::supervisor::{ModeEvent, RequestRefusal, transition};

/// Rows: modes in the order of [`Mode::ALL`]; columns: [`EVENTS`]. `None`: refused.
const EVENTS: [ModeEvent; 12] = [
    ModeEvent::Enable,
    ModeEvent::Hold,
    ModeEvent::Start,
    ModeEvent::Stop,
    ModeEvent::Reset,
    ModeEvent::Shutdown,
    ModeEvent::PlanEnded(Posture::Standing),
    ModeEvent::PlanEnded(Posture::Hanging),
    ModeEvent::TripToStop,
    ModeEvent::AtRest,
    ModeEvent::AtRestAtShutdown,
    ModeEvent::TripToFault,
];
const NO: Option<Mode> = None;
#[rustfmt::skip]
const TABLE: [(Mode, [Option<Mode>; 12]); 6] = [
    //          enable      hold        start        stop        reset       shutdown     upright        hanging     lost        at rest     for good    fault
    (Idle,    [Some(Hold), NO,         NO,          NO,         NO,         Some(Idle),  NO,            NO,         NO,         NO,         NO,         NO]),
    (Hold,    [NO,         Some(Hold), Some(Track), Some(Stop), NO,         Some(Stop),  NO,            NO,         NO,         NO,         NO,         Some(Fault)]),
    (Track,   [NO,         NO,         NO,          Some(Stop), NO,         Some(Stop),  Some(Balance), Some(Hold), Some(Stop), NO,         NO,         Some(Fault)]),
    (Balance, [NO,         Some(Hold), Some(Track), Some(Stop), NO,         Some(Stop),  NO,            NO,         Some(Stop), NO,         NO,         Some(Fault)]),
    (Stop,    [NO,         NO,         NO,          NO,         NO,         Some(Stop),  NO,            NO,         NO,         Some(Hold), Some(Idle), Some(Fault)]),
    (Fault,   [NO,         NO,         NO,          NO,         Some(Idle), Some(Fault), NO,            NO,         NO,         NO,         NO,         NO]),
];

#[test]
fn the_machine_follows_the_table() {
    assert_eq!(TABLE.map(|(mode, _)| mode), Mode::ALL);
    for (mode, row) in TABLE {
        for (event, expected) in EVENTS.into_iter().zip(row) {
            assert_eq!(
                transition(mode, event),
                expected.ok_or(RequestRefusal::Mode { mode, event }),
                "{mode}, {event:?}"
            );
        }
    }
}

#[test]
fn every_request_is_in_the_table() {
    assert!(ModeEvent::REQUESTS.iter().all(|request| EVENTS.contains(request)));
}

#[test]
fn a_refusal_names_a_step_that_is_accepted() {
    let config = Config::embedded().unwrap();
    for mode in Mode::ALL.iter().copied() {
        let accepted = match mode.next_action(|start| config.first_manoeuvre(start)) {
            // The planner makes such plans in these modes; then one starts.
            NextAction::Manoeuvre(name) => {
                let manoeuvre = config.manoeuvres.iter().find(|m| Some(m.name.as_str()) == name).unwrap();
                assert_eq!(mode, Mode::from_posture(manoeuvre.start));
                transition(mode, ModeEvent::Start)
            }
            NextAction::Make(request) | NextAction::WaitOr(request) => {
                let asked = ModeEvent::REQUESTS.into_iter().find(|r| r.to_string() == request.name());
                transition(mode, asked.expect("a request"))
            }
            NextAction::WaitForRest => transition(mode, ModeEvent::AtRest),
        };
        let next = accepted.expect("it is accepted");
        assert_ne!(next, mode, "it leads somewhere");
        let refused = ModeEvent::REQUESTS.into_iter().filter_map(|r| transition(mode, r).err());
        for refusal in refused {
            let text = refusal.text(&config.model);
            assert!(text.ends_with(&format!("next: {}", mode.next_action(|_| None))), "{text}");
        }
    }
    // From a fault the steps lead to a balanced rod.
    let next = |mode: Mode| mode.next_action(|start| config.first_manoeuvre(start));
    assert_eq!(next(Fault), NextAction::Make(OperatorRequest::Reset));
    assert_eq!(next(Idle), NextAction::Make(OperatorRequest::Enable));
    assert_eq!(next(Hold), NextAction::Manoeuvre(Some("swing-up")));
    assert_eq!(next(Balance), NextAction::Manoeuvre(Some("swing-down")));
}

#[test]
fn a_refusal_names_mode_and_request() {
    let refusal = transition(Idle, ModeEvent::Start).unwrap_err().text(&Config::embedded().unwrap().model);
    assert!(refusal.contains("start") && refusal.contains("idle"), "{refusal}");
}
