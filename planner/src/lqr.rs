//! Discrete time-variant LQR (18)-(23) along a trajectory.

use crate::rows::{Pivot, STATE_ROW, StateRow, add_scaled};
use nalgebra::{SMatrix, SVector};
use upswing_config::PlannerSettings;
use upswing_model::{ActuatedVector, Derivatives, Model, N_ACTUATED, N_UNACTUATED, NQ, NU, NX, Workspace};
use upswing_trajectory::{Gain, KNOTS, Knots, N, Trajectory};

type StateMatrix = SMatrix<f64, NX, NX>;

/// A symmetric weight of the state, by rows.
type Weight = [StateRow; NX];

/// The rows of A and B that are not constant: d qdd_U / dx and d qdd_U / du.
#[derive(Clone, Copy, Debug)]
struct Rows {
    a: [StateRow; N_UNACTUATED],
    b: [[f64; NU]; N_UNACTUATED],
}

impl Rows {
    fn new(d: &Derivatives) -> Self {
        let mut a = [[0.0; STATE_ROW]; N_UNACTUATED];
        for (m, row) in a.iter_mut().enumerate() {
            for j in 0..NX {
                row[j] = d.qdd_u_x[(m, j)];
            }
        }
        Self { a, b: std::array::from_fn(|m| std::array::from_fn(|j| d.qdd_u_u[(m, j)])) }
    }

    /// Between this (`share` = 0) and the next.
    fn towards(&self, next: &Self, share: f64) -> Self {
        let mut out = *self;
        for m in 0..N_UNACTUATED {
            for j in 0..NX {
                out.a[m][j] += (next.a[m][j] - self.a[m][j]) * share;
            }
            for j in 0..NU {
                out.b[m][j] += (next.b[m][j] - self.b[m][j]) * share;
            }
        }
        out
    }
}

/// Gains of a trajectory.
#[derive(Clone, Debug)]
pub struct Gains {
    /// K_k of (23) at the knots.
    pub knots: Knots<Gain>,
    /// The gain that holds x_N, for the weights of Balance.
    pub end: Gain,
}

/// The Riccati equation (21) has no stabilising solution at the trajectory's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no gain stabilises the end of the trajectory: the Riccati equation (21) has no solution there")]
pub struct NotStabilisable;

/// Solves (21), then iterates (23) backwards with the period `ts` (s), with A and B interpolated between the
/// knots; keeps the gains at the knots. The gain that holds x_N has weights of its own: with those of the trajectory Balance is
/// unstable if the bearings of the pendulum have more friction than 0.2 N m s/rad, as at small speeds they have where they stick.
///
/// # Errors
/// [`NotStabilisable`] if (21) has no stabilising solution at x_N.
pub fn synthesize(
    model: &Model,
    trajectory: &Trajectory,
    settings: &PlannerSettings,
    ts: f64,
    work: &mut Workspace,
) -> Result<Gains, NotStabilisable> {
    let PlannerSettings { lqr: weights, balance, .. } = settings;
    let rows: Vec<Rows> =
        trajectory.knots().map(|(x, u)| Rows::new(&model.derivatives(x, u, work))).collect();
    let q = SVector::<f64, NX>::from_fn(|i, _| match i {
        i if i < NQ => weights.q_angles,
        i if i < NQ + N_ACTUATED => weights.q_velocities_actuated,
        _ => weights.q_velocities_unactuated,
    });
    // The end is an equilibrium: u = 0 there, whatever the last knot's input.
    let at_end = Rows::new(&model.derivatives(&trajectory.x[N], &ActuatedVector::zeros(), work));
    let mut p = algebraic_riccati(&at_end, &q, weights.r, ts).ok_or(NotStabilisable)?;
    let step = |p: &mut Weight, rows: &Rows, q: &SVector<f64, NX>| {
        riccati_step(p, rows, q, weights.r, ts).ok_or(NotStabilisable)
    };
    let end = {
        let mut q = q;
        q.fixed_rows_mut::<N_ACTUATED>(0).fill(balance.q_angles_actuated);
        q.fixed_rows_mut::<N_UNACTUATED>(N_ACTUATED).fill(balance.q_angles_unactuated);
        let mut p = algebraic_riccati(&at_end, &q, weights.r, ts).ok_or(NotStabilisable)?;
        step(&mut p, &at_end, &q)?.gain()
    };

    let steps = (trajectory.t_f / ts).floor() as usize;
    let h = trajectory.h();
    let mut knots = Box::new([end; KNOTS]);
    let mut next_knot = N;
    for i in (0..steps).rev() {
        let t = i as f64 * ts;
        let k = ((t / h) as usize).min(N - 1);
        let between = rows[k].towards(&rows[k + 1], t / h - k as f64);
        let step = step(&mut p, &between, &q)?;
        // The first gain at or before a knot's time serves the knot.
        while next_knot > 0 && t <= next_knot as f64 * h {
            knots[next_knot] = step.gain();
            next_knot -= 1;
        }
        if i == 0 {
            knots[0] = step.gain();
        }
    }
    let finite = knots.iter().flat_map(|k| k.iter()).all(|v| v.is_finite());
    finite.then_some(Gains { knots, end }).ok_or(NotStabilisable)
}

/// The factors of K in (23).
struct Step {
    /// L L' = R + Gamma' P Gamma
    pivot: Pivot,
    /// L^-1 Gamma' P Phi
    g: [StateRow; NU],
}

impl Step {
    /// K = -(R + Gamma' P Gamma)^-1 Gamma' P Phi
    fn gain(&self) -> Gain {
        let mut k = self.g;
        self.pivot.backward(&mut k);
        Gain::from_fn(|i, j| -k[i][j])
    }
}

/// One step of (23): moves the weight P one period back. With `Phi = I + Ts A` and `A = [[0, I], [0], [a]]`,
/// `Gamma = Ts [[0], [I], [b]]` all products are a few row operations.
fn riccati_step(p: &mut Weight, rows: &Rows, q: &SVector<f64, NX>, r: f64, ts: f64) -> Option<Step> {
    /// First row of the unactuated velocities.
    const V_U: usize = NX - N_UNACTUATED;
    // R + Gamma' P Gamma
    let mut pivot = [[0.0; NU]; NU];
    for (i, out) in pivot.iter_mut().enumerate() {
        let mut row = p[NQ + i];
        for (m, b) in rows.b.iter().enumerate() {
            add_scaled(&mut row, b[i], &p[V_U + m]);
        }
        for j in 0..NU {
            let mut sum = row[NQ + j];
            for (m, b) in rows.b.iter().enumerate() {
                sum += b[j] * row[V_U + m];
            }
            out[j] = ts * ts * sum;
        }
        out[i] += r;
    }
    let pivot = Pivot::new(&pivot)?;
    // P Phi
    for row in p.iter_mut() {
        let old = *row;
        for j in 0..NQ {
            row[NQ + j] += ts * old[j];
        }
        for (m, a) in rows.a.iter().enumerate() {
            add_scaled(row, ts * old[V_U + m], a);
        }
    }
    // L^-1 Gamma' P Phi
    let mut g = [[0.0; STATE_ROW]; NU];
    for (i, g) in g.iter_mut().enumerate() {
        add_scaled(g, ts, &p[NQ + i]);
        for (m, b) in rows.b.iter().enumerate() {
            add_scaled(g, ts * b[i], &p[V_U + m]);
        }
    }
    pivot.forward(&mut g);
    // Q + Phi' (P Phi) - K' (R + Gamma' P Gamma) K: its lower half, and the same above the diagonal. Without exact
    // symmetry rounding grows over 17 000 steps.
    let v_u: [StateRow; N_UNACTUATED] = std::array::from_fn(|m| p[V_U + m]);
    for i in (0..NX).rev() {
        match i / 4 {
            0 => weight_row::<4>(p, i, rows, &v_u, &g, ts),
            1 => weight_row::<8>(p, i, rows, &v_u, &g, ts),
            2 => weight_row::<12>(p, i, rows, &v_u, &g, ts),
            3 => weight_row::<16>(p, i, rows, &v_u, &g, ts),
            _ => weight_row::<STATE_ROW>(p, i, rows, &v_u, &g, ts),
        }
        p[i][i] += q[i];
    }
    for i in 0..NX {
        for j in 0..i {
            p[j][i] = p[i][j];
        }
    }
    Some(Step { pivot, g })
}

/// The first W entries of row i of Phi' (P Phi) - G' G, for P Phi in `p` (its rows up to i) and in `v_u` (those of the
/// unactuated velocities).
#[inline(always)]
fn weight_row<const W: usize>(
    p: &mut Weight,
    i: usize,
    rows: &Rows,
    v_u: &[StateRow; N_UNACTUATED],
    g: &[StateRow; NU],
    ts: f64,
) {
    fn first<const W: usize>(row: &StateRow) -> &[f64; W] {
        row.first_chunk().unwrap_or(&[0.0; W])
    }
    let mut row = *first::<W>(&p[i]);
    if i >= NQ {
        add_scaled(&mut row, ts, first(&p[i - NQ]));
    }
    for (a, v) in rows.a.iter().zip(v_u) {
        add_scaled(&mut row, ts * a[i], first(v));
    }
    for g in g {
        add_scaled(&mut row, -g[i], first(g));
    }
    p[i][..W].copy_from_slice(&row);
}

/// Phi = I + Ts A and Gamma = Ts B.
fn discretised(rows: &Rows, ts: f64) -> (StateMatrix, SMatrix<f64, NX, NU>) {
    let mut phi = StateMatrix::identity();
    let mut gamma = SMatrix::zeros();
    for i in 0..NQ {
        phi[(i, NQ + i)] += ts;
    }
    for i in 0..N_ACTUATED {
        gamma[(NQ + i, i)] = ts;
    }
    for m in 0..N_UNACTUATED {
        let row = NX - N_UNACTUATED + m;
        for j in 0..NX {
            phi[(row, j)] += ts * rows.a[m][j];
        }
        for j in 0..NU {
            gamma[(row, j)] = ts * rows.b[m][j];
        }
    }
    (phi, gamma)
}

/// X of (21) by structured doubling (Chu, Fan, Lin, Wang, *Structure-preserving algorithms for periodic
/// discrete-time algebraic Riccati equations*, Int. J. Control 77, 2004): each step doubles the horizon.
fn algebraic_riccati(rows: &Rows, q: &SVector<f64, NX>, r: f64, ts: f64) -> Option<Weight> {
    /// 2^40 periods of 125 us are four years.
    const DOUBLINGS: usize = 40;
    let (mut a, gamma) = discretised(rows, ts);
    let mut g = gamma * gamma.transpose() / r;
    let mut h = StateMatrix::from_diagonal(q);
    for _ in 0..DOUBLINGS {
        let w = (StateMatrix::identity() + g * h).lu();
        let (w_a, w_g) = (w.solve(&a)?, w.solve(&g)?);
        let step = a.transpose() * h * w_a;
        g += a * w_g * a.transpose();
        a *= w_a;
        h += step;
        h = (h + h.transpose()) * 0.5;
        g = (g + g.transpose()) * 0.5;
        if !h.iter().all(|v| v.is_finite()) {
            return None;
        }
        if step.amax() <= 1e-13 * h.amax() {
            let mut weight = [[0.0; STATE_ROW]; NX];
            for (i, row) in weight.iter_mut().enumerate() {
                for j in 0..NX {
                    row[j] = h[(i, j)];
                }
            }
            return Some(weight);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Rows {
        let mut a = [[0.0; STATE_ROW]; N_UNACTUATED];
        for (i, row) in a.iter_mut().enumerate() {
            for j in 0..NX {
                row[j] = ((3 * i + 5 * j) % 7) as f64 - 3.0 + if j == NQ - 1 { 20.0 } else { 0.0 };
            }
        }
        let b = |i, j| ((2 * i + 3 * j) % 5) as f64 * 0.4 - 0.9;
        Rows { a, b: std::array::from_fn(|i| std::array::from_fn(|j| b(i, j))) }
    }

    fn matrix(weight: &Weight) -> StateMatrix {
        StateMatrix::from_fn(|i, j| weight[i][j])
    }

    #[test]
    fn a_structured_step_equals_the_dense_formula_23() {
        let (rows, ts, r) = (rows(), 1e-2, 0.01);
        let q = SVector::<f64, NX>::from_fn(|i, _| 1.0 + i as f64);
        let seed = StateMatrix::from_fn(|i, j| ((i * 7 + j * 3) % 11) as f64 - 5.0);
        let p = seed * seed.transpose() + StateMatrix::identity();
        let mut next = [[0.0; STATE_ROW]; NX];
        for i in 0..NX {
            next[i][..NX].copy_from_slice(p.column(i).as_slice());
        }
        let gain = riccati_step(&mut next, &rows, &q, r, ts).expect("positive definite").gain();
        let next = matrix(&next);
        let (phi, gamma) = discretised(&rows, ts);
        let pivot = SMatrix::<f64, NU, NU>::identity() * r + gamma.transpose() * p * gamma;
        let k = -pivot.try_inverse().expect("invertible") * gamma.transpose() * p * phi;
        let want = StateMatrix::from_diagonal(&q)
            + phi.transpose() * p * phi
            + (gamma.transpose() * p * phi).transpose() * k;
        assert!((gain - k).amax() < 1e-9 * k.amax(), "K differs by {}", (gain - k).amax());
        assert!((next - want).amax() < 1e-10 * want.amax(), "P differs by {}", (next - want).amax());
    }

    #[test]
    fn the_terminal_weight_is_a_fixed_point_of_23() {
        let (rows, ts, r) = (rows(), 1e-2, 0.01);
        let q = SVector::<f64, NX>::repeat(1.0);
        let x = algebraic_riccati(&rows, &q, r, ts).expect("stabilisable");
        let mut again = x;
        riccati_step(&mut again, &rows, &q, r, ts).expect("positive definite");
        let (x, again) = (matrix(&x), matrix(&again));
        assert!((again - x).amax() < 1e-9 * x.amax(), "moves by {}", (again - x).amax() / x.amax());
    }

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
    fn with_bearings(
        config: &upswing_config::Config,
        x: &upswing_model::State,
        a: &StateMatrix,
        friction: f64,
    ) -> StateMatrix {
        let mass = config.model.mass_matrix(&upswing_model::position(x), &mut Workspace::default());
        let m_uu: SMatrix<f64, 2, 2> = mass.fixed_view::<2, 2>(7, 7).into();
        let mut a = *a;
        let mut block = a.fixed_view_mut::<2, 2>(16, 16);
        block -= m_uu.try_inverse().expect("positive definite") * friction;
        a
    }

    #[test]
    fn balance_is_stable_with_a_free_rod_and_with_one_that_its_bearings_hold() {
        let config = upswing_config::Config::embedded().expect("settings");
        let planner = crate::replan::Planner::new(config.clone()).expect("the database fits");
        let ts = config.daemon.cycle.period.seconds();
        let work = &mut Workspace::default();
        for entry in planner.entries().iter().step_by(40) {
            let x = &entry.trajectory.x[N];
            let gains = synthesize(&config.model, &entry.trajectory, &config.planner, ts, work)
                .expect("stabilisable");
            let d = config.model.derivatives(x, &ActuatedVector::zeros(), work);
            for friction in [0.0, 0.03, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0] {
                let a = with_bearings(&config, x, &d.a(), friction);
                let mut closed = StateMatrix::identity() + (a + d.b() * gains.end) * ts;
                // After 2^18 periods, half a minute.
                for _ in 0..18 {
                    closed *= closed;
                }
                assert!(
                    closed.norm() < 1e-2,
                    "{friction} N m s/rad: a deviation becomes {:e}",
                    closed.norm()
                );
            }
        }
    }

    #[test]
    fn the_gains_of_a_swing_are_those_of_the_dense_recursion() {
        let config = upswing_config::Config::embedded().expect("settings");
        let planner = crate::replan::Planner::new(config.clone()).expect("the database fits");
        let trajectory = &planner.entries()[7].trajectory;
        let (weights, ts) = (&config.planner.lqr, config.daemon.cycle.period.seconds());
        let work = &mut Workspace::default();
        let gains = synthesize(&config.model, trajectory, &config.planner, ts, work).expect("stabilisable");

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
        // (21) by going back from no weight at all until nothing changes any more.
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
        // The gain that balances, for other weights of the angles.
        let balance = &config.planner.balance;
        let mut q_balance = q;
        for i in 0..NQ {
            let actuated = i < N_ACTUATED;
            q_balance[(i, i)] =
                if actuated { balance.q_angles_actuated } else { balance.q_angles_unactuated };
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
        // The period in which a knot lies; no period begins at or after t_F.
        let at = |k: usize| ((k as f64 * trajectory.h() / ts) as usize).min(periods - 1);
        for k in 0..=N {
            let error = (gains.knots[k] - by_period[at(k)]).amax();
            assert!(error < 1e-6 * scale, "knot {k}: {}", error / scale);
            // The gains of the neighbours are others.
            for neighbour in [k.saturating_sub(1), (k + 1).min(N)].into_iter().filter(|n| *n != k) {
                let change = (gains.knots[k] - by_period[at(neighbour)]).amax();
                assert!(change > 1e-4 * scale, "knots {k} and {neighbour}: {}", change / scale);
            }
        }
    }
}
