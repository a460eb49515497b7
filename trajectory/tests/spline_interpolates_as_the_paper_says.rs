//! The spline (12) meets the knots, has u piecewise linear and x with the derivative f interpolated linearly;
//! times outside [0, t_F], and NaN, give an end.

use upswing_model::{ActuatedVector, State};
use upswing_trajectory::{Gain, Gains, N, Plan, Trajectory};

/// Knots of x(t) = f0 t + c t^2 / 2, for which (12) is exact.
fn plan() -> Plan {
    let t_f = 2.0;
    let (f0, c) = (State::from_fn(|i, _| i as f64 * 0.1), State::from_fn(|i, _| 1.0 - i as f64 * 0.2));
    let time = |k: usize| t_f * k as f64 / N as f64;
    Plan {
        id: 1,
        fingerprint: 2,
        trajectory: Trajectory {
            t_f,
            x: Box::new(std::array::from_fn(|k| f0 * time(k) + c * (0.5 * time(k) * time(k)))),
            u: Box::new(std::array::from_fn(|k| ActuatedVector::repeat(k as f64))),
        },
        f: Box::new(std::array::from_fn(|k| f0 + c * time(k))),
        gains: Gains {
            knots: Box::new(std::array::from_fn(|k| Gain::repeat(k as f64))),
            end: Gain::repeat(-1.0),
        },
        activation_ns: None,
    }
}

#[test]
fn between_the_knots() {
    let plan = plan();
    let (f0, c) = (plan.f[0], (plan.f[N] - plan.f[0]) / 2.0);
    for i in 0..1000 {
        let t = 2.0 * f64::from(i) / 1000.0;
        let r = plan.reference(t);
        assert!((r.x - (f0 * t + c * (0.5 * t * t))).amax() < 1e-12, "x at {t}");
        assert!((r.u - ActuatedVector::repeat(t / 2.0 * N as f64)).amax() < 1e-11, "u at {t}");
        assert!((r.gain - Gain::repeat(t / 2.0 * N as f64)).amax() < 1e-11, "K at {t}");
    }
}

#[test]
fn at_and_beyond_the_ends() {
    let plan = plan();
    assert_eq!(plan.reference(0.0).x, plan.trajectory.x[0]);
    assert_eq!(plan.reference(-1.0).x, plan.trajectory.x[0]);
    for t in [2.0, 2.1, f64::INFINITY] {
        let end = plan.reference(t);
        assert_eq!((end.x, end.u, end.gain), (plan.trajectory.x[N], ActuatedVector::zeros(), plan.gains.end));
    }
    assert!(plan.reference(f64::NAN).x.iter().all(|v| v.is_finite()));
}
