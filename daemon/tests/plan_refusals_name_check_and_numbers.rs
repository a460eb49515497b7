//! A plan that does not fit is refused with the check that failed and its numbers.

mod common;

use common::{at_rest, config, held, message, rest_plan, rest_pose, resting, sizes, unit, upright_pose};
use nalgebra::{DMatrix, DVector};
use upswing_config::{Config, PendulumStart, PlanWhileTracking, StartTolerance, VelocityEstimate};
use upswing_ipc::{DamagedPlan, Measurement, OtherChain, PlanMessage};
use upswing_model::{ActuatedVector, LimitKind, Linearization, Sizes, State, Workspace};
use upswing_planner::replan::{Effort, Planner};
use upswing_trajectory::{InterpolatedGain, Plan, UnmetCriterion};
use upswingd::controller::Controller;
use upswingd::plan::{PlanRefusal, accept};
use upswingd::step::{StepInput, StepRequest};
use upswingd::supervisor::RequestRefusal;
use upswingd::trip::TripCause;

fn rest() -> (Config, State) {
    let config = config();
    let x = at_rest(&rest_pose(&config));
    (config, x)
}

/// N of the plans.
fn n(config: &Config) -> usize {
    config.planner.offline.intervals
}

/// Index of an entry of a gain.
fn entry(row: usize, column: usize) -> usize {
    row * sizes().state() + column
}

/// Index of the entry of a gain with which an actuated joint answers the velocity of a joint.
fn entry_qd(row: usize, joint: usize) -> usize {
    entry(row, sizes().joints() + joint)
}

/// Scales the gains of some knots.
fn scale(plan: &mut Plan, knots: impl IntoIterator<Item = usize>, factor: f64) {
    knots.into_iter().for_each(|k| plan.gains.knot_mut(k).iter_mut().for_each(|v| *v *= factor));
}

/// What is said about a plan on its way from planner to daemon.
fn sent(plan: &Plan, config: &Config) -> Result<Box<Plan>, PlanRefusal> {
    accept(&message(plan), config)
}

/// What is said about a good plan after `spoil`.
fn refusal(spoil: impl Fn(&mut Plan)) -> PlanRefusal {
    let (config, x) = rest();
    let mut plan = resting(&config, &x, 1.0);
    spoil(&mut plan);
    let refusal = sent(&plan, &config).unwrap_err();
    assert!(refusal.to_string().len() < 200, "fits into an answer: {refusal}");
    refusal
}

/// f_k of the model at every knot.
fn follow_the_model(plan: &mut Plan, config: &Config) {
    plan.f = plan.trajectory.f(&config.model);
}

/// What is said about a plan that rests at `x` for 1 s after `spoil`, with f_k of the model.
fn verdict(config: &Config, x: &State, spoil: impl Fn(&mut Plan)) -> Option<UnmetCriterion> {
    let mut plan = resting(config, x, 1.0);
    spoil(&mut plan);
    follow_the_model(&mut plan, config);
    match sent(&plan, config) {
        Ok(_) => None,
        Err(PlanRefusal::Criterion(unfit)) => Some(unfit),
        Err(refusal) => panic!("{refusal}"),
    }
}

/// A swing-up from rest with the arm at `degrees`, and a swing-down from its end, for the weight r of (20).
fn planned(r: f64, degrees: [f64; 7]) -> (Config, [Plan; 2]) {
    let mut config = config();
    config.planner.lqr.r = r;
    let planner = Planner::new(config.clone()).unwrap();
    let start = config.start_state(&degrees.map(f64::to_radians), PendulumStart::Rest).unwrap();
    let effort = Effort::iterations(config.planner.replan.iterations);
    let mut solver = planner.solver();
    let up = planner.replan_with(&mut solver, 0, &[], &start, &effort).unwrap();
    let down = planner.replan_with(&mut solver, 1, &[], up.trajectory.end(), &effort).unwrap();
    let plans = [up, down].map(|replan| replan.plan(&config));
    (config, plans)
}

const START: [f64; 7] = [-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];

#[test]
fn a_good_plan_keeps_its_numbers() {
    let (config, [plan, _]) = planned(0.01, START);
    assert_eq!(*sent(&plan, &config).unwrap(), plan);
}

#[test]
fn stiff_gains_are_accepted() {
    let starts = [START, [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0], [20.0, 10.0, 0.0, -70.0, 0.0, 0.0, 0.0]];
    for r in [1e-2, 1e-3, 1e-4] {
        for start in starts {
            let (config, plans) = planned(r, start);
            for plan in plans {
                sent(&plan, &config).unwrap_or_else(|e| panic!("r = {r}, {start:?}: {e}"));
            }
        }
    }
}

#[test]
fn checksum() {
    let (config, x) = rest();
    let mut damaged = message(&resting(&config, &x, 1.0));
    damaged.values[5000] += 0.5;
    let text = accept(&damaged, &config).unwrap_err().to_string();
    assert!(
        text.contains("checksum") && text.contains(&format!("{:016x}", damaged.header.checksum)),
        "{text}"
    );
}

#[test]
fn numbers_of_joints() {
    let (config, x) = rest();
    let mut other = message(&resting(&config, &x, 1.0));
    // As many numbers, of other joints.
    (other.header.joints, other.header.actuated) = (63, 1);
    other.seal();
    assert!(matches!(
        accept(&other, &config),
        Err(PlanRefusal::Damaged(DamagedPlan::Sizes { joints: 63, .. }))
    ));
    other.header.joints = 9;
    other.seal();
    assert!(matches!(accept(&other, &config), Err(PlanRefusal::Damaged(DamagedPlan::Length { .. }))));
    // A chain of two joints.
    let mut other = message(&resting(&config, &x, 1.0));
    (other.header.joints, other.header.actuated) = (2, 1);
    other.values.truncate(PlanMessage::length(Sizes::new(2, 1).unwrap(), n(&config)));
    other.seal();
    let expected = OtherChain { payload: "plan", joints: 2, actuated: 1, expected: sizes() };
    assert_eq!(accept(&other, &config), Err(DamagedPlan::Chain(expected).into()));
}

#[test]
fn fingerprint() {
    let (config, _) = rest();
    let expected = config.model.fingerprint();
    let got = refusal(|p| p.fingerprint = 0xabc);
    assert_eq!(got, PlanRefusal::Fingerprint { expected, got: 0xabc });
    assert!(got.to_string().contains("0000000000000abc"));
}

#[test]
fn id_and_duration() {
    assert_eq!(refusal(|p| p.id = 0), PlanRefusal::Damaged(DamagedPlan::Id));
    assert_eq!(refusal(|p| p.trajectory.t_f = 0.0), UnmetCriterion::Duration { got: 0.0 }.into());
    assert_eq!(refusal(|p| p.trajectory.t_f = 60.1), UnmetCriterion::Duration { got: 60.1 }.into());
    let (config, x) = rest();
    sent(&resting(&config, &x, 60.0), &config).unwrap();
    assert!(refusal(|p| p.trajectory.t_f = -1.0).to_string().contains("-1 s"));
    assert!(refusal(|p| p.trajectory.t_f = f64::INFINITY).to_string().contains("inf"));
    assert!(matches!(
        refusal(|p| p.trajectory.t_f = f64::NAN),
        PlanRefusal::Criterion(UnmetCriterion::Duration { .. })
    ));
}

#[test]
fn numbers_that_are_not_finite() {
    for (part, refusal) in [
        ("x at knot 3", refusal(|p| p.trajectory.x[3][17] = f64::NAN)),
        ("u at knot 100", refusal(|p| p.trajectory.u[100][6] = f64::INFINITY)),
        ("f at knot 0", refusal(|p| p.f[0][0] = f64::NAN)),
        ("K at knot 51", refusal(|p| p.gains.knot_mut(51)[entry(6, 17)] = f64::NEG_INFINITY)),
        ("the final K", refusal(|p| p.gains.end_mut()[0] = f64::NAN)),
    ] {
        assert!(refusal.to_string().contains(part), "{refusal}");
    }
}

#[test]
fn limits_at_a_knot() {
    let text = refusal(|p| p.trajectory.x[4][1] = 2.5).to_string();
    assert!(
        text.contains("position of joint `joint_2` at knot 4.00 is 2.5000") && text.contains("2.0954"),
        "{text}"
    );
    let text = refusal(|p| p.trajectory.x[5].qd_mut()[3] = -0.8).to_string();
    assert!(text.contains("velocity of joint `joint_4` at knot 5.00 is -0.8000"), "{text}");
    let text = refusal(|p| p.trajectory.u[0][0] = 1000.0).to_string();
    assert!(
        text.contains("torque of joint `joint_1` at knot 0.00 is") && text.contains("168.0000"),
        "{text}"
    );
}

#[test]
fn every_limit_on_both_sides_up_to_its_slack() {
    let (config, x) = rest();
    let limits = &config.robot.planning;
    let limit_of = |joint: usize, number: usize, kind: LimitKind, unfit: Option<UnmetCriterion>| {
        matches!(unfit, Some(UnmetCriterion::Limit { kind: k, joint: j, knot, .. })
            if (k, j, knot) == (kind, joint, number as f64))
    };
    for i in 0..sizes().joints() {
        for knot in [0, 57, n(&config)] {
            for (bound, out) in [(limits.q_min[i], -1.0), (limits.q_max[i], 1.0)] {
                let at = |by: f64| verdict(&config, &x, |p| p.trajectory.x[knot][i] = bound + out * by);
                assert!(limit_of(i, knot, LimitKind::Position, at(1.1e-3)), "joint {i}, knot {knot}, {out}");
                assert!(!limit_of(i, knot, LimitKind::Position, at(0.9e-3)), "joint {i}, knot {knot}, {out}");
            }
            for out in [-1.0, 1.0] {
                let at = |by| {
                    verdict(&config, &x, |p| p.trajectory.x[knot].qd_mut()[i] = out * (limits.qd_max[i] + by))
                };
                assert!(limit_of(i, knot, LimitKind::Velocity, at(1.1e-2)), "joint {i}, knot {knot}, {out}");
                assert!(!limit_of(i, knot, LimitKind::Velocity, at(0.9e-2)), "joint {i}, knot {knot}, {out}");
            }
        }
    }
}

#[test]
fn every_torque_limit_on_both_sides_up_to_its_slack() {
    let (config, x) = rest();
    let torque = |u: &ActuatedVector| config.model.torque(&x, u, &mut Workspace::default());
    let still = torque(&ActuatedVector::zeros(sizes()));
    for i in 0..sizes().actuated() {
        let inertia = (torque(&unit(i)) - still)[i];
        // Little more than what holds the arm: more moves the pendulum out of its limits.
        let most = still[i].abs() + 0.5 * inertia;
        for (knot, out) in [(0, -1.0), (57, 1.0), (n(&config), -1.0)] {
            let u = unit(i) * (out * most - still[i]) / inertia;
            let at = |share: f64| {
                let mut config = config.clone();
                config.robot.planning.tau_max[i] = most / share;
                verdict(&config, &x, |p| p.trajectory.u[knot] = u)
            };
            let unfit = at(1.051);
            let expected = matches!(unfit, Some(UnmetCriterion::Limit { kind: LimitKind::Torque, joint, knot: k, .. })
                if joint == i && (k - knot as f64).abs() < 1.0);
            assert!(expected, "joint {i}, knot {knot}, {out}: {unfit:?}");
            let unfit = at(1.048);
            assert!(
                !matches!(unfit, Some(UnmetCriterion::Limit { .. })),
                "joint {i}, knot {knot}, {out}: {unfit:?}"
            );
        }
    }
}

#[test]
fn positions_between_knots() {
    // Both knots are within the limits; between them the spline (12) leaves them by a quarter of an interval times qd.
    let (config, x) = rest();
    let limits = &config.robot.planning;
    for out in [-1.0, 1.0] {
        let unfit = verdict(&config, &x, |p| {
            p.trajectory.t_f = 60.0;
            for (k, velocity) in [(4, 0.9 * limits.qd_max[1]), (5, -0.9 * limits.qd_max[1])] {
                p.trajectory.x[k][1] =
                    if out > 0.0 { limits.q_max[1] - 0.01 } else { limits.q_min[1] + 0.01 };
                p.trajectory.x[k].qd_mut()[1] = out * velocity;
            }
        });
        let Some(UnmetCriterion::Limit { kind: LimitKind::Position, joint: 1, knot, .. }) = unfit else {
            panic!("{unfit:?}")
        };
        assert_eq!(knot, 4.5);
    }
}

#[test]
fn velocities_between_knots_to_their_extremum() {
    // qd is on its limit at both knots, and its slope changes the sign: in the middle it is h/8 (qdd_5 - qdd_4) beyond.
    let (config, x) = rest();
    let fastest = config.robot.planning.qd_max[6];
    let h = 1.0 / n(&config) as f64;
    for (beyond, share) in [(0.0101, 0.5), (0.0099, 0.5), (0.0101, 0.047), (0.0099, 0.047)] {
        for out in [-1.0, 1.0] {
            // qd(s) = qd_4 + h (s a - s^2 (a + b) / 2) for the slopes a and -b at the knots has its extremum at a / (a + b).
            let a = 2.0 * beyond / (share * h);
            let b = a * (1.0 - share) / share;
            let unfit = verdict(&config, &x, |p| {
                p.trajectory.x[4].qd_mut()[6] = out * fastest;
                p.trajectory.u[4][6] = out * a;
                p.trajectory.x[5].qd_mut()[6] = out * (fastest - 0.1);
                p.trajectory.u[5][6] = -out * b;
            });
            let found = matches!(unfit, Some(UnmetCriterion::Limit { kind: LimitKind::Velocity, joint: 6, knot, .. })
                if (knot - 4.0 - share).abs() < 1e-9);
            assert_eq!(found, beyond > 0.01, "{beyond} at {share}: {unfit:?}");
        }
    }
}

#[test]
fn a_limit_just_before_a_knot() {
    // Without an extremum: the spline rises to beyond the limit, and the knot, by a defect that one QP may leave, has it back.
    let (mut config, x) = rest();
    config.planner.replan.iterations = 1;
    config.robot.planning.qd_max[6] = 0.002;
    let before = |beyond: f64| {
        verdict(&config, &x, |p| {
            (p.trajectory.x[4].qd_mut()[6], p.trajectory.x[5].qd_mut()[6]) = (0.001, 0.001);
            // h/2 (u_4 + u_5)
            (p.trajectory.u[4][6], p.trajectory.u[5][6]) =
                (100.0 * (0.001 + beyond), 100.0 * (0.001 + beyond));
        })
    };
    let unfit = before(0.0101);
    assert!(
        matches!(unfit, Some(UnmetCriterion::Limit { kind: LimitKind::Velocity, joint: 6, knot: 5.0, .. })),
        "{unfit:?}"
    );
    assert_eq!(before(0.0099), None);
}

#[test]
fn torques_between_knots() {
    // On its way between two knots the arm passes a pose that needs more torque.
    let (mut config, x) = rest();
    let spoil = |p: &mut Plan| {
        p.trajectory.t_f = 60.0;
        (p.trajectory.x[4].qd_mut()[1], p.trajectory.x[5].qd_mut()[1]) = (0.7, -0.7);
        // The other way before and after.
        (p.trajectory.x[3].qd_mut()[1], p.trajectory.x[6].qd_mut()[1]) = (-0.7, 0.7);
    };
    let torque = |by: f64| {
        let mut x = x;
        x[1] += by;
        config.model.torque(&x, &ActuatedVector::zeros(sizes()), &mut Workspace::default())[1].abs()
    };
    let (at_knots, between) = (torque(0.0), torque(0.7 * 0.6 / 4.0));
    assert!(between > at_knots + 1.0, "{at_knots} N m, {between} N m");
    config.robot.planning.tau_max[1] = 0.5 * (at_knots + between) / 1.05;
    let unfit = verdict(&config, &x, spoil);
    assert!(
        matches!(unfit, Some(UnmetCriterion::Limit { kind: LimitKind::Torque, joint: 1, knot, .. }) if knot > 4.0 && knot < 5.0),
        "{unfit:?}"
    );
}

#[test]
fn a_motion_that_jumps() {
    let (config, x) = rest();
    // The arm is 0.3 rad further on from knot 40 to knot 59, and rests wherever it is.
    let unfit =
        verdict(&config, &x, |p| p.trajectory.x[40..60].iter_mut().for_each(|x| x[0] += 0.3)).unwrap();
    let text = unfit.to_string();
    assert!(text.contains("position of joint `joint_1` jumps by 3.00e-1 rad before knot 40"), "{text}");
    assert!(text.contains("at most 1e-3"), "{text}");
    // Every row, at every knot, in both directions.
    for row in 0..sizes().state() {
        for (knot, sign) in [(1, 1.0), (50, -1.0), (n(&config) - 1, 1.0)] {
            let jumps = |by| verdict(&config, &x, |p| p.trajectory.x[knot][row] += sign * by);
            let unfit = jumps(1.5e-3);
            let Some(UnmetCriterion::Defect { kind, joint, knot: at, got, .. }) = unfit else {
                panic!("row {row}: {unfit:?}")
            };
            assert_eq!(((kind, joint), at), (LimitKind::of_row(row, sizes()), knot));
            assert!((1.0e-3..2e-3).contains(&got), "{got}");
            assert_eq!(jumps(0.8e-3), None, "row {row}, knot {knot}");
        }
    }
}

#[test]
fn the_papers_mode_has_a_larger_defect_of_its_own() {
    let (mut config, x) = rest();
    let jumps = |config: &Config, by| verdict(config, &x, |p| p.trajectory.x[50][0] += by);
    assert!(matches!(jumps(&config, 0.04), Some(UnmetCriterion::Defect { most: 1e-3, .. })));
    config.planner.replan.iterations = 1;
    assert_eq!(jumps(&config, 0.04), None);
    assert!(matches!(jumps(&config, 0.06), Some(UnmetCriterion::Defect { most: 0.05, .. })));
}

#[test]
fn half_the_duration() {
    let (config, [mut plan, _]) = planned(0.01, START);
    plan.trajectory.t_f *= 0.5;
    let refusal = sent(&plan, &config).unwrap_err();
    assert!(matches!(refusal, PlanRefusal::Criterion(UnmetCriterion::Defect { .. })), "{refusal}");
}

#[test]
fn gains_that_drive_away_from_the_plan() {
    let (config, [good, _]) = planned(0.01, START);
    let verdict = |spoil: &dyn Fn(&mut Plan)| {
        let mut plan = good.clone();
        spoil(&mut plan);
        let refusal = sent(&plan, &config).unwrap_err();
        assert!(refusal.to_string().len() < 200, "fits into an answer: {refusal}");
        let PlanRefusal::Criterion(unfit) = refusal else { panic!("{refusal}") };
        unfit
    };
    let all = 0..=n(&config);
    let unfit = verdict(&|p| scale(p, all.clone(), -1.0));
    assert!(
        matches!(unfit, UnmetCriterion::Amplification { knot, got, .. } if knot > 80 && got > 100.0),
        "{unfit}"
    );
    let unfit = verdict(&|p| scale(p, 40..60, -1.0));
    assert!(matches!(unfit, UnmetCriterion::Amplification { knot: 40..60, .. }), "{unfit}");
    // Their mean is right.
    let unfit = verdict(&|p| {
        all.clone().for_each(|k| scale(p, [k], if k % 2 == 0 { 11.0 } else { -9.0 }));
    });
    assert!(matches!(unfit, UnmetCriterion::Amplification { .. }), "{unfit}");
    let unfit = verdict(&|p| scale(p, all.clone(), 0.0));
    assert!(matches!(unfit, UnmetCriterion::Amplification { .. }), "{unfit}");
}

/// The amplification of the closed loop from `knot` on: plant (19), filter and delay simulated one after the other for the
/// deviation of each row by its tolerance; half of an interval with A, B and K of one knot, half with those of the next.
fn amplification(config: &Config, plan: &Plan, knot: usize, stands: bool) -> f64 {
    let n = n(config);
    let tolerance = tolerances(config);
    let ts = common::PERIOD;
    let half = (0.5 * plan.trajectory.h() / ts).round() as usize;
    let t_1 = config.daemon.cycle.velocity_filter;
    let at = |k: usize| {
        let (x, u, gain) = if k <= n {
            (&plan.trajectory.x[k], plan.trajectory.u[k], plan.gains.knot(k))
        } else {
            (plan.trajectory.end(), ActuatedVector::zeros(sizes()), plan.gains.end())
        };
        let mut d = Linearization::new(sizes());
        config.model.linearize(x, &u, &mut Workspace::default(), &mut d);
        (d.a(), d.b(), gain)
    };
    // dx/dt of (19)
    let slope = |a: &DMatrix<f64>, b: &DMatrix<f64>, x: &State, u: &ActuatedVector| {
        let rate = a * DVector::from_column_slice(x) + b * DVector::from_column_slice(u);
        State::from_slice(sizes(), rate.as_slice()).unwrap()
    };
    let loops: Vec<_> = (0..=n + 1).map(at).collect();
    // After its end the plan is held.
    let last = if stands { n + 500 } else { n };
    let from = |row: usize| {
        let mut x = State::zeros(sizes());
        x[row] = tolerance[row];
        let mut z = x.q() - x.qd() * t_1;
        let mut on_its_way = ActuatedVector::zeros(sizes());
        let mut sum = 0.0;
        for k in knot..=last {
            sum += x.component_div(&tolerance).norm_squared();
            let halves = if k < n { [k, k + 1] } else { [n + 1, n + 1] };
            for (a, b, gain) in halves.map(|k| &loops[k]) {
                for _ in 0..half {
                    let q = x.q();
                    let u = InterpolatedGain::from(*gain).times(&State::new(&q, &((q - z) / t_1)));
                    z += (q - z) * (1.0 - (-ts / t_1).exp());
                    // Heun's method.
                    let before = slope(a, b, &x, &on_its_way);
                    let after = slope(a, b, &(x + before * ts), &on_its_way);
                    x += (before + after) * (0.5 * ts);
                    on_its_way = u;
                }
            }
        }
        sum.sqrt()
    };
    (0..sizes().state()).map(from).fold(0.0, f64::max)
}

/// Start tolerance of each row of the state.
fn tolerances(config: &Config) -> State {
    let StartTolerance { position, velocity } = config.daemon.start;
    State::new(&position, &velocity)
}

#[test]
fn the_amplification_is_that_of_a_simulation() {
    let (config, [up, down]) = planned(0.01, START);
    let n = n(&config);
    let check = |plan: &Plan, stands: bool, position: f64, velocity: f64, spoil: &dyn Fn(&mut Plan)| {
        let mut config = config.clone();
        config.daemon.start =
            StartTolerance { position: common::all(position), velocity: common::all(velocity) };
        let mut plan = plan.clone();
        spoil(&mut plan);
        let refusal = sent(&plan, &config).unwrap_err();
        let PlanRefusal::Criterion(UnmetCriterion::Amplification { knot, got, .. }) = refusal else {
            panic!("{refusal}")
        };
        let expected = amplification(&config, &plan, knot, stands);
        assert!((got / expected - 1.0).abs() < 0.01, "at knot {knot} {got}, expected {expected}");
        // It is the last knot with so much of it.
        let later = if knot < n { amplification(&config, &plan, knot + 1, stands) } else { 0.0 };
        assert!(expected > 100.0 && later < 101.0, "at knot {knot} {expected}, then {later}");
        knot
    };
    let opposite = |p: &mut Plan| scale(p, 0..=n, -1.0);
    assert!(check(&up, true, 0.05, 0.2, &opposite) < n);
    assert!(check(&down, false, 0.05, 0.2, &opposite) < n);
    // With so little tolerance for velocities the angles are what matters, and the other way round.
    assert_eq!(check(&up, true, 0.05, 1e-3, &|_| ()), n);
    assert_eq!(check(&up, true, 1e-3, 0.2, &|_| ()), n);
    // Where nothing is held at the end, the gains of the last two knots are.
    assert_eq!(check(&down, false, 0.05, 2e-4, &|p| scale(p, [n], -3.0)), n - 1);
}

#[test]
fn gains_that_answer_a_tolerated_start_with_a_blow() {
    let (config, [good, _]) = planned(0.01, START);
    let n = n(&config);
    let verdict = |spoil: &dyn Fn(&mut Plan)| {
        let mut plan = good.clone();
        spoil(&mut plan);
        sent(&plan, &config).map(|_| ())
    };
    for knot in [0, 33, n] {
        for row in [0, sizes().state() - 1] {
            let tolerance = tolerances(&config)[row];
            let mut work = Workspace::default();
            config.model.hybrid_dynamics(&good.trajectory.x[knot], &good.trajectory.u[knot], &mut work);
            // Each joint has its own limit; towards either side.
            for (of, limits) in [(0, 6.0), (0, -6.0), (6, 6.0), (6, -6.0)] {
                let limit = config.robot.limits.tau_max[of];
                // The torque of the joint for 1 rad/s^2.
                let inertia = config.model.reduced_inertia_times(&unit(of), &mut work)[of];
                let blow = limits * limit / inertia / tolerance;
                let refusal = verdict(&|p| p.gains.knot_mut(knot)[entry(of, row)] += blow).unwrap_err();
                let expected = matches!(
                    refusal,
                    PlanRefusal::Criterion(UnmetCriterion::Step { knot: k, joint, most, got, .. })
                        if (k, joint, most) == (knot, of, 5.0 * limit)
                            && (got - 6.0 * limit).abs() < 0.7 * limit
                );
                assert!(expected, "{refusal}");
            }
        }
    }
    let refusal = verdict(&|p| p.gains.end_mut()[0] = 1e9).unwrap_err();
    assert!(
        matches!(refusal, PlanRefusal::Criterion(UnmetCriterion::Step { knot, joint: 0, .. }) if knot == n + 1),
        "{refusal}"
    );
}

#[test]
fn a_final_gain_that_lets_the_rod_fall() {
    let config = config();
    let x = at_rest(&upright_pose());
    let mut plan = resting(&config, &x, 1.0);
    sent(&plan, &config).unwrap();
    // The arm is held, the rod is nobody's concern.
    plan.gains.end_mut().copy_from_slice(&held(sizes()));
    let refusal = sent(&plan, &config).unwrap_err();
    assert!(
        matches!(refusal, PlanRefusal::Criterion(UnmetCriterion::Unstable { radius }) if radius > 1.0 && radius < 1.01),
        "{refusal}"
    );
    // So strong that one period overshoots.
    for i in 0..sizes().actuated() {
        plan.gains.end_mut()[entry_qd(i, i)] = -2.1 / common::PERIOD;
    }
    assert!(sent(&plan, &config).is_err());
}

#[test]
fn a_final_gain_is_judged_with_filter_and_delay() {
    // More damping of joint 5. With the filter it stands up to a delay of the inverse of the damping, without it to about
    // pi / 2 of that; half a period is the hold's.
    let stands = |damping: f64, delay: usize, velocity: VelocityEstimate| {
        let mut config = config();
        config.daemon.plans.delay = delay;
        config.daemon.cycle.velocity = velocity;
        let mut plan = resting(&config, &at_rest(&upright_pose()), 1.0);
        plan.gains.end_mut()[entry_qd(4, 4)] -= damping;
        match sent(&plan, &config) {
            Ok(_) => true,
            Err(PlanRefusal::Criterion(UnmetCriterion::Unstable { radius })) if radius > 1.0 => false,
            Err(refusal) => panic!("{damping}, {delay}, {velocity:?}: {refusal}"),
        }
    };
    assert!(stands(600.0, 8, VelocityEstimate::Filter));
    assert!(!stands(1200.0, 8, VelocityEstimate::Filter));
    assert!(stands(1200.0, 1, VelocityEstimate::Filter));
    assert!(stands(1200.0, 8, VelocityEstimate::Model));
    assert!(!stands(1800.0, 8, VelocityEstimate::Model));
}

#[test]
fn an_old_plan() {
    let (config, x) = rest();
    let mut controller = Controller::new(&config);
    let q = x.q();
    let seconds = |s: f64| (s / common::PERIOD) as u64;
    controller.step(StepInput::new(
        common::measurement(1, &q),
        0,
        Some(StepRequest::Load(rest_plan(&config, &x, 1.0))),
    ));
    let mut at = |s: f64| {
        let m = common::measurement(seconds(s), &q);
        controller.step(StepInput::new(m, 0, Some(StepRequest::Enable)));
        let m = common::measurement(seconds(s) + 1, &q);
        let output = controller.step(StepInput::new(m, 0, Some(StepRequest::Start(7))));
        let warned = output.record.telemetry.warnings & TripCause::PlanAge.bit() != 0;
        controller.step(StepInput::new(m, 0, Some(StepRequest::Stop)));
        (output.answer.unwrap(), warned)
    };
    // The levels are 60 s and 600 s.
    let (answer, warned) = at(601.0);
    assert!(matches!(answer, Err(RequestRefusal::PlanExpired { limit: 600.0, .. })), "{answer:?}");
    assert!(warned);
}

#[test]
fn a_plan_ages_by_the_clock_of_the_plant_that_is_there() {
    let (config, x) = rest();
    let q = x.q();
    let seconds = |s: f64| (s / common::PERIOD) as u64;
    let start_after = |loaded_at: u64, restarts: bool, s: f64| {
        let mut controller = Controller::new(&config);
        let plan = rest_plan(&config, &x, 1.0);
        if loaded_at == 0 {
            // Before there is a plant, in the 1000th second of the machine.
            controller.step(StepInput::new(
                Measurement::default(),
                1_000_000_000_000,
                Some(StepRequest::Load(plan)),
            ));
        } else {
            controller.step(StepInput::new(
                common::measurement(loaded_at, &q),
                0,
                Some(StepRequest::Load(plan)),
            ));
        }
        let first = StepInput::new(common::measurement(1, &q), 0, None);
        controller.step(StepInput { restarted: restarts, ..first });
        let now = seconds(s);
        controller.step(StepInput::new(common::measurement(now, &q), 0, Some(StepRequest::Enable)));
        let output =
            controller.step(StepInput::new(common::measurement(now + 1, &q), 0, Some(StepRequest::Start(7))));
        output.answer.unwrap()
    };
    for (loaded_at, restarts) in [(0, false), (seconds(5000.0), true), (seconds(5000.0), false)] {
        let answer = start_after(loaded_at, restarts, 601.0);
        assert!(
            matches!(answer, Err(RequestRefusal::PlanExpired { .. })),
            "{loaded_at}, {restarts}: {answer:?}"
        );
        assert_eq!(start_after(loaded_at, restarts, 50.0), Ok(()), "{loaded_at}, {restarts}");
    }
}

#[test]
fn no_time_passes_before_there_is_a_plant() {
    let (config, _) = rest();
    let mut controller = Controller::new(&config);
    let request = Some(StepRequest::Enable);
    let output = controller.step(StepInput::new(Measurement::default(), 1_000_000_000_000, request));
    assert!(output.answer.is_some_and(|answer| answer.is_err()));
    assert_eq!((output.record.telemetry.seq, output.record.telemetry.t_ns), (0, 0));
}

#[test]
fn a_plan_that_arrives_while_one_is_tracked() {
    let (config, x) = rest();
    for (setting, refused) in [(PlanWhileTracking::Queue, false), (PlanWhileTracking::Refuse, true)] {
        let mut config = config.clone();
        config.daemon.plans.while_tracking = setting;
        let mut controller = Controller::new(&config);
        let mut arm = common::Arm::new(&config, x);
        let mut step = |request| controller.step(StepInput::new(arm.measure(), 0, Some(request)));
        for request in
            [StepRequest::Enable, StepRequest::Load(rest_plan(&config, &x, 1.0)), StepRequest::Start(7)]
        {
            assert_eq!(step(request).answer, Some(Ok(())));
        }
        let output = step(StepRequest::Load(rest_plan(&config, &x, 1.0)));
        let expected = if refused { Err(RequestRefusal::Tracking { running: 7 }) } else { Ok(()) };
        assert_eq!(output.answer, Some(expected));
        assert_eq!((output.retired[0].is_some(), output.record.telemetry.plan_id), (refused, 7));
    }
}

#[test]
fn derivatives_of_another_model() {
    let text = refusal(|p| p.f[9][12] += 0.01).to_string();
    assert!(text.contains("f at knot 9, row 12"), "{text}");
    let (config, x) = rest();
    for row in 0..sizes().state() {
        for (knot, sign) in [(0, 1.0), (57, -1.0), (n(&config), 1.0)] {
            let differs = |by: f64| {
                let mut plan = resting(&config, &x, 1.0);
                plan.f[knot][row] += sign * by;
                sent(&plan, &config)
            };
            let refusal = differs(2e-6).unwrap_err();
            let expected = matches!(
                refusal, PlanRefusal::Criterion(UnmetCriterion::Derivative { knot: k, row: r, .. }) if (k, r) == (knot, row)
            );
            assert!(expected, "{refusal}");
            assert!(differs(5e-7).is_ok(), "row {row}, knot {knot}");
        }
    }
}

#[test]
fn an_end_that_neither_stands_nor_hangs() {
    let (config, x) = rest();
    let mut moving = x;
    moving.qd_mut()[0] = 0.02;
    // So short that nothing jumps.
    let ends = |x: &State| sent(&resting(&config, x, 0.01), &config).map(|_| ());
    let text = ends(&moving).unwrap_err().to_string();
    assert!(text.contains("ends at 0.0200 rad/s") && text.contains("at most 0.01 rad/s"), "{text}");
    let mut leaning = x;
    leaning[8] += 0.3;
    let text = ends(&leaning).unwrap_err().to_string();
    assert!(
        text.contains("joints accelerate with") && text.contains("at most 0.01 rad/s and 0.5 rad/s^2"),
        "{text}"
    );
    // Both ways to end are accepted, a hair from equilibrium and from rest, too.
    for q in [rest_pose(&config), upright_pose()] {
        for sign in [-1.0, 1.0] {
            for joint in 0..sizes().joints() {
                let at = |speed: f64| {
                    let mut x = at_rest(&q);
                    x.qd_mut()[joint] = sign * speed;
                    ends(&x)
                };
                assert_eq!(at(0.009), Ok(()));
                let refusal = at(0.011).unwrap_err();
                assert!(matches!(refusal, PlanRefusal::Criterion(UnmetCriterion::End { .. })), "{refusal}");
            }
            let at = |tilt: f64| {
                let mut x = at_rest(&q);
                x[8] += sign * tilt;
                ends(&x)
            };
            assert_eq!(at(0.016), Ok(()));
            let refusal = at(0.02).unwrap_err();
            assert!(matches!(refusal, PlanRefusal::Criterion(UnmetCriterion::End { .. })), "{refusal}");
        }
    }
}

#[test]
fn start_elsewhere() {
    let (config, x) = rest();
    let mut controller = Controller::new(&config);
    let mut arm = common::Arm::new(&config, x);
    let mut step = |request| controller.step(StepInput::new(arm.measure(), 0, Some(request))).answer.unwrap();
    step(StepRequest::Enable).unwrap();
    assert_eq!(step(StepRequest::Start(7)), Err(RequestRefusal::NoPlan));
    let mut elsewhere = x;
    elsewhere[2] += 0.1;
    step(StepRequest::Load(rest_plan(&config, &elsewhere, 1.0))).unwrap();
    let refusal = step(StepRequest::Start(7)).unwrap_err();
    let expected = RequestRefusal::StartMismatch {
        joint: 2,
        velocity: false,
        measured: x[2],
        expected: elsewhere[2],
        t_plan: 0.0,
        tolerance: config.daemon.start.position[2],
    };
    assert_eq!(refusal, expected);
    assert!(
        refusal
            .text(&config.model)
            .contains("joint `joint_3` is at 0.0000 rad, the plan at t = 0.000 s at 0.1000 rad"),
        "{refusal:?}"
    );
    let mut moving = rest_plan(&config, &x, 1.0);
    moving.trajectory.x[0].qd_mut()[0] = 0.3;
    step(StepRequest::Load(moving)).unwrap();
    let text = step(StepRequest::Start(7)).unwrap_err().text(&config.model);
    assert!(text.contains("joint `joint_1`") && text.contains("0.3000 rad/s"), "{text}");
}
