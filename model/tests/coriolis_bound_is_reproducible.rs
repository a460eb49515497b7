//! The sampled range of the Coriolis torques depends on the seed and the number of samples alone, is what the torque
//! laws give at exactly those states, and never shrinks with more samples.

mod common;

use common::robot;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use upswing_model::coriolis::{CoriolisRange, bound, random_states};
use upswing_model::{ActuatedVector, JointVector, Limits, Model, Workspace, state};

const SEED: u64 = 7;
/// More than two chunks and no multiple of one.
const SAMPLES: u64 = 150_001;

fn sampled(model: &Model, samples: u64, seed: u64) -> CoriolisRange {
    bound(model, &limits(), samples, seed, &AtomicBool::new(false), |_| ())
}

/// Unequal ones of each joint.
fn limits() -> Limits {
    let spread = |from: f64, by: f64| JointVector::from_fn(|i, _| from + by * i as f64);
    Limits {
        q_min: -spread(2.0, 0.1),
        q_max: spread(1.5, 0.2),
        qd_max: spread(1.0, 0.5),
        tau_max: ActuatedVector::zeros(),
    }
}

#[test]
fn with_any_number_of_threads() {
    let model = robot();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| sampled(&model, SAMPLES, SEED))
    };
    let one = with(1);
    assert_eq!(one.samples, SAMPLES);
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
    assert_ne!(one, sampled(&model, SAMPLES, SEED + 1), "the seed matters");
}

#[test]
fn it_is_the_range_of_the_torque_laws_at_the_random_states() {
    let (model, mut work) = (robot(), Workspace::default());
    let limits = limits();
    let range = sampled(&model, SAMPLES, SEED);
    let mut lower = ActuatedVector::repeat(f64::INFINITY);
    let mut upper = -lower;
    for (q, qd) in random_states(&limits, SEED, 0).take(SAMPLES as usize) {
        assert!(q >= limits.q_min && q <= limits.q_max && qd >= -limits.qd_max && qd <= limits.qd_max);
        let (x, u) = (state(&q, &qd), ActuatedVector::zeros());
        let torque = model.torque(&x, &u, &mut work) - model.torque_without_coriolis(&x, &u, &mut work);
        lower = lower.inf(&torque);
        upper = upper.sup(&torque);
    }
    assert!((range.lower - lower).amax() < 1e-10 && (range.upper - upper).amax() < 1e-10, "{range:?}");
}

#[test]
fn more_samples_never_shrink_it() {
    let model = robot();
    let mut before = sampled(&model, 1, SEED);
    assert_eq!(before.lower, before.upper, "one sample");
    for samples in [2, 10, 1_000, 65_536, 65_537, SAMPLES] {
        let range = sampled(&model, samples, SEED);
        assert_eq!(range.samples, samples);
        assert!(range.lower <= before.lower && range.upper >= before.upper, "{samples}: {range:?}");
        before = range;
    }
}

#[test]
fn an_interrupted_search_says_how_far_it_came() {
    let model = robot();
    let (stop, counted) = (AtomicBool::new(false), AtomicU64::new(0));
    let range = bound(&model, &limits(), u64::MAX, SEED, &stop, |n| {
        counted.fetch_add(n, Ordering::AcqRel);
        stop.store(true, Ordering::Release);
    });
    assert_eq!(range.samples, counted.into_inner());
    assert!(range.samples > 0 && range.lower.iter().chain(&range.upper).all(|t| t.is_finite()));
}
