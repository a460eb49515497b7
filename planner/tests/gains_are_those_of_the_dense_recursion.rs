//! The gains of swing-ups are those of the Riccati recursion with dense matrices, and the gain at the end balances the pendulum
//! with and without friction in its bearings.

use nalgebra::SMatrix;
use upswing_config::Config;
use upswing_model::{ActuatedVector, NQ, NU, NX, State, StateParts, Workspace};
use upswing_ocp::lqr::synthesize;
use upswing_planner::offline::lqr_weights;
use upswing_planner::replan::Planner;
use upswing_trajectory::{Gain, N};

type StateMatrix = SMatrix<f64, NX, NX>;

/// One step of (23) with dense matrices: the gain, and the weight one period before.
fn dense_step(
    p: &StateMatrix,
    (a, b): (&StateMatrix, &SMatrix<f64, NX, NU>),
    q: &StateMatrix,
    r: f64,
    ts: f64,
) -> (Gain, StateMatrix) {
    let (phi, gamma) = (StateMatrix::identity() + a * ts, b * ts);
    let pivot = SMatrix::<f64, NU, NU>::identity() * r + gamma.transpose() * p * gamma;
    let k = -pivot.try_inverse().expect("invertible") * gamma.transpose() * p * phi;
    let next = q + phi.transpose() * p * phi + (gamma.transpose() * p * phi).transpose() * k;
    (k, (next + next.transpose()) * 0.5)
}

/// `a` of (19) at `x` with viscous friction in the bearings of the pendulum, N m s/rad.
fn with_bearings(config: &Config, x: &State, a: &StateMatrix, friction: f64) -> StateMatrix {
    let mass = config.model.mass_matrix(&x.q(), &mut Workspace::default());
    let m_uu: SMatrix<f64, 2, 2> = mass.fixed_view::<2, 2>(7, 7).into();
    let mut a = *a;
    let mut block = a.fixed_view_mut::<2, 2>(16, 16);
    block -= m_uu.try_inverse().expect("positive definite") * friction;
    a
}

#[test]
fn balance_is_stable_with_a_free_rod_and_with_one_that_its_bearings_hold() {
    let config = Config::embedded().expect("settings");
    let planner = Planner::new(config.clone()).expect("the database fits");
    let ts = config.daemon.cycle.period.seconds();
    let work = &mut Workspace::default();
    for entry in planner.entries().iter().step_by(40) {
        let x = &entry.trajectory.x[N];
        let gains = synthesize(&config.model, &entry.trajectory, &lqr_weights(&config.planner), ts, work)
            .expect("stabilisable");
        let d = config.model.derivatives(x, &ActuatedVector::zeros(), work);
        for friction in [0.0, 0.03, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0] {
            let a = with_bearings(&config, x, &d.a(), friction);
            let mut closed = StateMatrix::identity() + (a + d.b() * gains.end) * ts;
            // After 2^18 periods, half a minute.
            for _ in 0..18 {
                closed *= closed;
            }
            assert!(closed.norm() < 1e-2, "{friction} N m s/rad: a deviation becomes {:e}", closed.norm());
        }
    }
}

#[test]
fn the_gains_of_a_swing_are_those_of_the_dense_recursion() {
    let config = Config::embedded().expect("settings");
    let planner = Planner::new(config.clone()).expect("the database fits");
    let trajectory = &planner.entries()[7].trajectory;
    let (weights, ts) = (&config.planner.lqr, config.daemon.cycle.period.seconds());
    let work = &mut Workspace::default();
    let gains =
        synthesize(&config.model, trajectory, &lqr_weights(&config.planner), ts, work).expect("stabilisable");

    // (20), written out.
    let mut q = StateMatrix::identity() * weights.q_angles;
    for i in 9..16 {
        q[(i, i)] = weights.q_velocities_actuated;
    }
    for i in 16..18 {
        q[(i, i)] = weights.q_velocities_unactuated;
    }
    let mut ab = |x, u: &ActuatedVector| {
        let d = config.model.derivatives(x, u, work);
        (d.a(), d.b())
    };
    // (21) by backward recursion from zero weight until it converges.
    let at_end = ab(&trajectory.x[N], &ActuatedVector::zeros());
    let from_far = |q: &StateMatrix| {
        let (mut p, mut k) = (StateMatrix::zeros(), Gain::zeros());
        for _ in 0..60_000 {
            (k, p) = dense_step(&p, (&at_end.0, &at_end.1), q, weights.r, ts);
        }
        (k, p)
    };
    let (end, mut p) = from_far(&q);
    let scale = end.amax();
    // The gain that balances, which has other weights of the angles.
    let balance = &config.planner.balance;
    let mut q_balance = q;
    for i in 0..NQ {
        let actuated = i < NU;
        q_balance[(i, i)] = if actuated { balance.q_angles_actuated } else { balance.q_angles_unactuated };
    }
    let error = (gains.end - from_far(&q_balance).0).amax();
    assert!(error < 1e-6 * scale, "at the end: {}", error / scale);

    let knots: Vec<_> = trajectory.knots().map(|(x, u)| ab(x, u)).collect();
    let periods = (trajectory.t_f / ts).floor() as usize;
    let mut by_period = vec![Gain::zeros(); periods];
    for i in (0..periods).rev() {
        let place = i as f64 * ts / trajectory.t_f * N as f64;
        let (k, share) = ((place as usize).min(N - 1), place.fract());
        let a = knots[k].0 * (1.0 - share) + knots[k + 1].0 * share;
        let b = knots[k].1 * (1.0 - share) + knots[k + 1].1 * share;
        (by_period[i], p) = dense_step(&p, (&a, &b), &q, weights.r, ts);
    }
    // Number of the control period that contains knot k; no period begins at or after t_F.
    let at = |k: usize| ((k as f64 * trajectory.h() / ts) as usize).min(periods - 1);
    for k in 0..=N {
        let error = (gains.knots[k] - by_period[at(k)]).amax();
        assert!(error < 1e-6 * scale, "knot {k}: {}", error / scale);
        // The gains of neighbouring knots differ.
        for neighbour in [k.saturating_sub(1), (k + 1).min(N)].into_iter().filter(|n| *n != k) {
            let change = (gains.knots[k] - by_period[at(neighbour)]).amax();
            assert!(change > 1e-4 * scale, "knots {k} and {neighbour}: {}", change / scale);
        }
    }
}
