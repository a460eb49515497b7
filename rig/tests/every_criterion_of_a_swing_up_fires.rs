//! Each success criterion of a swing-up holds for a good run, and fails for the same run with one change.

use upswing_config::Config;
use upswing_ipc::{Mode, PlannerResponse, Telemetry};
use upswing_model::JointVector;
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_rig::closed_loop::{Disturbances, RunOptions, swing_up};

/// Time in Balance, s.
const SECONDS: f64 = 2.0;

/// What is said of the records after `change`.
fn failures(config: &Config, good: &[Telemetry], change: impl Fn(&mut Vec<Telemetry>)) -> Vec<String> {
    let mut records = good.to_vec();
    change(&mut records);
    SwingUpEvaluation::new(config, &PlannerResponse::default(), &records, 0, SECONDS, None).failures
}

fn in_mode(records: &mut [Telemetry], mode: Mode) -> impl Iterator<Item = &mut Telemetry> {
    records.iter_mut().filter(move |r| r.mode() == Ok(mode))
}

#[test]
fn each_alone() {
    let config = Config::embedded().expect("embedded settings");
    let planner = Planner::new(config.clone()).expect("the embedded database fits the settings");
    let plant = Plant::new(&config).expect("a possible start");
    let mut good = Vec::new();
    let none = |_| Disturbances::default();
    let report = swing_up(
        &planner,
        &mut planner.solver(),
        &config,
        plant,
        SECONDS,
        none,
        RunOptions::default(),
        &mut good,
    )
    .expect("runs to its end");
    assert_eq!(report.failures, [""; 0], "a good run");
    let limits = &config.robot.limits;

    let only = |failures: Vec<String>, words: &str| {
        assert!(failures.len() == 1 && failures[0].contains(words), "{words}: {failures:?}");
    };
    let fast = |joint: usize| {
        move |records: &mut Vec<Telemetry>| {
            let record = in_mode(records, Mode::Track).nth(1000).expect("a swing of more than 1000 cycles");
            record.qd[joint] = -1.01 * limits.qd_max[joint];
        }
    };
    for joint in 0..7 {
        only(failures(&config, &good, fast(joint)), "a velocity reached 101 % of its limit");
    }
    for joint in 7..9 {
        only(
            failures(&config, &good, fast(joint)),
            "an unactuated joint reached 101 % of its velocity limit",
        );
    }
    let cut = |every: usize| {
        move |records: &mut Vec<Telemetry>| {
            records.iter_mut().step_by(every).for_each(|record| record.flags |= Telemetry::LIMITED);
        }
    };
    only(failures(&config, &good, cut(50)), "torques were cut at their limit in 2.0 % of the cycles");
    assert_eq!(failures(&config, &good, cut(200)), [""; 0], "half of a hundredth is tolerated");
    only(
        failures(&config, &good, |records| {
            // In the middle of the last second, though not in its last cycle.
            let count = in_mode(records, Mode::Balance).count();
            let record = in_mode(records, Mode::Balance).nth(count - 4000).expect("half a second");
            record.q[8] += 3.0_f64.to_radians();
        }),
        "deg from the end of the plan in the last second",
    );
    only(
        failures(&config, &good, |records| {
            in_mode(records, Mode::Balance).last().expect("a balance").qd[3] = 0.051;
        }),
        "the actuated joints move at 0.051 rad/s",
    );
    only(failures(&config, &good, |records| records.truncate(records.len() - 100)), "balanced 1.98");
    only(
        failures(&config, &good, |records| {
            in_mode(records, Mode::Track).last().expect("a swing").q[1] = limits.q_max[1] + 2e-4;
        }),
        "joint `joint_2` went 0.00020 rad past its position limit",
    );

    // What the simulated plant knows counts, whatever the filter shows.
    for (joint, words) in [(3, "a velocity reached 120 %"), (8, "an unactuated joint reached 120 %")] {
        let mut fastest = JointVector::zeros(config.model.sizes());
        fastest[joint] = 1.2 * limits.qd_max[joint];
        let response = PlannerResponse::default();
        only(SwingUpEvaluation::new(&config, &response, &good, 0, SECONDS, Some(&fastest)).failures, words);
    }
    only(
        SwingUpEvaluation::new(&config, &PlannerResponse::default(), &good, 3, SECONDS, None).failures,
        "3 telemetry records were lost",
    );
}
