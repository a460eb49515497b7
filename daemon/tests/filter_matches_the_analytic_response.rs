//! The differential filter is s / (T_1 s + 1) for angles that are constant over a cycle.

use upswing_model::{JointVector, Sizes};
use upswingd::filter::DifferentialFilter;

const TS: f64 = 125e-6;
const T1: f64 = 12e-3;

fn sizes() -> Sizes {
    Sizes::new(9, 7).unwrap()
}

fn all(value: f64) -> JointVector {
    JointVector::repeat(sizes(), value)
}

#[test]
fn a_step_decays_exponentially() {
    let mut filter = DifferentialFilter::new(TS, T1);
    assert_eq!(filter.update(&all(0.3), 1), all(0.0), "the first sample is at rest");
    for k in 0..1000 {
        let v = filter.update(&all(1.3), 1);
        let expected = (-(k as f64) * TS / T1).exp() / T1;
        assert!((v - all(expected)).amax() < 1e-10, "cycle {k}: {} instead of {expected}", v[0]);
    }
}

#[test]
fn a_ramp_gives_its_slope() {
    let mut filter = DifferentialFilter::new(TS, T1);
    let slope = JointVector::from_fn(sizes(), |i| 0.5 * i as f64 - 2.0);
    for k in 0..2000 {
        let t = k as f64 * TS;
        let v = filter.update(&(all(1.0) + slope * t), 1);
        // Steps instead of a ramp: up to half a cycle of T_1 off.
        let expected = slope * (1.0 - (-t / T1).exp());
        for i in 0..v.len() {
            assert!((v[i] - expected[i]).abs() <= slope[i].abs() * TS / T1, "cycle {k}, joint {i}");
        }
    }
}

#[test]
fn missed_samples_count_as_unchanged() {
    let mut every = DifferentialFilter::new(TS, T1);
    let mut some = DifferentialFilter::new(TS, T1);
    for filter in [&mut every, &mut some] {
        filter.update(&all(0.0), 1);
        filter.update(&all(0.1), 1);
    }
    every.update(&all(0.1), 1);
    every.update(&all(0.1), 1);
    let difference = every.update(&all(0.2), 1) - some.update(&all(0.2), 3);
    assert!(difference.amax() < 1e-12);
}

#[test]
fn a_reset_forgets() {
    let mut filter = DifferentialFilter::new(TS, T1);
    filter.update(&all(0.0), 1);
    filter.update(&all(0.1), 1);
    filter.reset();
    assert_eq!(filter.update(&all(5.0), 1), all(0.0));
}

#[test]
fn a_shift_moves_the_zero_but_no_velocity() {
    let mut shifted = DifferentialFilter::new(TS, T1);
    let mut other = DifferentialFilter::new(TS, T1);
    for filter in [&mut shifted, &mut other] {
        filter.update(&all(0.0), 1);
        filter.update(&all(0.1), 1);
    }
    let mut offset = all(0.0);
    offset[4] = -6.0;
    shifted.shift(&offset);
    let q = all(0.2);
    let expected = other.update(&q, 1);
    assert!((shifted.update(&(q + offset), 1) - expected).amax() < 1e-12);
}
