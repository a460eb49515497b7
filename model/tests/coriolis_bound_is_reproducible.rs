//! The sampled range of the Coriolis torques depends on the seed and the number of samples alone, is what the torque
//! laws give at exactly those states, and never shrinks with more samples.

mod common;

use common::{SIZES, robot};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use upswing_model::coriolis::{CoriolisRange, bound, random_states};
use upswing_model::{ActuatedVector, JointVector, Limits, Model, State, Workspace};

const SEED: u64 = 7;
/// More than two chunks and no multiple of one.
const SAMPLES: u64 = 150_001;

fn sampled(model: &Model, samples: u64, seed: u64) -> CoriolisRange {
    bound(model, &limits(), samples, seed, &AtomicBool::new(false), |_| ())
}

/// Unequal ones of each joint.
fn limits() -> Limits {
    let spread = |from: f64, by: f64| JointVector::from_fn(SIZES, |i| from + by * i as f64);
    Limits {
        q_min: -spread(2.0, 0.1),
        q_max: spread(1.5, 0.2),
        qd_max: spread(1.0, 0.5),
        tau_max: ActuatedVector::zeros(SIZES),
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
    let mut lower = ActuatedVector::repeat(SIZES, f64::INFINITY);
    let mut upper = -lower;
    for (q, qd) in random_states(&limits, SEED, 0).take(SAMPLES as usize) {
        let within = |i: usize| (limits.q_min[i]..=limits.q_max[i]).contains(&q[i]);
        assert!((0..q.len()).all(|i| within(i) && qd[i].abs() <= limits.qd_max[i]));
        let (x, u) = (State::new(&q, &qd), ActuatedVector::zeros(SIZES));
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
        assert_eq!(range.lower.inf(&before.lower), range.lower, "{samples}");
        assert_eq!(range.upper.sup(&before.upper), range.upper, "{samples}");
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
    assert!(range.samples > 0 && range.lower.iter().chain(range.upper.iter()).all(|t| t.is_finite()));
}
