//! Discrete time-variant LQR (18)-(23) along a trajectory.

use crate::fixed::{N_UNACTUATED, NQ, NU, NX, vector};
use crate::rows::{Pivot, STATE_ROW, StateRow, add_scaled};
use nalgebra::SMatrix;
use upswing_model::{ActuatedVector, Linearization, Model, State, Workspace};
use upswing_trajectory::{Gains, Trajectory};

type StateVector = crate::fixed::State;
type Gain = SMatrix<f64, NU, NX>;
type StateMatrix = SMatrix<f64, NX, NX>;

/// The symmetric matrix P of the cost-to-go x' P x, by rows.
type CostToGo = [StateRow; NX];

/// The rows of A and B that are not constant: d qdd_U / dx and d qdd_U / du.
#[derive(Clone, Copy, Debug)]
struct DynamicsRows {
    a: [StateRow; N_UNACTUATED],
    b: [[f64; NU]; N_UNACTUATED],
}

impl DynamicsRows {
    fn new(d: &Linearization) -> Self {
        let mut a = [[0.0; STATE_ROW]; N_UNACTUATED];
        for (m, row) in a.iter_mut().enumerate() {
            row[..NX].copy_from_slice(&d.qdd_u(m)[..NX]);
        }
        Self { a, b: std::array::from_fn(|m| std::array::from_fn(|j| d.qdd_u(m)[NX + j])) }
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

/// The Riccati equation (21) has no stabilising solution at the trajectory's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no gain stabilises the end of the trajectory: the Riccati equation (21) has no solution there")]
pub struct NotStabilisable;

/// Weights Q_c and R_c of (20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LqrWeights {
    /// Diagonal of Q_c along the trajectory: 1/rad^2 for angles, s^2/rad^2 for velocities.
    pub q: State,
    /// The same for the gain that holds x_N. With the weights of the trajectory that gain is unstable if the bearings of the
    /// pendulum have more friction than 0.2 N m s/rad, as at small speeds they have where they stick.
    pub q_end: State,
    /// r of R_c = r I, s^4/rad^2.
    pub r: f64,
}

/// Solves (21), then iterates (23) backwards with the period `ts` (s), with A and B interpolated between the
/// knots; keeps the gains at the knots.
///
/// # Errors
/// [`NotStabilisable`] if (21) has no stabilising solution at x_N.
pub fn synthesize(
    model: &Model,
    trajectory: &Trajectory,
    weights: &LqrWeights,
    ts: f64,
    work: &mut Workspace,
) -> Result<Gains, NotStabilisable> {
    let mut derivatives = Linearization::new(model.sizes());
    let mut rows_at = |x: &State, u: &ActuatedVector| {
        model.linearize(x, u, work, &mut derivatives);
        DynamicsRows::new(&derivatives)
    };
    let rows: Vec<DynamicsRows> = trajectory.knots().map(|(x, u)| rows_at(x, u)).collect();
    // The end is an equilibrium: u = 0 there, whatever the last knot's input.
    let at_end = rows_at(trajectory.end(), &ActuatedVector::zeros(model.sizes()));
    let (q, q_end) = (vector(&weights.q), vector(&weights.q_end));
    let mut p = algebraic_riccati(&at_end, &q, weights.r, ts).ok_or(NotStabilisable)?;
    let step = |p: &mut CostToGo, rows: &DynamicsRows, q: &StateVector| {
        riccati_step(p, rows, q, weights.r, ts).ok_or(NotStabilisable)
    };
    let end = {
        let mut p = algebraic_riccati(&at_end, &q_end, weights.r, ts).ok_or(NotStabilisable)?;
        step(&mut p, &at_end, &q_end)?.gain()
    };

    let steps = (trajectory.t_f / ts).floor() as usize;
    let h = trajectory.h();
    let n = trajectory.intervals();
    let mut knots = vec![end; n + 1];
    let mut next_knot = n;
    for i in (0..steps).rev() {
        let t = i as f64 * ts;
        let k = ((t / h) as usize).min(n - 1);
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
    if !finite {
        return Err(NotStabilisable);
    }
    let mut gains = Gains::zeros(model.sizes(), n);
    let put = |out: &mut [f64], gain: &Gain| out.copy_from_slice(gain.transpose().as_slice());
    put(gains.end_mut(), &end);
    knots.iter().enumerate().for_each(|(k, gain)| put(gains.knot_mut(k), gain));
    Ok(gains)
}

/// The factors of K in (23).
struct GainFactors {
    /// L L' = R + Gamma' P Gamma
    pivot: Pivot,
    /// L^-1 Gamma' P Phi
    g: [StateRow; NU],
}

impl GainFactors {
    /// K = -(R + Gamma' P Gamma)^-1 Gamma' P Phi
    fn gain(&self) -> Gain {
        let mut k = self.g;
        self.pivot.backward(&mut k);
        Gain::from_fn(|i, j| -k[i][j])
    }
}

/// One step of (23): moves P one period back. With `Phi = I + Ts A` and `A = [[0, I], [0], [a]]`,
/// `Gamma = Ts [[0], [I], [b]]` all products are a few row operations.
fn riccati_step(
    p: &mut CostToGo,
    rows: &DynamicsRows,
    q: &StateVector,
    r: f64,
    ts: f64,
) -> Option<GainFactors> {
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
            0 => cost_to_go_row::<4>(p, i, rows, &v_u, &g, ts),
            1 => cost_to_go_row::<8>(p, i, rows, &v_u, &g, ts),
            2 => cost_to_go_row::<12>(p, i, rows, &v_u, &g, ts),
            3 => cost_to_go_row::<16>(p, i, rows, &v_u, &g, ts),
            _ => cost_to_go_row::<STATE_ROW>(p, i, rows, &v_u, &g, ts),
        }
        p[i][i] += q[i];
    }
    for i in 0..NX {
        for j in 0..i {
            p[j][i] = p[i][j];
        }
    }
    Some(GainFactors { pivot, g })
}

/// The first W entries of row i of Phi' (P Phi) - G' G, for P Phi in `p` (its rows up to i) and in `v_u` (those of the
/// unactuated velocities).
#[inline(always)]
fn cost_to_go_row<const W: usize>(
    p: &mut CostToGo,
    i: usize,
    rows: &DynamicsRows,
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
fn discretised(rows: &DynamicsRows, ts: f64) -> (StateMatrix, SMatrix<f64, NX, NU>) {
    let mut phi = StateMatrix::identity();
    let mut gamma = SMatrix::zeros();
    for i in 0..NQ {
        phi[(i, NQ + i)] += ts;
    }
    for i in 0..NU {
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
fn algebraic_riccati(rows: &DynamicsRows, q: &StateVector, r: f64, ts: f64) -> Option<CostToGo> {
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
            let mut x = [[0.0; STATE_ROW]; NX];
            for (i, row) in x.iter_mut().enumerate() {
                for j in 0..NX {
                    row[j] = h[(i, j)];
                }
            }
            return Some(x);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> DynamicsRows {
        let mut a = [[0.0; STATE_ROW]; N_UNACTUATED];
        for (i, row) in a.iter_mut().enumerate() {
            for j in 0..NX {
                row[j] = ((3 * i + 5 * j) % 7) as f64 - 3.0 + if j == NQ - 1 { 20.0 } else { 0.0 };
            }
        }
        let b = |i, j| ((2 * i + 3 * j) % 5) as f64 * 0.4 - 0.9;
        DynamicsRows { a, b: std::array::from_fn(|i| std::array::from_fn(|j| b(i, j))) }
    }

    fn matrix(p: &CostToGo) -> StateMatrix {
        StateMatrix::from_fn(|i, j| p[i][j])
    }

    #[test]
    fn a_structured_step_equals_the_dense_formula_23() {
        let (rows, ts, r) = (rows(), 1e-2, 0.01);
        let q = StateVector::from_fn(|i, _| 1.0 + i as f64);
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
        let q = StateVector::repeat(1.0);
        let x = algebraic_riccati(&rows, &q, r, ts).expect("stabilisable");
        let mut again = x;
        riccati_step(&mut again, &rows, &q, r, ts).expect("positive definite");
        let (x, again) = (matrix(&x), matrix(&again));
        assert!((again - x).amax() < 1e-9 * x.amax(), "moves by {}", (again - x).amax() / x.amax());
    }
}
