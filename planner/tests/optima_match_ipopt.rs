//! From each of the eight starts solved with IPOPT, the offline optimisation finds a trajectory of at most 0.5 % higher cost,
//! with defects up to 1e-8 and within all limits.

use serde::Deserialize;
use upswing_config::{Config, PendulumStart, TorqueForm};
use upswing_model::Workspace;
use upswing_ocp::interior_point::NlpStatus;
use upswing_ocp::multistart::Search;
use upswing_planner::offline::{optimize, options, problem, target};
use upswing_trajectory::Trajectory;

#[derive(Deserialize)]
struct Reference {
    trajectories: Vec<Known>,
}

#[derive(Deserialize)]
struct Known {
    start_deg: Vec<f64>,
    start_q9_deg: f64,
    cost: f64,
}

fn assert_limits(config: &Config, trajectory: &Trajectory) {
    // The interior-point method satisfies bounds strictly, and torque limits to its tolerance, through slacks.
    const SLACK: f64 = 1e-6;
    let limits = &config.robot.planning;
    let problem = problem(config, target(config, 0, &[]).expect("a target"), trajectory.x[0]);
    let (low, high) = problem.torque.bounds(&limits.tau_max);
    let mut work = Workspace::default();
    for (k, (x, u)) in trajectory.knots().enumerate() {
        for (i, (q, qd)) in x.q().iter().zip(x.qd().iter()).enumerate() {
            let within = (limits.q_min[i] - SLACK)..=(limits.q_max[i] + SLACK);
            assert!(within.contains(q), "q{} at knot {k}", i + 1);
            assert!(qd.abs() <= limits.qd_max[i] + SLACK, "qd{} at knot {k}", i + 1);
        }
        let tau = match config.planner.offline.torque {
            TorqueForm::Exact => config.model.torque(x, u, &mut work),
            TorqueForm::Paper => config.model.torque_without_coriolis(x, u, &mut work),
        };
        for (i, tau) in tau.iter().enumerate() {
            assert!(*tau >= low[i] - SLACK && *tau <= high[i] + SLACK, "tau{} at knot {k}", i + 1);
        }
    }
}

fn check(torque: TorqueForm) {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.offline.torque = torque;
    let reference: Reference =
        serde_json::from_str(include_str!("data/ipopt.json")).expect("reference data parses");
    assert_eq!(reference.trajectories.len(), 8);
    for known in reference.trajectories {
        let q: Vec<f64> = known.start_deg.iter().map(|d| d.to_radians()).collect();
        let start = config.start_state(&q, PendulumStart::Rest).expect("a start at rest");
        assert!((start.q_u()[1].to_degrees() - known.start_q9_deg).abs() < 1e-9);
        let solution = optimize(
            &problem(&config, target(&config, 0, &[]).expect("a target"), start),
            Search::First,
            &[],
            &options(&config),
        );
        let name = format!("{:?} ({torque:?})", known.start_deg);
        assert_eq!(solution.status, NlpStatus::Solved, "{name}");
        let defect = solution.trajectory.defect(&config.model);
        assert!(defect <= 1e-8, "{name}: defect {defect:e}");
        assert!((solution.trajectory.x[0] - start).amax() == 0.0, "{name}: another start");
        for row in target(&config, 0, &[]).expect("a target") {
            let miss = row.coefficients.dot(solution.trajectory.end()) - row.value;
            assert!(miss.abs() <= 1e-8, "{name}: target missed by {miss:e}");
        }
        assert_limits(&config, &solution.trajectory);
        assert!(solution.cost <= 1.005 * known.cost, "{name}: cost {} vs {}", solution.cost, known.cost);
    }
}

#[test]
fn with_the_papers_torque_constraint() {
    check(TorqueForm::Paper);
}

#[test]
fn with_the_exact_torque_constraint() {
    check(TorqueForm::Exact);
}
