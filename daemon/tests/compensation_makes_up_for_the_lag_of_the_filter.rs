//! With the right acceleration the compensation makes up for what the differential filter lags behind; with a wrong one it is off by
//! T_1 times the error.

use upswing_model::{JointVector, Sizes};
use upswingd::filter::{DifferentialFilter, LagCompensation};

const TS: f64 = 125e-6;
const T1: f64 = 12e-3;

fn sizes() -> Sizes {
    Sizes::new(9, 7).unwrap()
}

/// Amplitude (rad) and frequency (rad/s) of a joint.
fn motion(joint: usize) -> (f64, f64) {
    (0.1 + 0.02 * joint as f64, 30.0 + 10.0 * joint as f64)
}

/// Largest errors of the filter alone and with the compensation after the transient, for `known` times the true acceleration, as
/// shares of T_1 times the largest acceleration; missing all but every `every`-th sample.
fn errors(known: f64, every: u64) -> (f64, f64) {
    let (mut filter, mut compensation) =
        (DifferentialFilter::new(TS, T1), LagCompensation::new(sizes(), TS, T1));
    let (mut alone, mut both) = (0.0_f64, 0.0_f64);
    for k in (0..16_000).step_by(every as usize) {
        let t = k as f64 * TS;
        let phase = |i: usize, t: f64| motion(i).1 * t;
        let q = JointVector::from_fn(sizes(), |i| motion(i).0 * phase(i, t).sin());
        let qd = JointVector::from_fn(sizes(), |i| motion(i).0 * motion(i).1 * phase(i, t).cos());
        // Of the cycles before the sample.
        let before = t - 0.5 * every as f64 * TS;
        let qdd = JointVector::from_fn(sizes(), |i| {
            -motion(i).0 * motion(i).1.powi(2) * phase(i, before).sin() * known
        });
        let v = filter.update(&q, every);
        let led = v + compensation.update(&qdd, every);
        if t > 10.0 * T1 {
            for i in 0..q.len() {
                let scale = T1 * motion(i).0 * motion(i).1.powi(2);
                alone = alone.max((v - qd)[i].abs() / scale);
                both = both.max((led - qd)[i].abs() / scale);
            }
        }
    }
    (alone, both)
}

#[test]
fn with_the_right_acceleration() {
    let (alone, both) = errors(1.0, 1);
    assert!(alone > 0.9, "the filter alone lags by {alone}");
    assert!(both < 0.02, "with the compensation {both} are left");
}

#[test]
fn with_missed_samples() {
    let (_, both) = errors(1.0, 4);
    assert!(both < 0.1, "with the compensation {both} are left");
}

#[test]
fn as_far_as_the_acceleration_is_right() {
    let (alone, both) = errors(0.8, 1);
    assert!((both - 0.2 * alone).abs() < 0.03, "{both} of {alone}");
}

#[test]
fn a_reset_forgets() {
    let mut compensation = LagCompensation::new(sizes(), TS, T1);
    compensation.update(&JointVector::repeat(sizes(), 3.0), 10);
    compensation.reset();
    let zero = JointVector::zeros(sizes());
    assert_eq!(compensation.update(&zero, 1), zero);
}
