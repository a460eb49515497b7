//! The monitor shows the numbers of the newest cycle, and draws any telemetry on a terminal of any size.

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use std::sync::LazyLock;
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;
use upswing_ipc::{Mode, Telemetry};
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswing_rig::closed_loop::{Disturbances, RunOptions, swing_up};
use upswing_view::live::{DaemonStatus, EventView, LatencyPercentiles, Severity, View, ViewBuilder};
use upswing_view::monitor::{KeyAction, KeyState, Theme, draw};

static CONFIG: LazyLock<Config> = LazyLock::new(|| Config::embedded().expect("embedded settings"));
/// The cycles of a swing-up.
static CYCLES: LazyLock<Vec<Telemetry>> = LazyLock::new(|| {
    let planner = Planner::new(CONFIG.clone()).expect("the database fits");
    let plant = Plant::new(&CONFIG).expect("a possible start");
    let mut records = Vec::new();
    let calm = |_| Disturbances::default();
    let report = swing_up(
        &planner,
        &mut planner.solver(),
        &CONFIG,
        plant,
        2.0,
        calm,
        RunOptions::default(),
        &mut records,
    );
    let report = report.expect("a swing-up");
    assert!(report.success, "{report}");
    records
});

fn view(records: &[Telemetry]) -> View {
    let mut watch = ViewBuilder::new(&CONFIG, "here");
    records.iter().for_each(|record| watch.cycle(record));
    watch.view()
}

fn picture(view: &View, keys: &KeyState, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
    let look = Theme { colours: width.is_multiple_of(2) };
    terminal.draw(|frame| draw(frame, view, keys, look)).expect("drawn");
    terminal.backend().to_string()
}

fn upto(mode: Mode) -> &'static [Telemetry] {
    let last = CYCLES.iter().rposition(|r| r.mode() == Ok(mode)).expect("the mode occurs");
    &CYCLES[..=last]
}

#[test]
fn in_each_mode() {
    for (mode, name) in [(Mode::Hold, "HOLD"), (Mode::Track, "TRACK"), (Mode::Balance, "BALANCE")] {
        let records = upto(mode);
        let text = picture(&view(records), &KeyState::new(&CONFIG), 120, 34);
        assert!(text.contains(name), "{text}");
        let newest = records.last().expect("a record");
        for (name, q) in CONFIG.model.joint_names().zip(&newest.q) {
            let angle = format!(" {name:10}{:>8.2} deg ", q.to_degrees());
            assert!(text.contains(&angle), "expected `{angle}` in\n{text}");
        }
        assert!(text.contains("mode hold") && text.contains("enable"), "{text}");
    }
    let text = picture(&view(upto(Mode::Balance)), &KeyState::new(&CONFIG), 120, 34);
    assert!(text.contains("Tip: 0.0 deg from upright"), "{text}");
}

#[test]
fn a_fault_with_its_cause_and_nothing_without_a_daemon() {
    let mut records = upto(Mode::Track).to_vec();
    let cause = upswingd::trip::TripCause::EncoderJump;
    let last = records.last_mut().expect("a record");
    (last.mode, last.fault) = (Mode::Fault.code(), cause.code());
    let text = picture(&view(&records), &KeyState::new(&CONFIG), 120, 34);
    assert!(text.contains("FAULT") && text.contains("fault: an angle jumped"), "{text}");
    let text = picture(&view(&[]), &KeyState::new(&CONFIG), 120, 34);
    assert!(text.contains("NO DAEMON") && text.contains("no cycles arrive"), "{text}");
}

#[test]
fn on_80x24_nothing_is_cut() {
    let times = |max| LatencyPercentiles { count: 9, p50: 1.2, p99: 3.4, p99_9: 5.6, p99_99: 7.8, max };
    let status = DaemonStatus {
        mode: "balance".into(),
        fault: None,
        loaded_plan: None,
        running_plan: None,
        cycles: 123_456_789,
        overruns: 0,
        last_overrun: None,
        warnings: Vec::new(),
        degraded: Vec::new(),
        wake_us: times(54_321.9),
        compute_us: times(98_765.4),
        remark: String::new(),
        next: "upswing request swing-down".into(),
    };
    let balanced = view(upto(Mode::Balance));
    let view = View { status: Some(status.clone()), ..balanced.clone() };
    let text = picture(&view, &KeyState::new(&CONFIG), 80, 24);
    for shown in
        ["54321.9", "98765.4", "max", "p99.9", "123456789 cycles, none late, 0 lost", "q quit", "? help"]
    {
        assert!(text.contains(shown), "no {shown} in\n{text}");
    }
    assert!(picture(&view, &KeyState::new(&CONFIG), 120, 34).contains("p99.99"));

    // With late cycles: how many and the last one, with its cause among the events.
    let cause = "cycle 123456789 late in compute: wake 12.3 read 1.2 compute 312.3 write 0.4 us; 2 preemptions, \
                 212.3 us ready without a CPU, 0 page faults in the last 50 ms";
    let status = DaemonStatus { overruns: 98_765, last_overrun: Some(cause.into()), ..status };
    let late = EventView { t: 12.3, kind: Severity::Warning, text: format!("late: {cause}") };
    let events = [balanced.events.clone(), vec![late]].concat();
    assert!(status.to_string().ends_with("\nnext       upswing request swing-down"), "{status}");
    let view = View { status: Some(status), lost: 12_345, events, ..balanced };
    // Events go on in the next line.
    let text = picture(&view, &KeyState::new(&CONFIG), 80, 24).replace("\"\n\"", "");
    for shown in [
        "98765 of 123456789 late, 12345 lost",
        "last: cycle 123456789 late in compute",
        "preemptions, 212.3 us ready without a CPU, 0 page faults in the last 50 ms",
    ] {
        assert!(text.contains(shown), "no {shown} in\n{text}");
    }
}

#[test]
fn what_to_do_next_in_every_mode() {
    let last = upto(Mode::Balance).last().expect("a record");
    for mode in Mode::ALL {
        let record = Telemetry { mode: mode.code(), ..*last };
        for view in [view(&[record]), View { status: None, ..view(&[record]) }] {
            let text = picture(&view, &KeyState::new(&CONFIG), 80, 24);
            let next = mode.next_action(|start| CONFIG.first_manoeuvre(start)).to_string();
            assert_eq!(view.next.as_ref(), Some(&next));
            assert!(text.contains(&next), "{mode}: no `{next}` in\n{text}");
        }
    }
    let nobody = view(&[]);
    assert_eq!(nobody.next, None);
    assert!(picture(&nobody, &KeyState::new(&CONFIG), 80, 24).contains("start a daemon"));
}

#[test]
fn a_question_mark_explains_the_keys() {
    let view = view(upto(Mode::Balance));
    let mut keys = KeyState::new(&CONFIG);
    let mut press = |key| keys.press(&KeyEvent::from(KeyCode::Char(key)));
    assert_eq!(press('?'), KeyAction::Nothing);
    // Nothing but a stop is asked for while it is shown.
    assert_eq!(press('y'), KeyAction::Nothing);
    assert_eq!((press('?'), press('s')), (KeyAction::Nothing, KeyAction::Ask(OperatorRequest::Stop)));
    assert_eq!(press('?'), KeyAction::Nothing);
    let text = picture(&view, &keys, 80, 24);
    for shown in ["swing-down", "The brakes open", "any other key no", "s still stops"] {
        assert!(text.contains(shown), "no {shown} in\n{text}");
    }
    keys.press(&KeyEvent::from(KeyCode::Esc));
    assert!(!picture(&view, &keys, 80, 24).contains("The brakes open"));
}

#[test]
fn what_waits_to_be_confirmed() {
    let mut keys = KeyState::new(&CONFIG);
    keys.press(&KeyEvent::from(KeyCode::Char('u')));
    let text = picture(&view(&CYCLES[..1]), &keys, 80, 24);
    assert!(text.contains("swing-up?") && text.contains("y: yes"), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    #[test]
    fn any_bits_on_any_size(
        words in prop::collection::vec(any::<u64>(), Telemetry::default().words().count()),
        width in 1_u16..200, height in 1_u16..60,
    ) {
        let record = Telemetry::from_words(&words).expect("as many words as a record has");
        let view = view(&[record]);
        picture(&view, &KeyState::new(&CONFIG), width, height);
        prop_assert!(serde_json::to_string(&view).is_ok());
    }
}
