//! Reference of the actuated joints, the arm, in Hold and Stop: a pose, or a motion that decelerates.

use upswing_config::HoldGains;
use upswing_model::thresholds::REST_SPEED_STOP;
use upswing_model::{ActuatedVector, State};

/// Time for which the arm has to be at rest before it counts as settled, ns.
const REST_TIME_NS: u64 = 50_000_000;

/// Reference of the arm: a pose to hold, or a motion that comes to rest.
#[derive(Clone, Copy, Debug)]
pub struct ArmReference {
    /// Position q_d and velocity qd_d.
    q: ActuatedVector,
    qd: ActuatedVector,
    /// Time since which reference and arm have been at rest, ns; `None` while one of them moves.
    rest_since: Option<u64>,
}

impl ArmReference {
    /// Creates a reference at rest in the pose of `x`.
    pub fn at_rest(x: &State) -> Self {
        Self { q: x.q_a(), qd: ActuatedVector::zeros(x.sizes()), rest_since: None }
    }

    /// Creates a reference with pose and velocity of `x`.
    pub fn moving(x: &State) -> Self {
        Self { q: x.q_a(), qd: x.qd_a(), rest_since: None }
    }

    /// Decelerates the reference with `deceleration` (rad/s^2 or m/s^2, above 0) for `elapsed` s; returns u_d.
    pub fn decelerate(&mut self, deceleration: &ActuatedVector, elapsed: f64) -> ActuatedVector {
        let mut u_d = ActuatedVector::zeros(deceleration.sizes());
        for i in 0..u_d.len() {
            let (v, a) = (self.qd[i], deceleration[i]);
            let braking = elapsed.min(v.abs() / a);
            self.qd[i] = if braking < elapsed { 0.0 } else { v - v.signum() * a * braking };
            self.q[i] += 0.5 * (v + self.qd[i]) * braking;
            if self.qd[i] != 0.0 {
                u_d[i] = -v.signum() * a;
            }
        }
        u_d
    }

    /// Whether reference and arm have been at rest for `REST_TIME_NS` at the time `now`, ns.
    pub fn is_settled(&mut self, x: &State, now: u64) -> bool {
        // The maximum of all speeds would ignore a NaN.
        let slow = x.qd_a().iter().all(|v| v.abs() < REST_SPEED_STOP);
        if !(self.qd.amax() == 0.0 && slow) {
            self.rest_since = None;
            return false;
        }
        let since = *self.rest_since.get_or_insert(now);
        now.saturating_sub(since) >= REST_TIME_NS
    }

    /// Returns x_d; the unactuated joints have no reference, so that their part is taken from `x`.
    pub fn state(&self, x: &State) -> State {
        let mut x_d = *x;
        x_d.q_a_mut().copy_from_slice(&self.q);
        x_d.qd_a_mut().copy_from_slice(&self.qd);
        x_d
    }

    /// Returns u = u_d + stiffness (q_d - q) + damping (qd_d - qd).
    pub fn input(&self, gains: &HoldGains, x: &State, u_d: &ActuatedVector) -> ActuatedVector {
        let (q, qd) = (x.q_a(), x.qd_a());
        ActuatedVector::from_fn(x.sizes(), |i| {
            u_d[i] + gains.stiffness[i] * (self.q[i] - q[i]) + gains.damping[i] * (self.qd[i] - qd[i])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::ArmReference;
    use upswing_config::{Config, DaemonSettings};
    use upswing_model::{ActuatedVector, JointVector, Sizes, State};

    const MS: u64 = 1_000_000;

    const MACHINES: [(usize, usize); 3] = [(9, 7), (2, 1), (5, 3)];

    fn sizes((joints, actuated): (usize, usize)) -> Sizes {
        Sizes::new(joints, actuated).expect("sizes")
    }

    /// Settings with different values for all joints.
    fn settings(sizes: Sizes) -> DaemonSettings {
        let mut settings = Config::embedded().expect("settings").daemon;
        let from = |first: f64| ActuatedVector::from_fn(sizes, |i| first + i as f64);
        (settings.hold.stiffness, settings.hold.damping) = (from(100.0), from(20.0));
        settings.stop.deceleration = from(4.0);
        settings
    }

    /// State with a different value in each row.
    fn moving(sizes: Sizes) -> State {
        State::from_fn(sizes, |i| 0.1 + 0.05 * i as f64 * if i % 2 == 0 { 1.0 } else { -1.0 })
    }

    fn at_rest(sizes: Sizes) -> State {
        State::new(&moving(sizes).q(), &JointVector::zeros(sizes))
    }

    #[test]
    fn a_held_joint_is_pulled_to_its_pose_with_its_own_gains() {
        for sizes in MACHINES.map(sizes) {
            let settings = settings(sizes);
            let pose = moving(sizes);
            let arm = ArmReference::at_rest(&pose);
            let x = State::from_fn(sizes, |i| 0.3 - 0.02 * i as f64);
            let x_d = arm.state(&x);
            assert_eq!((x_d.q_a(), x_d.qd_a()), (pose.q_a(), ActuatedVector::zeros(sizes)));
            // The pendulum has its measured state.
            assert_eq!((x_d.q_u(), x_d.qd_u()), (x.q_u(), x.qd_u()));
            let u_d = ActuatedVector::from_fn(sizes, |i| 7.0 - i as f64);
            let u = arm.input(&settings.hold, &x, &u_d);
            for i in 0..u.len() {
                let (stiffness, damping) = (settings.hold.stiffness[i], settings.hold.damping[i]);
                let expected = u_d[i] + stiffness * (pose[i] - x[i]) - damping * x.qd()[i];
                assert!((u[i] - expected).abs() < 1e-12, "joint {}", i + 1);
            }
        }
    }

    #[test]
    fn a_stop_decelerates_each_joint_as_set_on_a_parabola() {
        let sizes = sizes(MACHINES[0]);
        let (settings, x) = (settings(sizes), moving(sizes));
        // In steps of a cycle, and in steps longer than the motion to rest.
        for elapsed in [125e-6, 7e-3, 0.05, 1.0] {
            let mut arm = ArmReference::moving(&x);
            for cycle in 1..=(0.4 / elapsed) as usize + 1 {
                let u_d = arm.decelerate(&settings.stop.deceleration, elapsed);
                let x_d = arm.state(&State::zeros(sizes));
                for i in 0..u_d.len() {
                    let (v, a) = (x.qd()[i], settings.stop.deceleration[i]);
                    let rest = v.abs() / a;
                    let t = (cycle as f64 * elapsed).min(rest);
                    let (q, qd) = (x[i] + v * t - 0.5 * v.signum() * a * t * t, v - v.signum() * a * t);
                    assert!((x_d[i] - q).abs() < 1e-9, "{elapsed} s, joint {}: {} not {q}", i + 1, x_d[i]);
                    assert!((x_d.qd()[i] - qd).abs() < 1e-9, "{elapsed} s, joint {}", i + 1);
                    let expected = if t < rest { -v.signum() * a } else { 0.0 };
                    // If rest comes exactly at the end of a cycle, rounding decides.
                    let open = (cycle as f64 * elapsed - rest).abs() < 1e-9;
                    assert!(open || u_d[i] == expected, "{elapsed} s, joint {}", i + 1);
                    assert!(open || t < rest || x_d.qd()[i] == 0.0, "{elapsed} s, joint {}: at rest", i + 1);
                }
            }
            // The feedback follows the moving reference, not only its end.
            let arm = ArmReference::moving(&x);
            let u = arm.input(&settings.hold, &State::zeros(sizes), &ActuatedVector::zeros(sizes));
            for i in 0..u.len() {
                let (q, qd) = (x[i], x.qd()[i]);
                let expected = settings.hold.stiffness[i] * q + settings.hold.damping[i] * qd;
                assert!((u[i] - expected).abs() < 1e-12, "joint {}", i + 1);
            }
        }
    }

    #[test]
    fn the_arm_rests_when_it_and_its_reference_have_stood_for_50_ms() {
        let sizes = sizes(MACHINES[0]);
        let slow = |joint: usize, speed: f64| {
            let mut x = at_rest(sizes);
            x.qd_mut()[joint] = speed;
            x
        };
        // The pendulum may swing.
        let mut still = slow(6, -0.099);
        still.qd_u_mut().copy_from_slice(&[5.0, -5.0]);
        let mut arm = ArmReference::moving(&moving(sizes));
        for ms in [0, 60, 120] {
            assert!(!arm.is_settled(&still, ms * MS), "the reference moves");
        }
        let mut arm = ArmReference::moving(&at_rest(sizes));
        let begin = 1000;
        for (ms, x, expected) in [
            (0, &still, false),
            (49, &still, false),
            (50, &still, true),
            (51, &slow(0, 0.101), false),
            (52, &still, false),
            (101, &still, false),
            (102, &still, true),
            (103, &slow(6, -0.101), false),
            (104, &slow(3, f64::NAN), false),
            (105, &still, false),
            (154, &still, false),
        ] {
            assert_eq!(arm.is_settled(x, (begin + ms) * MS), expected, "after {ms} ms");
        }
        // Another stop starts the time anew.
        let mut arm = ArmReference::moving(&at_rest(sizes));
        assert!(!arm.is_settled(&still, (begin + 155) * MS));
        assert!(arm.is_settled(&still, (begin + 205) * MS));
    }
}
