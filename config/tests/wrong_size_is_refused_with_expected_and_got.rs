//! A list with too few or too many numbers is refused with the size it should have.

mod common;
use common::refused;

#[test]
fn every_list() {
    for (file, key, text, size) in [
        ("robot.toml", "limits.q_deg", "q_deg = [170, 120, 170", 9),
        ("robot.toml", "limits.qd_deg_s", "qd_deg_s = [85", 9),
        ("robot.toml", "limits.tau_nm", "tau_nm = [320", 7),
        ("robot.toml", "usage.position_margin_deg", "position_margin_deg = [20", 2),
        ("robot.toml", "coriolis_bound.upper_nm", "upper_nm = [6", 7),
        ("robot.toml", "coriolis_bound.lower_nm", "lower_nm = [-6", 7),
        ("planner.toml", "replan.weight_q", "weight_q = [1", 9),
        ("planner.toml", "replan.weight_qd", "weight_qd = [0.1", 9),
        ("planner.toml", "replan.weight_u", "weight_u = [0.01", 7),
        ("planner.toml", "replan.metric", "metric = [1", 7),
        ("daemon.toml", "hold.stiffness", "stiffness = [100", 7),
        ("daemon.toml", "hold.damping", "damping = [20", 7),
        ("daemon.toml", "stop.deceleration_rad_s2", "deceleration_rad_s2 = [6", 7),
        ("plant.toml", "friction.pendulum_viscous", "pendulum_viscous = [0.0005", 2),
        ("plant.toml", "friction.pendulum_coulomb", "pendulum_coulomb = [0.001", 2),
        ("plant.toml", "friction.arm_viscous", "arm_viscous = [0.2415", 7),
        ("plant.toml", "friction.arm_coulomb", "arm_coulomb = [0.31909", 7),
        ("plant.toml", "start.q_deg", "q_deg = [0", 7),
    ] {
        let first_joint = if size == 2 { 8 } else { 1 };
        let expected =
            format!("expected {size} numbers, for joints {first_joint} to {}", first_joint + size - 1);
        let got = format!("got {}: give one number per joint", size + 1);
        refused(file, text, &format!("{text}, 1"), &[key, &expected, &got]);
    }
    refused(
        "planner.toml",
        "metric = [1, 1, 1, 1, 1, 1, 1]",
        "metric = []",
        &["replan.metric", "7 numbers", "got 0"],
    );
}
