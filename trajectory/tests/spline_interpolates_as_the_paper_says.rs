//! The spline (12) meets the knots, has u piecewise linear and x with the derivative f interpolated linearly, and K is linear
//! between the knots; times outside [0, t_F], and NaN, give an end. For chains of any sizes and any number of knots.

use upswing_model::{ActuatedVector, Sizes, State};
use upswing_trajectory::{Gains, Plan, Trajectory};

/// Some chains and numbers of intervals.
fn sizes() -> impl Iterator<Item = (Sizes, usize)> {
    [(2, 1, 20), (3, 1, 37), (9, 7, 100), (16, 13, 1000)]
        .into_iter()
        .map(|(joints, actuated, n)| (Sizes::new(joints, actuated).expect("a chain"), n))
}

/// Knots of x(t) = f0 t + c t^2 / 2, for which (12) is exact.
fn plan(sizes: Sizes, n: usize) -> Plan {
    let t_f = 2.0;
    let f0 = State::from_fn(sizes, |i| i as f64 * 0.1);
    let c = State::from_fn(sizes, |i| 1.0 - i as f64 * 0.2);
    let time = |k: usize| t_f * k as f64 / n as f64;
    let mut gains = Gains::zeros(sizes, n);
    for k in 0..=n {
        gains.knot_mut(k).iter_mut().enumerate().for_each(|(i, v)| *v = entry(i, k as f64));
    }
    gains.end_mut().fill(-1.0);
    Plan {
        id: 1,
        fingerprint: 2,
        trajectory: Trajectory {
            t_f,
            x: (0..=n).map(|k| f0 * time(k) + c * (0.5 * time(k) * time(k))).collect(),
            u: (0..=n).map(|k| ActuatedVector::repeat(sizes, k as f64)).collect(),
        },
        f: (0..=n).map(|k| f0 + c * time(k)).collect(),
        gains,
        activation_ns: None,
        replaces: None,
    }
}

/// Entry `i` by rows of the gain at `knot`.
fn entry(i: usize, knot: f64) -> f64 {
    knot * (i as f64 - 3.5)
}

#[test]
fn between_the_knots() {
    for (sizes, n) in sizes() {
        let plan = plan(sizes, n);
        let (f0, c) = (plan.f[0], (plan.f[n] - plan.f[0]) / 2.0);
        let dx = State::from_fn(sizes, |i| (i as f64).cos());
        for i in 0..1000 {
            let t = 2.0 * f64::from(i) / 1000.0;
            let knot = t / 2.0 * n as f64;
            let r = plan.reference(t);
            assert!((r.x - (f0 * t + c * (0.5 * t * t))).amax() < 1e-12, "x at {t}");
            assert!((r.u - ActuatedVector::repeat(sizes, knot)).amax() < 1e-10, "u at {t}");
            // Row by row, by the formula of the entries.
            let du = ActuatedVector::from_fn(sizes, |row| {
                dx.iter().enumerate().map(|(j, dx)| entry(row * sizes.state() + j, knot) * dx).sum()
            });
            let tolerance = 1e-11 * (1.0 + du.amax());
            assert!((r.gain.times(&dx) - du).amax() < tolerance, "K at {t}");
            assert!((r.input(&(r.x + dx)) - (r.u + du)).amax() < tolerance, "u_d + K (x - x_d) at {t}");
        }
    }
}

#[test]
fn at_and_beyond_the_ends() {
    for (sizes, n) in sizes() {
        let plan = plan(sizes, n);
        assert_eq!(plan.reference(0.0).x, plan.trajectory.x[0]);
        assert_eq!(plan.reference(-1.0).x, plan.trajectory.x[0]);
        let dx = State::repeat(sizes, 1.0);
        for t in [2.0, 2.1, f64::INFINITY] {
            let end = plan.reference(t);
            assert_eq!((end.x, end.u), (plan.trajectory.x[n], ActuatedVector::zeros(sizes)));
            assert_eq!(end.gain.times(&dx), ActuatedVector::repeat(sizes, -(sizes.state() as f64)));
        }
        assert!(plan.reference(f64::NAN).x.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn the_reversed_trajectory_runs_backwards() {
    for (sizes, n) in sizes() {
        let plan = plan(sizes, n);
        let reversed = plan.trajectory.reversed();
        assert_eq!(reversed.intervals(), n);
        for k in 0..=n {
            let (x, back) = (plan.trajectory.x[k], reversed.x[n - k]);
            assert_eq!((back.q(), back.qd(), reversed.u[n - k]), (x.q(), -x.qd(), plan.trajectory.u[k]));
        }
        assert_eq!(reversed.reversed(), plan.trajectory);
    }
}

#[test]
fn gains_lie_row_by_row_and_knot_by_knot() {
    for (sizes, n) in sizes() {
        let plan = plan(sizes, n);
        let gains = &plan.gains;
        assert_eq!((gains.sizes(), gains.intervals(), gains.knots().len()), (sizes, n, n + 1));
        for (k, gain) in gains.knots().enumerate() {
            assert_eq!(gain, gains.knot(k));
            assert_eq!(gain.rows().len(), sizes.actuated());
            for j in 0..sizes.state() {
                let column = ActuatedVector::from_fn(sizes, |i| entry(i * sizes.state() + j, k as f64));
                assert_eq!(gain.column(j), column);
            }
            for (i, row) in gain.rows().enumerate() {
                assert!(row.iter().enumerate().all(|(j, v)| *v == entry(i * sizes.state() + j, k as f64)));
            }
        }
        let slab = gains.as_slice().to_vec();
        assert_eq!(slab.len(), Gains::entries(sizes, n));
        assert_eq!(Gains::from_slab(sizes, n, slab.clone()).as_ref(), Some(gains));
        assert_eq!(Gains::from_slab(sizes, n + 1, slab.clone()), None);
        assert_eq!(Gains::from_slab(sizes, n, slab[1..].to_vec()), None);
    }
}
