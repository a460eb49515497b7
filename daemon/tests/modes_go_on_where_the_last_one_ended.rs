//! What a mode keeps from the previous mode, and what it resets: reference, time, plan, cause.

mod common;

use common::{
    Arm, PERIOD, PERIOD_NS, at_rest, config, measurement, rest_plan, rest_pose, sizes, upright_pose,
};
use upswing_config::PlanWhileTracking;
use upswing_ipc::{Clock, Measurement, Mode, Telemetry};
use upswing_model::{ActuatedVector, JointVector, Workspace};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepOutput, StepRequest};
use upswingd::supervisor::RequestRefusal;
use upswingd::trip::TripCause;

/// A controller that is told every next measurement.
struct Told {
    controller: Controller,
    q: JointVector,
    seq: u64,
}

impl Told {
    fn new() -> Self {
        let config = config();
        Self { controller: Controller::new(&config), q: rest_pose(&config), seq: 0 }
    }

    fn step(&mut self, request: Option<StepRequest>) -> StepOutput {
        self.seq += 1;
        self.controller.step(StepInput::new(measurement(self.seq, &self.q), 0, request))
    }

    fn ask(&mut self, request: StepRequest) -> StepOutput {
        let output = self.step(Some(request));
        assert_eq!(output.answer, Some(Ok(())));
        output
    }

    /// In Track on a plan of `t_f` s (id 7) that stays where it is.
    fn tracking(mut self, t_f: f64) -> Self {
        let plan = rest_plan(&config(), &at_rest(&self.q), t_f);
        self.ask(StepRequest::Enable);
        self.step(Some(StepRequest::Load(plan)));
        self.ask(StepRequest::Start(7));
        self
    }
}

/// The reference of the arm: angles and speeds.
fn reference(telemetry: &Telemetry) -> Vec<(f64, f64)> {
    (0..sizes().actuated()).map(|i| (telemetry.q_d[i], telemetry.qd_d[i])).collect()
}

#[test]
fn a_stop_that_is_asked_for_again_goes_on_and_ends_in_the_pose_of_its_reference() {
    let mut config = config();
    // The arm gets its speed out of nowhere.
    config.daemon.disturbance.bandwidth = 0.0;
    let mut arm = Arm::new(&config, at_rest(&rest_pose(&config)));
    let mut controller = Controller::new(&config);
    let mut cycle = |controller: &mut Controller, request: Option<StepRequest>| {
        let output = controller.step(StepInput::new(arm.measure(), 0, request.clone()));
        if request == Some(StepRequest::Enable) {
            arm.x.qd_a_mut().fill(0.5);
        }
        arm.advance(&output.command);
        output.record.telemetry
    };
    cycle(&mut controller, Some(StepRequest::Enable));
    for _ in 0..200 {
        cycle(&mut controller, Some(StepRequest::Hold));
    }
    let mut last = cycle(&mut controller, Some(StepRequest::Stop));
    for _ in 0..40 {
        last = cycle(&mut controller, None);
    }
    let mut asked_again = controller.clone();
    let again = cycle(&mut asked_again, Some(StepRequest::Shutdown));
    for (i, ((q, qd), (q_next, qd_next))) in reference(&last).into_iter().zip(reference(&again)).enumerate() {
        let a = config.daemon.stop.deceleration[i];
        let slower = (qd.abs() - a * PERIOD).max(0.0).copysign(qd);
        assert!((qd_next - slower).abs() < 1e-9, "joint {}: {qd} to {qd_next} rad/s", i + 1);
        assert!((q_next - q).abs() <= qd.abs() * PERIOD, "joint {}: {q} to {q_next} rad", i + 1);
    }
    assert!(last.qd_d[0].abs() > 0.05, "it was still moving");
    while controller.mode() == Mode::Stop {
        last = cycle(&mut controller, None);
    }
    assert_eq!((controller.mode(), last.mode), (Mode::Hold, Mode::Hold.code()));
    let held = cycle(&mut controller, None);
    assert_eq!(reference(&held), reference(&last));
    let held = held.vectors(config.model.order()).unwrap();
    assert_ne!(held.x_d.q_a(), held.x.q_a(), "the arm is near its reference, not on it");
}

#[test]
fn a_plan_that_hangs_ends_in_the_hold_of_its_end() {
    let mut told = Told::new();
    let end = told.q;
    // Held elsewhere, within what a start tolerates.
    told.q[0] += 1e-4;
    told.ask(StepRequest::Enable);
    told.step(Some(StepRequest::Load(rest_plan(&config(), &at_rest(&end), 0.001))));
    told.ask(StepRequest::Start(7));
    let mut last = told.step(None);
    while told.controller.mode() == Mode::Track {
        last = told.step(None);
    }
    assert_eq!(told.controller.mode(), Mode::Hold);
    let last = last.record.telemetry.vectors(config().model.order()).unwrap();
    assert_eq!(last.x_d.q_a(), end.actuated());
}

#[test]
fn cycles_are_counted_where_time_passes() {
    let q = rest_pose(&config());
    for clock in [Clock::Lockstep, Clock::Paced, Clock::Wall] {
        let mut controller = Controller::new(&config());
        let mut at = |seq, now: u64| {
            let measured = Measurement { clock: clock.code(), ..measurement(seq, &q) };
            let output = controller.step(StepInput::new(measured, now * PERIOD_NS, None));
            (output.command.seq, output.record.telemetry.t_ns / PERIOD_NS)
        };
        // The second time it is a request between cycles, or a cycle without a measurement.
        let expected = if clock == Clock::Wall { [(1, 5), (2, 6), (3, 7)] } else { [(1, 1), (1, 1), (2, 2)] };
        assert_eq!([at(1, 5), at(1, 6), at(2, 7)], expected, "{clock}");
    }
}

#[test]
fn the_time_of_a_plan_goes_on_with_the_measurements_whatever_their_stamps() {
    let mut told = Told::new().tracking(1.0);
    let stuck = told.seq * PERIOD_NS;
    for cycle in 1..=8 {
        told.seq += 1;
        let next = Measurement { t_ns: stuck, ..measurement(told.seq, &told.q) };
        let t_plan = told.controller.step(StepInput::new(next, 0, None)).record.telemetry.t_plan;
        assert!((t_plan - f64::from(cycle) * PERIOD).abs() < 1e-12, "{t_plan}");
    }
}

#[test]
fn a_plan_that_waits_for_its_plant_does_not_age() {
    let mut told = Told::new();
    let plan = rest_plan(&config(), &at_rest(&told.q), 1.0);
    told.controller.step(StepInput::new(Measurement::default(), 0, Some(StepRequest::Load(plan))));
    // Twenty minutes.
    told.seq = 10_000_000;
    told.ask(StepRequest::Enable);
    told.ask(StepRequest::Start(7));
    assert_eq!(told.controller.mode(), Mode::Track);
}

#[test]
fn a_start_forgets_why_the_last_plan_was_given_up() {
    let mut told = Told::new().tracking(10.0);
    let hanging = told.q[8];
    let mut last = told.step(None);
    while told.controller.mode() == Mode::Track {
        told.q[8] += 1e-3;
        last = told.step(None);
    }
    let cause = last.record.trip.map(|trip| trip.cause);
    assert_eq!((told.controller.mode(), cause), (Mode::Stop, Some(TripCause::TrackingError)));
    assert_eq!(last.record.telemetry.fault, 0, "a stop is no fault");
    while told.q[8] > hanging {
        told.q[8] = (told.q[8] - 1e-3).max(hanging);
        told.step(None);
    }
    for _ in 0..2000 {
        last = told.step(None);
    }
    let cause = last.record.trip.map(|trip| trip.cause);
    assert_eq!((told.controller.mode(), cause), (Mode::Hold, Some(TripCause::TrackingError)));
    assert_eq!(told.ask(StepRequest::Start(7)).record.trip, None);
}

#[test]
fn plans_are_taken_while_another_is_tracked_as_set() {
    for (while_tracking, taken) in [(PlanWhileTracking::Refuse, false), (PlanWhileTracking::Queue, true)] {
        for (q, end) in [(rest_pose(&config()), Mode::Hold), (upright_pose(), Mode::Balance)] {
            let mut config = config();
            config.daemon.plans.while_tracking = while_tracking;
            let next = |id| {
                let mut plan = rest_plan(&config, &at_rest(&q), 0.0005);
                plan.id = id;
                Some(StepRequest::Load(plan))
            };
            let mut told = Told { controller: Controller::new(&config), q, seq: 0 }.tracking(0.01);
            let output = told.step(next(8));
            let expected = if taken { Ok(()) } else { Err(RequestRefusal::Tracking { running: 7 }) };
            assert_eq!(output.answer, Some(expected));
            assert_eq!(
                output.retired[0].as_ref().map(|plan| plan.id),
                (!taken).then_some(8),
                "it is handed back"
            );
            while told.controller.mode() == Mode::Track {
                told.step(None);
            }
            assert_eq!(told.controller.mode(), end);
            assert_eq!(told.step(next(9)).answer, Some(Ok(())), "in {end}");
        }
    }
}

#[test]
fn turns_of_a_pendulum_that_swings_behind_closed_brakes_do_not_count() {
    let mut told = Told::new();
    let hanging = told.q[7];
    told.q[7] += 2.0 * std::f64::consts::TAU;
    told.step(None);
    let shown = told.step(None).record.telemetry.q[7];
    assert!((shown - hanging).abs() < 1e-9, "{shown}");
}

#[test]
fn a_shutdown_can_be_asked_for_twice_and_nothing_else_after_it() {
    let mut told = Told::new();
    told.ask(StepRequest::Enable);
    told.ask(StepRequest::Shutdown);
    told.ask(StepRequest::Shutdown);
    for request in
        [StepRequest::Enable, StepRequest::Hold, StepRequest::Start(7), StepRequest::Stop, StepRequest::Reset]
    {
        assert_eq!(
            told.step(Some(request.clone())).answer,
            Some(Err(RequestRefusal::ShuttingDown)),
            "{request}"
        );
    }
}

/// A torque of 1 N m more than gravity explains, behind closed brakes.
#[test]
fn only_a_load_that_is_sensed_behind_closed_brakes_is_an_offset() {
    let config = config();
    let q = rest_pose(&config);
    let none = ActuatedVector::zeros(sizes());
    let gravity = config.model.torque(&at_rest(&q), &none, &mut Workspace::default());
    let closed = Measurement::BRAKES_CLOSED;
    for (status, offset) in
        [(0, 0.0), (closed, 0.0), (Measurement::LOAD_SENSED, 0.0), (closed | Measurement::LOAD_SENSED, 1.0)]
    {
        let mut controller = Controller::new(&config);
        let mut tau_measured = *gravity.padded();
        tau_measured[0] += 1.0;
        for seq in 1..=10 {
            let status = Measurement::DRIVES_READY | status;
            controller.step(StepInput::new(
                Measurement { status, tau_measured, ..measurement(seq, &q) },
                0,
                None,
            ));
        }
        let last =
            Measurement { status: Measurement::DRIVES_READY | status, tau_measured, ..measurement(11, &q) };
        let output = controller.step(StepInput::new(last, 0, Some(StepRequest::Enable)));
        assert_eq!(output.answer, Some(Ok(())));
        let mut tau = none;
        for seq in 12..30 {
            let output = controller.step(StepInput::new(measurement(seq, &q), 0, None));
            tau = output.command.torque(sizes()).unwrap();
        }
        // The sensor shows 1 N m too much: so much more is commanded.
        assert!(((tau - gravity)[0] - offset).abs() < 0.05, "{status:b}: {:?} N m", tau - gravity);
    }
}
