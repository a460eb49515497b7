//! The gains of swing-ups are those of the Riccati recursion with dense matrices, those that are extrapolated to the control period are
//! the same for all shipped systems, and the gain at the end balances the pendulum with and without friction in its bearings.

use nalgebra::DMatrix;
use upswing_config::{Config, System};
use upswing_model::{ActuatedVector, Linearization, State, Workspace};
use upswing_ocp::lqr::{Recursion, synthesize};
use upswing_planner::offline::lqr_weights;
use upswing_planner::replan::Planner;
use upswing_trajectory::Gain;

/// The gain by rows.
fn matrix(gain: Gain<'_>) -> DMatrix<f64> {
    let rows = gain.rows().len();
    DMatrix::from_row_slice(rows, gain.as_slice().len() / rows, gain.as_slice())
}

fn identity(size: usize) -> DMatrix<f64> {
    DMatrix::identity(size, size)
}

/// One step of (23) with dense matrices: the gain, and the weight one period before.
fn dense_step(
    p: &DMatrix<f64>,
    (a, b): (&DMatrix<f64>, &DMatrix<f64>),
    q: &DMatrix<f64>,
    r: f64,
    ts: f64,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let (phi, gamma) = (identity(p.nrows()) + a * ts, b * ts);
    let pivot = identity(b.ncols()) * r + gamma.transpose() * p * &gamma;
    let inner = gamma.transpose() * p * &phi;
    let k = -pivot.try_inverse().expect("invertible") * &inner;
    let next = q + phi.transpose() * p * &phi + inner.transpose() * &k;
    (k, (&next + next.transpose()) * 0.5)
}

/// `a` of (19) at `x` with viscous friction in the bearings of the pendulum, N m s/rad.
fn with_bearings(config: &Config, x: &State, a: &DMatrix<f64>, friction: f64) -> DMatrix<f64> {
    let mass = config.model.mass_matrix(&x.q(), &mut Workspace::default());
    let (sizes, mut a) = (x.sizes(), a.clone());
    let (first, count) = (sizes.actuated(), sizes.unactuated());
    let m_uu = DMatrix::from_fn(count, count, |i, j| mass[(first + i, first + j)]);
    let qd_u = sizes.joints() + first;
    let mut block = a.view_mut((qd_u, qd_u), (count, count));
    block -= m_uu.try_inverse().expect("positive definite") * friction;
    a
}

#[test]
fn balance_is_stable_with_a_free_rod_and_with_one_that_its_bearings_hold() {
    let config = Config::embedded().expect("settings");
    let planner = Planner::new(config.clone()).expect("the database fits");
    let ts = config.daemon.cycle.period.seconds();
    let (sizes, work) = (config.model.sizes(), &mut Workspace::default());
    for entry in (0..planner.entries(0)).step_by(40) {
        let entry = planner.entry(0, entry).expect("an entry");
        let x = entry.trajectory.end();
        let weights = lqr_weights(&config.planner, sizes);
        let gains = synthesize(&config.model, &entry.trajectory, &weights, ts, Recursion::Extrapolated, work)
            .expect("stabilisable");
        let mut d = Linearization::new(sizes);
        config.model.linearize(x, &ActuatedVector::zeros(sizes), work, &mut d);
        for friction in [0.0, 0.03, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0] {
            let a = with_bearings(&config, x, &d.a(), friction);
            let mut closed = identity(sizes.state()) + (a + d.b() * matrix(gains.end())) * ts;
            // After 2^18 periods, half a minute.
            for _ in 0..18 {
                closed = &closed * &closed;
            }
            assert!(closed.norm() < 1e-2, "{friction} N m s/rad: a deviation becomes {:e}", closed.norm());
        }
    }
}

#[test]
fn the_gains_of_a_swing_are_those_of_the_dense_recursion() {
    let config = Config::embedded().expect("settings");
    let planner = Planner::new(config.clone()).expect("the database fits");
    let trajectory = &planner.entry(0, 7).expect("an entry").trajectory;
    let (weights, ts) = (&config.planner.lqr, config.daemon.cycle.period.seconds());
    let (sizes, work) = (config.model.sizes(), &mut Workspace::default());
    let n = trajectory.intervals();
    let weights_of_all = lqr_weights(&config.planner, sizes);
    let gains = synthesize(&config.model, trajectory, &weights_of_all, ts, Recursion::Periods, work)
        .expect("stabilisable");

    // (20), written out.
    let mut q = identity(18) * weights.q_angles;
    for i in 9..16 {
        q[(i, i)] = weights.q_velocities_actuated;
    }
    for i in 16..18 {
        q[(i, i)] = weights.q_velocities_unactuated;
    }
    let mut d = Linearization::new(sizes);
    let mut ab = |x: &State, u: &ActuatedVector| {
        config.model.linearize(x, u, work, &mut d);
        (d.a(), d.b())
    };
    // (21) by backward recursion from zero weight until it converges.
    let at_end = ab(trajectory.end(), &ActuatedVector::zeros(sizes));
    let from_far = |q: &DMatrix<f64>| {
        let (mut p, mut k) = (DMatrix::zeros(18, 18), DMatrix::zeros(7, 18));
        for _ in 0..60_000 {
            (k, p) = dense_step(&p, (&at_end.0, &at_end.1), q, weights.r, ts);
        }
        (k, p)
    };
    let (end, mut p) = from_far(&q);
    let scale = end.amax();
    // The gain that balances, which has other weights of the angles.
    let balance = &config.planner.balance;
    let mut q_balance = q.clone();
    for i in 0..9 {
        let actuated = i < 7;
        q_balance[(i, i)] = if actuated { balance.q_angles_actuated } else { balance.q_angles_unactuated };
    }
    let error = (matrix(gains.end()) - from_far(&q_balance).0).amax();
    assert!(error < 1e-6 * scale, "at the end: {}", error / scale);

    let knots: Vec<_> = trajectory.knots().map(|(x, u)| ab(x, u)).collect();
    let periods = (trajectory.t_f / ts).floor() as usize;
    let mut by_period = vec![DMatrix::zeros(7, 18); periods];
    for i in (0..periods).rev() {
        let place = i as f64 * ts / trajectory.t_f * n as f64;
        let (k, share) = ((place as usize).min(n - 1), place.fract());
        let a = &knots[k].0 * (1.0 - share) + &knots[k + 1].0 * share;
        let b = &knots[k].1 * (1.0 - share) + &knots[k + 1].1 * share;
        (by_period[i], p) = dense_step(&p, (&a, &b), &q, weights.r, ts);
    }
    // Number of the control period that contains knot k; no period begins at or after t_F.
    let at = |k: usize| ((k as f64 * trajectory.h() / ts) as usize).min(periods - 1);
    for k in 0..=n {
        let gain = matrix(gains.knot(k));
        let error = (&gain - &by_period[at(k)]).amax();
        assert!(error < 1e-6 * scale, "knot {k}: {}", error / scale);
        // The gains of neighbouring knots differ.
        for neighbour in [k.saturating_sub(1), (k + 1).min(n)].into_iter().filter(|n| *n != k) {
            let change = (&gain - &by_period[at(neighbour)]).amax();
            assert!(change > 1e-4 * scale, "knots {k} and {neighbour}: {}", change / scale);
        }
    }
}

#[test]
fn extrapolated_gains_are_those_of_every_period_for_all_shipped_systems() {
    /// Largest difference relative to the largest entry of a gain: a third of what the last of the longer periods may change.
    const TOLERANCE: f64 = 3e-4;
    /// Largest number of entries of each database.
    const ENTRIES: usize = 16;
    let work = &mut Workspace::default();
    for system in System::shipped() {
        let config = Config::load(&System::Shipped(system)).expect("settings");
        let planner = Planner::new(config.clone()).expect("the databases fit");
        let weights = lqr_weights(&config.planner, config.model.sizes());
        for (number, manoeuvre) in config.manoeuvres.iter().enumerate().filter(|(_, m)| m.reverses.is_none())
        {
            let entries = planner.entries(number);
            for entry in (0..entries).step_by(entries.div_ceil(ENTRIES).max(1)) {
                let entry = planner.entry(number, entry).expect("an entry");
                // Near the control period, with periods that begin at the knots, not a rounding error after them: all of the difference is
                // the extrapolation's.
                let h = entry.trajectory.h();
                let ts = h / (h / config.daemon.cycle.period.seconds()).round() * (1.0 - 1e-12);
                let mut gains = |recursion| {
                    let gains = synthesize(&config.model, &entry.trajectory, &weights, ts, recursion, work);
                    gains.expect("stabilisable")
                };
                let (want, got) = (gains(Recursion::Periods), gains(Recursion::Extrapolated));
                for (k, (want, got)) in want.knots().zip(got.knots()).enumerate() {
                    let (want, got) = (matrix(want), matrix(got));
                    let error = (got - &want).amax() / want.amax();
                    assert!(
                        error < TOLERANCE,
                        "{} of {}, knot {k}: {error:e}",
                        manoeuvre.name,
                        system.name()
                    );
                }
                assert_eq!(want.end(), got.end());
            }
        }
    }
}
