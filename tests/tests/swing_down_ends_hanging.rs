//! After a swing-up and balance, a swing-down brings the pendulum to rest hanging, without exceeding a limit; the arm then
//! holds, and a swing-up can follow.

use upswing_ipc::operator::Manoeuvre;
use upswing_ipc::{Clock, Mode};
use upswing_model::{NQ, NU};
use upswing_rig::course::{SessionCourse, execute};
use upswing_tests::System;

#[test]
fn and_a_second_swing_up_follows() {
    up_down_and_up([-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
}

#[test]
fn where_joint_4_is_on_its_limit_too() {
    up_down_and_up([-60.0, -30.0, 0.0, -120.0, 0.0, -20.0, 0.0]);
}

fn up_down_and_up(start_deg: [f64; 7]) {
    let mut system = System::start(Clock::Lockstep, start_deg);
    let report = system.swing_up(3.0);
    assert!(report.success, "{report}");
    let period = system.period();
    let before = system.session.records.len();
    let go = |system: &mut System, manoeuvre| {
        execute(&mut SessionCourse::new(&mut system.session, period), manoeuvre, period, 1.0)
            .unwrap_or_else(|e| panic!("{e}"))
    };
    let plan = go(&mut system, Manoeuvre::SwingDown);
    assert!(plan.margin_q >= 0.0 && plan.margin_qd >= 0.0 && plan.margin_tau >= 0.0, "{plan:?}");

    let down = &system.session.records[before..];
    let limits = &system.config.robot.limits;
    for record in down {
        for i in 0..NU {
            assert!(record.tau[i].abs() <= limits.tau_max[i], "torque {} of joint {}", record.tau[i], i + 1);
        }
        for i in 0..NQ {
            assert!(record.qd[i].abs() <= limits.qd_max[i], "speed {} of joint {}", record.qd[i], i + 1);
        }
    }
    let error = |record: &upswing_ipc::Telemetry| {
        (0..NQ).map(|i| (record.q[i] - record.q_d[i]).abs()).fold(0.0, f64::max)
    };
    let tracked = down.iter().filter(|r| r.mode() == Ok(Mode::Track)).map(error).fold(0.0, f64::max);
    assert!(tracked > 0.0 && tracked < 0.1, "tracking error {tracked} rad");
    let last = down.last().expect("records");
    assert_eq!(last.mode(), Ok(Mode::Hold));
    // Hanging: nobody controls the pendulum in Hold, so that what is left at the end of the plan swings on.
    assert!(last.q[7].abs() < 0.1, "q8 is {} rad", last.q[7]);
    assert!(last.qd[..NU].iter().all(|v| v.abs() < 0.01), "{:?}", last.qd);
    assert!(last.qd[NU..].iter().all(|v| v.abs() < 0.3), "{:?}", last.qd);

    let before = system.session.records.len();
    go(&mut system, Manoeuvre::SwingUp);
    let last = system.session.records[before..].last().expect("records");
    assert_eq!(last.mode(), Ok(Mode::Balance));
    system.session.end().unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn only_from_balance() {
    let mut system = System::start(Clock::Lockstep, [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
    // The planner answers with the mode as soon as it has heard of it.
    let refusal = (0..100)
        .find_map(|_| {
            system.session.advance(100).unwrap_or_else(|e| panic!("{e}"));
            let answer = system.session.plan(Manoeuvre::SwingDown);
            let refusal = answer.expect_err("nothing to swing down from");
            (!refusal.to_string().contains("no telemetry")).then_some(refusal)
        })
        .expect("the planner hears of the daemon");
    assert!(refusal.to_string().contains("balance"), "{refusal}");
    system.session.end().unwrap_or_else(|e| panic!("{e}"));
}
