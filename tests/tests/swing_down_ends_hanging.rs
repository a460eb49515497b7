//! After a swing-up and balance, a swing-down brings the pendulum to rest hanging, without exceeding a limit; the arm then
//! holds, and a swing-up can follow.

use upswing_ipc::{Clock, ManoeuvreRequest, Mode};
use upswing_rig::course::{SessionCourse, execute};
use upswing_tests::{START, System};

#[test]
fn and_a_second_swing_up_follows() {
    up_down_and_up(&[-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]);
}

#[test]
fn where_joint_4_is_on_its_limit_too() {
    up_down_and_up(&[-60.0, -30.0, 0.0, -120.0, 0.0, -20.0, 0.0]);
}

fn up_down_and_up(start_deg: &[f64]) {
    let mut system = System::start(Clock::Lockstep, start_deg);
    let report = system.swing_up(3.0);
    assert!(report.success, "{report}");
    let period = system.period();
    let before = system.session.records.len();
    let [up, down] = ["swing-up", "swing-down"].map(|name| ManoeuvreRequest::new(name, &[]).unwrap());
    let go = |system: &mut System, manoeuvre| {
        execute(&mut SessionCourse::new(&mut system.session, period), manoeuvre, period, 1.0)
            .unwrap_or_else(|e| panic!("{e}"))
    };
    let plan = go(&mut system, &down);
    assert!(plan.margin_q >= 0.0 && plan.margin_qd >= 0.0 && plan.margin_tau >= 0.0, "{plan:?}");

    let down = &system.session.records[before..];
    let limits = &system.config.robot.limits;
    for record in down {
        let vectors = record.vectors(system.config.model.order()).expect("the joints of the robot");
        for (i, (tau, max)) in vectors.tau.iter().zip(limits.tau_max.iter()).enumerate() {
            assert!(tau.abs() <= *max, "torque {tau} of joint {}", i + 1);
        }
        for (i, (qd, max)) in vectors.x.qd().iter().zip(limits.qd_max.iter()).enumerate() {
            assert!(qd.abs() <= *max, "speed {qd} of joint {}", i + 1);
        }
    }
    let error = |record: &upswing_ipc::Telemetry| {
        let vectors = record.vectors(system.config.model.order()).expect("the joints of the robot");
        (vectors.x.q() - vectors.x_d.q()).amax()
    };
    let tracked = down.iter().filter(|r| r.mode() == Ok(Mode::Track)).map(error).fold(0.0, f64::max);
    assert!(tracked > 0.0 && tracked < 0.1, "tracking error {tracked} rad");
    let last = down.last().expect("records");
    assert_eq!(last.mode(), Ok(Mode::Hold));
    // Hanging: nobody controls the pendulum in Hold, so that what is left at the end of the plan swings on.
    let x = last.vectors(system.config.model.order()).expect("the joints of the robot").x;
    assert!(x.q_u()[0].abs() < 0.1, "q8 is {} rad", x.q_u()[0]);
    assert!(x.qd_a().amax() < 0.01 && x.qd_u().amax() < 0.3, "{:?}", x.qd());

    let before = system.session.records.len();
    go(&mut system, &up);
    let last = system.session.records[before..].last().expect("records");
    assert_eq!(last.mode(), Ok(Mode::Balance));
    system.session.end().unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn only_from_balance() {
    let mut system = System::start(Clock::Lockstep, START);
    // The planner answers with the mode as soon as it has heard of it.
    let refusal = (0..100)
        .find_map(|_| {
            system.session.advance(100).unwrap_or_else(|e| panic!("{e}"));
            let answer = system.session.plan(&ManoeuvreRequest::new("swing-down", &[]).unwrap());
            let refusal = answer.expect_err("nothing to swing down from");
            (!refusal.to_string().contains("no telemetry")).then_some(refusal)
        })
        .expect("the planner hears of the daemon");
    assert!(refusal.to_string().contains("balance"), "{refusal}");
    system.session.end().unwrap_or_else(|e| panic!("{e}"));
}
