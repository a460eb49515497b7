//! Continuous replanning: the rest of a running plan is planned again from the measured state.

use upswing_config::{Config, PendulumStart};
use upswing_model::{ActuatedVector, State};
use upswing_planner::continuous::{ContinuousReplanning, TrackedMotion};
use upswing_planner::replan::Planner;
use upswing_trajectory::Plan;

const LEAD_NS: u64 = 20_000_000;
const LEAD: f64 = 0.02;

fn planner() -> (Planner, Plan) {
    let config = Config::embedded().expect("embedded settings");
    let q_a = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0].map(f64::to_radians);
    let q_a = ActuatedVector::from_fn(config.model.sizes(), |i| q_a[i]);
    let start = config.start_state(&q_a, PendulumStart::Rest).expect("a start at rest");
    let planner = Planner::new(config).expect("a database");
    let plan = planner.replan(&start, 10, None).expect("a plan").plan(planner.config());
    (planner, plan)
}

/// What is measured at the time `t` of a motion that follows `plan`: velocities lag.
fn measured(planner: &Planner, plan: &Plan, t: f64) -> State {
    let lag = planner.config().daemon.cycle.velocity_filter;
    let mut x = plan.spline().state(t);
    let gained = plan.spline().derivative(t).qd() * lag;
    x.qd_mut().iter_mut().zip(gained.iter()).for_each(|(v, gained)| *v -= gained);
    x
}

/// Largest residual of the target at the end of a plan.
fn miss(plan: &Plan, of: &Plan) -> f64 {
    // Only the sum of the pitching joints is given, so that their positions may change.
    let (x, end) = (plan.trajectory.end(), of.trajectory.end());
    let free = |i: &usize| ![1, 3, 5].contains(i);
    let pitch = |x: &State| x[1] - x[3] + x[5];
    let rows = (0..x.len()).filter(free).map(|i| (x[i] - end[i]).abs());
    rows.fold((pitch(x) - pitch(end)).abs(), f64::max)
}

#[test]
fn on_the_plan_nothing_changes() {
    let (planner, plan) = planner();
    let mut replanning = ContinuousReplanning::new(&planner, 0, &[], &plan).expect("a target");
    for t in [0.2, 0.6, 1.0, 1.4, 1.7] {
        let x = measured(&planner, &plan, t);
        let motion = TrackedMotion { plan: &plan, t, x, t_ns: 5_000_000 };
        let again = replanning.step(&motion, LEAD_NS).expect("a plan").expect("enough is left");
        assert_eq!((again.activation_ns, again.replaces), (Some(5_000_000 + LEAD_NS), Some(plan.id)));
        let left = plan.trajectory.t_f - t - LEAD;
        let longer = again.trajectory.t_f - left;
        // The knots are others, and limits act at the knots.
        assert!(longer.abs() < 0.02 * left, "t = {t} s: {longer} s longer");
        let expected = plan.spline().state(t + LEAD);
        let off = (again.trajectory.start().q() - expected.q()).amax();
        // The lag of the velocities is known to first order only.
        assert!(off < 0.2 * planner.config().daemon.start.position[0], "t = {t} s: begins {off} rad off");
        assert!(miss(&again, &plan) < 1e-5, "t = {t} s: misses the target by {}", miss(&again, &plan));
        planner.config().replacement_criteria().check(&planner.config().model, &again).expect("acceptable");
    }
}

#[test]
fn a_disturbed_motion_still_ends_at_the_target() {
    let (planner, plan) = planner();
    let mut replanning = ContinuousReplanning::new(&planner, 0, &[], &plan).expect("a target");
    for (t, joint, speed) in [(0.3, 7, 0.3), (0.8, 7, -0.3), (0.8, 8, 0.2), (1.2, 3, 0.1), (1.5, 7, 0.2)] {
        let mut x = measured(&planner, &plan, t);
        x.qd_mut()[joint] += speed;
        let motion = TrackedMotion { plan: &plan, t, x, t_ns: 0 };
        let again = replanning.step(&motion, LEAD_NS).expect("a plan").expect("enough is left");
        assert!(miss(&again, &plan) < 1e-5, "t = {t} s: misses the target by {}", miss(&again, &plan));
        let gained = again.trajectory.start().qd()[joint] - plan.spline().state(t + LEAD).qd()[joint];
        assert!(gained * speed > 0.0, "t = {t} s: begins with the disturbed motion, {gained} rad/s");
        planner.config().replacement_criteria().check(&planner.config().model, &again).expect("acceptable");
    }
}

#[test]
fn equal_motions_give_equal_plans() {
    let (planner, plan) = planner();
    let run = || {
        let mut replanning = ContinuousReplanning::new(&planner, 0, &[], &plan).expect("a target");
        [0.5, 0.52, 0.54].map(|t| {
            let motion = TrackedMotion { plan: &plan, t, x: measured(&planner, &plan, t), t_ns: 0 };
            replanning.step(&motion, LEAD_NS).expect("a plan")
        })
    };
    assert_eq!(run(), run());
}

#[test]
fn a_short_rest_is_left_as_it_is() {
    let (planner, plan) = planner();
    let mut replanning = ContinuousReplanning::new(&planner, 0, &[], &plan).expect("a target");
    let shortest = planner.config().planner.continuous.shortest_rest;
    let mut at = |left: f64| {
        let t = plan.trajectory.t_f - left - LEAD;
        let motion = TrackedMotion { plan: &plan, t, x: measured(&planner, &plan, t), t_ns: 0 };
        replanning.step(&motion, LEAD_NS).expect("no failure").is_some()
    };
    assert!(at(shortest + 1e-3));
    assert!(!at(shortest - 1e-3));
}
