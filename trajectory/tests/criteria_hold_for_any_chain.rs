//! The criteria of plans on a pole on a cart, a chain with two joints: a plan that stands under a stabilising gain is accepted,
//! without a gain it is refused, and so are plans whose parts do not belong together or to the model. None of them panics.

use upswing_model::{ActuatedVector, JointVector, LimitKind, Linearization, Model, Sizes, State, Workspace};
use upswing_trajectory::{Gains, INTERVALS, LoopDelays, Plan, PlanCriteria, Trajectory, UnmetCriterion};

const CART_POLE: &str = r#"<robot name="cart-pole">
  <link name="rail"/>
  <link name="cart">
    <inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="pole">
    <inertial>
      <origin xyz="0 0 0.25"/><mass value="0.2"/>
      <inertia ixx="4e-3" iyy="4e-3" izz="1e-4" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-0.5" upper="0.5" velocity="3" effort="20"/>
  </joint>
  <joint name="hinge" type="continuous">
    <parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/>
    <limit velocity="20" effort="0"/>
  </joint>
</robot>"#;

fn cart_pole() -> Model {
    Model::from_urdf(CART_POLE).unwrap_or_else(|e| panic!("{e}"))
}

fn criteria_of(model: &Model) -> PlanCriteria {
    PlanCriteria {
        limits: *model.rated_limits(),
        tau_max: model.rated_limits().tau_max,
        defect: 1e-3,
        tolerance: State::new(
            &JointVector::repeat(model.sizes(), 0.02),
            &JointVector::repeat(model.sizes(), 0.2),
        ),
        delays: LoopDelays { period: 1.25e-4, velocity_filter: Some(5e-3), cycles: 2 },
        amplification: 100.0,
    }
}

/// The gain with all poles of the standing pole at -4/s: y = theta - b x has y'' = a theta.
fn stabilising(model: &Model) -> [f64; 4] {
    let sizes = model.sizes();
    let mut linearization = Linearization::new(sizes);
    let (x, u) = (State::zeros(sizes), ActuatedVector::zeros(sizes));
    model.linearize(&x, &u, &mut Workspace::default(), &mut linearization);
    let (a, b) = (linearization.a()[(3, 1)], linearization.b()[(3, 0)]);
    let [c_0, c_1, c_2, c_3] = [256.0, 256.0, 96.0, 16.0];
    // y'''' = a (a theta + b u) = -c_3 y''' - c_2 y'' - c_1 y' - c_0 y
    [c_0 * b, -c_0 - (c_2 + a) * a, c_1 * b, -c_1 - c_3 * a].map(|k| k / (a * b))
}

/// The plan that stays at the angle `theta` of the pole for a second, 0: standing.
fn at_rest(model: &Model, theta: f64, n: usize, gain: &[f64; 4]) -> Plan {
    let sizes = model.sizes();
    let x = State::from_slice(sizes, &[0.1, theta, 0.0, 0.0]).expect("four numbers");
    let trajectory = Trajectory { t_f: 1.0, x: vec![x; n + 1], u: vec![ActuatedVector::zeros(sizes); n + 1] };
    Plan {
        id: 1,
        fingerprint: model.fingerprint(),
        activation_ns: None,
        replaces: None,
        f: trajectory.f(model),
        trajectory,
        gains: Gains::from_slab(sizes, n, gain.repeat(n + 2)).expect("one gain more than knots"),
    }
}

#[test]
fn a_pole_stands_under_a_stabilising_gain_only() {
    let model = cart_pole();
    let criteria = criteria_of(&model);
    let gain = stabilising(&model);
    for n in [20, 50, 1000] {
        assert_eq!(criteria.check(&model, &at_rest(&model, 0.0, n, &gain)), Ok(()));
        for wrong in [[0.0; 4], gain.map(|k| -k), gain.map(|k| 0.2 * k)] {
            let unmet = criteria.check(&model, &at_rest(&model, 0.0, n, &wrong)).expect_err("it falls");
            assert!(matches!(unmet, UnmetCriterion::Unstable { radius } if radius > 1.0), "{unmet}");
        }
        // Hanging, it needs none.
        assert_eq!(criteria.check(&model, &at_rest(&model, std::f64::consts::PI, n, &[0.0; 4])), Ok(()));
    }
}

#[test]
fn limits_have_the_units_of_the_joints() {
    let model = cart_pole();
    let criteria = criteria_of(&model);
    let gain = stabilising(&model);
    for (row, value, kind, joint, unit) in [
        (0, 0.6, LimitKind::Position, 0, "m"),
        (2, 4.0, LimitKind::Velocity, 0, "m/s"),
        (3, -21.0, LimitKind::Velocity, 1, "rad/s"),
    ] {
        let mut plan = at_rest(&model, 0.0, 20, &gain);
        plan.trajectory.x[7][row] = value;
        let unmet = criteria.check(&model, &plan).expect_err("beyond its limit");
        let UnmetCriterion::Limit { kind: k, joint: j, unit: u, knot, got, .. } = unmet else {
            panic!("{unmet}");
        };
        assert_eq!((k, j, u, knot, got), (kind, joint, unit, 7.0, value));
    }
    let mut plan = at_rest(&model, 0.0, 20, &gain);
    plan.trajectory.u[7][0] = 30.0;
    let unmet = criteria.check(&model, &plan).expect_err("beyond its limit");
    assert!(matches!(unmet, UnmetCriterion::Limit { kind: LimitKind::Torque, joint: 0, unit: "N", .. }));
}

#[test]
fn a_blow_is_refused() {
    let model = cart_pole();
    let criteria = criteria_of(&model);
    let gain = stabilising(&model);
    // 1.2 kg times 5000/s^2 times 0.02 m are 120 N, more than 5 times 20 N.
    for (knot, entry) in [(0, 0), (9, 0), (20, 0), (21, 0)] {
        let mut plan = at_rest(&model, 0.0, 20, &gain);
        let block = if knot > 20 { plan.gains.end_mut() } else { plan.gains.knot_mut(knot) };
        block[entry] = 5000.0;
        let unmet = criteria.check(&model, &plan).expect_err("a blow");
        assert!(matches!(unmet, UnmetCriterion::Step { knot: k, joint: 0, .. } if k == knot), "{unmet}");
    }
}

#[test]
fn the_amplification_of_a_deviation_does_not_depend_on_the_number_of_knots() {
    let model = cart_pole();
    let criteria = criteria_of(&model);
    // The cart rolls away where no gain keeps it: x of its deviation grows with the time that is left.
    let share = |n: usize| {
        let mut plan = at_rest(&model, std::f64::consts::PI, n, &[0.0; 4]);
        plan.trajectory.t_f = 5.0;
        match criteria.check(&model, &plan) {
            Err(UnmetCriterion::Amplification { knot, .. }) => knot as f64 / n as f64,
            other => panic!("{other:?}"),
        }
    };
    let expected = share(100);
    assert!(expected > 0.1 && expected < 0.9, "{expected}");
    for n in [20, 50, 400, 1000] {
        assert!((share(n) - expected).abs() < 0.05, "N = {n}: {}, expected {expected}", share(n));
    }
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let model = cart_pole();
    let criteria = criteria_of(&model);
    let gain = stabilising(&model);
    let other = Sizes::new(3, 1).expect("a chain");
    let (n, expected) = (20, model.sizes());
    let refused = |change: &dyn Fn(&mut Plan), unmet: UnmetCriterion| {
        let mut plan = at_rest(&model, 0.0, n, &gain);
        change(&mut plan);
        assert_eq!(criteria.check(&model, &plan), Err(unmet));
    };
    let knots = |what, got| UnmetCriterion::Knots { what, expected: n + 1, got };
    let sizes = |what| UnmetCriterion::Sizes { what, expected, got: other };

    refused(&|p| p.trajectory.u.truncate(n), knots("u", n));
    refused(&|p| p.f.truncate(1), knots("f", 1));
    refused(&|p| p.f.push(p.f[0]), knots("f", n + 2));
    refused(&|p| p.gains = Gains::zeros(expected, n - 1), knots("K", n));
    refused(&|p| p.gains = Gains::zeros(expected, n + 1), knots("K", n + 2));
    refused(&|p| p.trajectory.x[3] = State::zeros(other), sizes("x"));
    refused(&|p| p.trajectory.u[n] = ActuatedVector::zeros(other), sizes("u"));
    refused(&|p| p.f[0] = State::zeros(other), sizes("f"));
    refused(&|p| p.gains = Gains::zeros(other, n), sizes("K"));
    refused(&|p| p.trajectory.x.clear(), UnmetCriterion::Intervals { got: 0 });
    for got in [INTERVALS.start() - 1, INTERVALS.end() + 1] {
        refused(&|p| *p = at_rest(&model, 0.0, got, &gain), UnmetCriterion::Intervals { got });
    }
    // The plan of another machine as a whole.
    let arm = Model::from_urdf(include_str!("../../config/systems/iiwa-pendulum/robot.urdf"))
        .expect("the shipped robot");
    let unmet = criteria_of(&arm).check(&arm, &at_rest(&model, 0.0, n, &gain)).expect_err("another machine");
    assert_eq!(unmet, UnmetCriterion::Sizes { what: "x", expected: arm.sizes(), got: expected });
}
