//! Chains with unactuated joints anywhere, with prismatic joints and with few joints: Hold, Track and Stop in closed loop, payloads in
//! the chain's order, texts with the names of the joints, no allocation in a cycle.

mod common;

use allocation_counter::measure;
use common::{Arm, at_rest, config, measurement_of, resting};
use upswing_config::Config;
use upswing_ipc::{Mode, PlanMessage};
use upswing_model::{ActuatedVector, JointFriction, JointVector, Model, Workspace};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepOutput, StepRequest};
use upswingd::trip::TripCause;

/// One second.
const SECOND: usize = 8000;

/// A trolley, the angle of a rope, and its length.
const CRANE: [Joint; 3] = [
    Joint {
        name: "trolley",
        kind: "prismatic",
        axis: "1 0 0",
        range: (-2.0, 2.0),
        effort: 300.0,
        mass: 10.0,
    },
    Joint { name: "rope", kind: "revolute", axis: "0 1 0", range: (-1.5, 1.5), effort: 0.0, mass: 1.0 },
    Joint { name: "hoist", kind: "prismatic", axis: "0 0 -1", range: (0.3, 1.5), effort: 200.0, mass: 3.0 },
];
/// A double pendulum that is driven at the far joint.
const ACROBOT: [Joint; 2] = [
    Joint { name: "shoulder", kind: "continuous", axis: "0 1 0", range: (0.0, 0.0), effort: 0.0, mass: 1.0 },
    Joint { name: "elbow", kind: "revolute", axis: "0 1 0", range: (-3.0, 3.0), effort: 20.0, mass: 1.0 },
];
/// A turntable with a body that slides freely.
const SLIDER: [Joint; 2] = [
    Joint { name: "table", kind: "revolute", axis: "0 0 1", range: (-3.0, 3.0), effort: 50.0, mass: 2.0 },
    Joint { name: "slide", kind: "prismatic", axis: "0 0 1", range: (-9.0, 9.0), effort: 0.0, mass: 1.0 },
];

struct Joint {
    name: &'static str,
    kind: &'static str,
    axis: &'static str,
    range: (f64, f64),
    effort: f64,
    mass: f64,
}

/// Bodies of 0.5 m, one below the other.
fn model(joints: &[Joint]) -> Model {
    let mut urdf = String::from("<robot name=\"machine\"><link name=\"base\"/>");
    let mut parent = "base";
    for Joint { name, kind, axis, range: (lower, upper), effort, mass } in joints {
        let limit = match *kind {
            "continuous" => format!("<limit velocity=\"20\" effort=\"{effort}\"/>"),
            _ => format!("<limit lower=\"{lower}\" upper=\"{upper}\" velocity=\"5\" effort=\"{effort}\"/>"),
        };
        urdf += &format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{name}\"/><axis xyz=\"{axis}\"/>\
             <origin xyz=\"0 0 {}\" rpy=\"0 0 0\"/>{limit}</joint>\
             <link name=\"{name}\"><inertial><origin xyz=\"0 0 -0.25\" rpy=\"0 0 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"0.02\" iyy=\"0.02\" izz=\"0.02\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>",
            if parent == "base" { 0.0 } else { -0.5 }
        );
        parent = name;
    }
    Model::from_urdf(&(urdf + "</robot>")).unwrap()
}

/// The settings of the arm for another machine.
fn machine(joints: &[Joint]) -> Config {
    let mut config = config();
    config.model = model(joints);
    let sizes = config.model.sizes();
    let (all, actuated) =
        (|value| JointVector::repeat(sizes, value), |value| ActuatedVector::repeat(sizes, value));
    config.robot.limits = *config.model.rated_limits();
    config.robot.planning = config.robot.limits;
    config.robot.friction = JointFriction { viscous: actuated(0.0), coulomb: actuated(0.0), smoothing: 0.05 };
    (config.daemon.hold.stiffness, config.daemon.hold.damping) = (actuated(100.0), actuated(20.0));
    config.daemon.stop.deceleration = actuated(4.0);
    let standstill = &mut config.daemon.standstill;
    (standstill.angle, standstill.friction, standstill.unknown) = (all(1e-5), all(0.1), all(1.0));
    config
}

/// A machine with its controller.
struct Loop {
    config: Config,
    arm: Arm,
    controller: Controller,
}

impl Loop {
    fn new(joints: &[Joint], q_a: &[f64]) -> Self {
        let config = machine(joints);
        let mut q = JointVector::zeros(config.model.sizes());
        q.actuated_mut().copy_from_slice(q_a);
        let q = config.model.rest_position(&q, &mut Workspace::default()).unwrap();
        Self { arm: Arm::new(&config, at_rest(&q)), controller: Controller::new(&config), config }
    }

    fn step(&mut self, request: Option<StepRequest>) -> StepOutput {
        let (measured, mut output) = (self.arm.measure(), None);
        let heap = measure(|| output = Some(self.controller.step(StepInput::new(measured, 0, request))));
        assert_eq!((heap.count_total, heap.count_current), (0, 0), "in {}", self.controller.mode());
        let output = output.unwrap();
        assert!(output.answer.is_none_or(|answer| answer.is_ok()), "{:?}", output.answer);
        self.arm.advance(&output.command);
        output
    }

    fn run(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| drop(self.step(None)));
    }

    fn assert_mode(&self, mode: Mode) {
        let trip = self.controller.trip().map(|trip| trip.text(&self.config.model));
        assert_eq!(self.controller.mode(), mode, "{trip:?}");
    }

    /// A plan that stays in the present pose for `t_f` s, as it comes out of its message.
    fn rest_plan(&self, t_f: f64) -> StepRequest {
        let order = self.config.model.order();
        let plan = resting(&self.config, &at_rest(&self.arm.x.q()), t_f);
        let message = PlanMessage::new(&plan, order);
        assert_eq!(message.plan(order).unwrap(), plan);
        StepRequest::Load(Box::new(plan))
    }
}

#[test]
fn a_pose_is_held_against_pushes() {
    for (joints, q_a) in [(&CRANE[..], &[0.5, 0.8][..]), (&ACROBOT[..], &[0.6])] {
        let mut system = Loop::new(joints, q_a);
        system.step(Some(StepRequest::Enable));
        system.run(100);
        system.arm.x.qd_a_mut().fill(0.02);
        system.run(2 * SECOND);
        system.assert_mode(Mode::Hold);
        let off = system.arm.x.q_a() - ActuatedVector::from_slice(system.arm.x.sizes(), q_a).unwrap();
        assert!(off.amax() < 2e-3, "{off:?}");
    }
}

#[test]
fn a_plan_is_tracked_and_a_motion_stopped() {
    for (joints, q_a) in [(&CRANE[..], &[0.5, 0.8][..]), (&ACROBOT[..], &[0.6])] {
        let mut system = Loop::new(joints, q_a);
        system.step(Some(StepRequest::Enable));
        let plan = system.rest_plan(0.1);
        system.step(Some(plan));
        system.step(Some(StepRequest::Start(7)));
        system.run(400);
        system.assert_mode(Mode::Track);
        system.run(SECOND);
        // It hangs at its end.
        system.assert_mode(Mode::Hold);
        system.arm.x.qd_a_mut().fill(0.1);
        system.run(200);
        system.step(Some(StepRequest::Stop));
        system.assert_mode(Mode::Stop);
        system.run(2 * SECOND);
        system.assert_mode(Mode::Hold);
        assert!(system.arm.x.qd_a().amax() < 0.02, "{:?}", system.arm.x.qd_a());
    }
}

#[test]
fn payloads_have_the_order_of_the_chain() {
    let mut system = Loop::new(&CRANE, &[0.5, 0.8]);
    system.step(Some(StepRequest::Enable));
    (0..200).for_each(|_| drop(system.step(None)));
    let StepOutput { command, record, .. } = system.step(None);
    let [trolley, rope, hoist] = [0, 1, 2].map(|joint| record.telemetry.q[joint]);
    assert!((trolley - 0.5).abs() < 1e-3 && rope.abs() < 1e-3 && (hoist - 0.8).abs() < 1e-3);
    assert_eq!(record.telemetry.q_d[..3], [0.5, rope, 0.8]);
    // Rope and load hang on the hoist.
    assert!(command.tau[0].abs() < 0.1 && (command.tau[1] + 3.0 * 9.81).abs() < 0.1, "{:?}", command.tau);
    assert_eq!((command.joints, command.actuated), (3, 2));
    assert_eq!(command.torque(system.arm.x.sizes()).unwrap()[..], command.tau[..2]);
}

#[test]
fn a_trip_names_the_joint_and_its_unit() {
    let cause = |joint: usize, value: f64| {
        let mut system = Loop::new(&CRANE, &[0.5, 0.8]);
        system.step(Some(StepRequest::Enable));
        let mut bad = system.arm.measure();
        bad.q[joint] = value;
        system.controller.step(StepInput::new(bad, 0, None));
        system.assert_mode(Mode::Fault);
        let trip = *system.controller.trip().unwrap();
        (trip.cause, trip.text(&system.config.model))
    };
    let (got, text) = cause(1, f64::NAN);
    assert_eq!(got, TripCause::NotFinite);
    assert_eq!(text, "the position of joint `rope` is NaN, expected at most 100 rad");
    let (got, text) = cause(2, 0.9);
    assert_eq!(got, TripCause::EncoderJump);
    assert!(text.starts_with("the position of joint `hoist` jumped by 0.10000 m"), "{text}");
}

#[test]
fn only_unactuated_joints_that_turn_drop_their_turns() {
    let shown = |joints: &[Joint], moved: usize, by: f64| {
        let config = machine(joints);
        let mut controller = Controller::new(&config);
        let mut q = JointVector::zeros(config.model.sizes());
        let step = |controller: &mut Controller, seq, q: &JointVector| {
            controller.step(StepInput::new(measurement_of(&config.model, seq, q), 0, None)).record.telemetry
        };
        step(&mut controller, 1, &q);
        q[config.model.coordinate(joints[moved].name).unwrap()] += by;
        step(&mut controller, 2, &q);
        step(&mut controller, 3, &q).q[moved]
    };
    let turn = std::f64::consts::TAU;
    assert!((shown(&ACROBOT, 0, -2.0 * turn + 0.1) - 0.1).abs() < 1e-9);
    assert!((shown(&CRANE, 1, turn + 0.1) - 0.1).abs() < 1e-9);
    // Neither metres nor joints with a motor.
    assert_eq!(shown(&SLIDER, 1, turn), turn);
    assert_eq!(shown(&SLIDER, 0, turn), turn);
}
