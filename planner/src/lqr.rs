//! Discrete time-variant LQR (18)-(23) along a trajectory.

use nalgebra::{SMatrix, SVector};
use upswing_config::LqrWeights;
use upswing_model::{ActuatedVector, Model, N_ACTUATED, N_UNACTUATED, NQ, NU, NX, Workspace};
use upswing_trajectory::{Gain, N, Trajectory};

type StateMatrix = SMatrix<f64, NX, NX>;

/// The rows of A and B that are not constant: d qdd_U / dx and d qdd_U / du.
#[derive(Clone, Debug)]
struct Rows {
    a: SMatrix<f64, N_UNACTUATED, NX>,
    b: SMatrix<f64, N_UNACTUATED, NU>,
}

/// Gains of a trajectory.
#[derive(Clone, Debug)]
pub struct Gains {
    /// K_k of (23) at the knots.
    pub knots: Vec<Gain>,
    /// The gain that belongs to the terminal weight X (21): holds x_N.
    pub end: Gain,
}

/// The Riccati equation (21) has no stabilising solution at the trajectory's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no gain stabilises the end of the trajectory: the Riccati equation (21) has no solution there")]
pub struct NotStabilisable;

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
    let rows: Vec<Rows> = trajectory
        .x
        .iter()
        .zip(&trajectory.u)
        .map(|(x, u)| {
            let d = model.derivatives(x, u, work);
            Rows { a: d.qdd_u_x, b: d.qdd_u_u }
        })
        .collect();
    let q = SVector::<f64, NX>::from_fn(|i, _| match i {
        i if i < NQ => weights.q_angles,
        i if i < NQ + N_ACTUATED => weights.q_velocities_actuated,
        _ => weights.q_velocities_unactuated,
    });
    // The end is an equilibrium: u = 0 there, whatever the last knot's input.
    let at_end = model.derivatives(&trajectory.x[N], &ActuatedVector::zeros(), work);
    let end_rows = Rows { a: at_end.qdd_u_x, b: at_end.qdd_u_u };
    let mut p = algebraic_riccati(&end_rows, &q, weights.r, ts).ok_or(NotStabilisable)?;
    let (end, _) = riccati_step(&p, &end_rows, &q, weights.r, ts).ok_or(NotStabilisable)?;

    let steps = (trajectory.t_f / ts).floor() as usize;
    let h = trajectory.h();
    let mut knots = vec![end; N + 1];
    let mut next_knot = N;
    for step in (0..steps).rev() {
        let t = step as f64 * ts;
        let k = ((t / h) as usize).min(N - 1);
        let share = t / h - k as f64;
        let between = Rows {
            a: rows[k].a + (rows[k + 1].a - rows[k].a) * share,
            b: rows[k].b + (rows[k + 1].b - rows[k].b) * share,
        };
        let (gain, next) = riccati_step(&p, &between, &q, weights.r, ts).ok_or(NotStabilisable)?;
        p = next;
        // The first gain at or before a knot's time serves the knot.
        while next_knot > 0 && t <= next_knot as f64 * h {
            knots[next_knot] = gain;
            next_knot -= 1;
        }
        if step == 0 {
            knots[0] = gain;
        }
    }
    Ok(Gains { knots, end })
}

/// One step of (23): the gain K and the weight one period earlier. With `Phi = I + Ts A` and
/// `A = [[0, I], [0], [a]]`, `Gamma = Ts [[0], [I], [b]]` all products are a few rows.
fn riccati_step(
    p: &StateMatrix,
    rows: &Rows,
    q: &SVector<f64, NX>,
    r: f64,
    ts: f64,
) -> Option<(Gain, StateMatrix)> {
    const U: usize = NX - N_UNACTUATED;
    // P Phi
    let mut p_phi = *p;
    for j in 0..NX {
        for i in 0..NX {
            let mut sum = 0.0;
            for m in 0..N_UNACTUATED {
                sum += p[(i, U + m)] * rows.a[(m, j)];
            }
            if j >= NQ {
                sum += p[(i, j - NQ)];
            }
            p_phi[(i, j)] += ts * sum;
        }
    }
    // Phi' (P Phi), symmetric
    let mut next = p_phi;
    for j in 0..NX {
        for i in 0..NX {
            let mut sum = 0.0;
            for m in 0..N_UNACTUATED {
                sum += rows.a[(m, i)] * p_phi[(U + m, j)];
            }
            if i >= NQ {
                sum += p_phi[(i - NQ, j)];
            }
            next[(i, j)] += ts * sum;
        }
    }
    // Gamma' P Phi and R + Gamma' P Gamma
    let mut g_p_phi = Gain::zeros();
    let mut pivot = SMatrix::<f64, NU, NU>::zeros();
    let mut p_gamma = SMatrix::<f64, NX, NU>::zeros();
    for j in 0..NU {
        for i in 0..NX {
            let mut sum = p[(i, NQ + j)];
            for m in 0..N_UNACTUATED {
                sum += p[(i, U + m)] * rows.b[(m, j)];
            }
            p_gamma[(i, j)] = ts * sum;
        }
    }
    for i in 0..NU {
        for j in 0..NX {
            let mut sum = p_phi[(NQ + i, j)];
            for m in 0..N_UNACTUATED {
                sum += rows.b[(m, i)] * p_phi[(U + m, j)];
            }
            g_p_phi[(i, j)] = ts * sum;
        }
        for j in 0..NU {
            let mut sum = p_gamma[(NQ + i, j)];
            for m in 0..N_UNACTUATED {
                sum += rows.b[(m, i)] * p_gamma[(U + m, j)];
            }
            pivot[(i, j)] = ts * sum;
        }
        pivot[(i, i)] += r;
    }
    let gain = -pivot.cholesky()?.solve(&g_p_phi);
    for j in 0..NX {
        for k in 0..NU {
            let s = gain[(k, j)];
            for i in 0..NX {
                next[(i, j)] += g_p_phi[(k, i)] * s;
            }
        }
        next[(j, j)] += q[j];
    }
    // Symmetrised, or rounding grows over 17 000 steps.
    let next = (next + next.transpose()) * 0.5;
    next.iter().all(|v| v.is_finite()).then_some((gain, next))
}

/// X of (21) by structured doubling (Chu, Fan, Lin, Wang, *Structure-preserving algorithms for periodic
/// discrete-time algebraic Riccati equations*, Int. J. Control 77, 2004): each step doubles the horizon.
fn algebraic_riccati(rows: &Rows, q: &SVector<f64, NX>, r: f64, ts: f64) -> Option<StateMatrix> {
    /// 2^40 periods of 125 us are four years.
    const DOUBLINGS: usize = 40;
    let mut a = StateMatrix::identity();
    for i in 0..NQ {
        a[(i, NQ + i)] += ts;
    }
    let mut gamma = SMatrix::<f64, NX, NU>::zeros();
    for i in 0..N_ACTUATED {
        gamma[(NQ + i, i)] = ts;
    }
    for m in 0..N_UNACTUATED {
        let row = NX - N_UNACTUATED + m;
        for j in 0..NX {
            a[(row, j)] += ts * rows.a[(m, j)];
        }
        for j in 0..NU {
            gamma[(row, j)] = ts * rows.b[(m, j)];
        }
    }
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
            return Some(h);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Rows {
        Rows {
            a: SMatrix::from_fn(|i, j| {
                ((3 * i + 5 * j) % 7) as f64 - 3.0 + if j == NQ - 1 { 20.0 } else { 0.0 }
            }),
            b: SMatrix::from_fn(|i, j| ((2 * i + 3 * j) % 5) as f64 * 0.4 - 0.9),
        }
    }

    fn dense(rows: &Rows, ts: f64) -> (StateMatrix, SMatrix<f64, NX, NU>) {
        let mut phi = StateMatrix::identity();
        let mut gamma = SMatrix::<f64, NX, NU>::zeros();
        for i in 0..NQ {
            phi[(i, NQ + i)] += ts;
        }
        for i in 0..N_ACTUATED {
            gamma[(NQ + i, i)] = ts;
        }
        for m in 0..N_UNACTUATED {
            for j in 0..NX {
                phi[(NX - N_UNACTUATED + m, j)] += ts * rows.a[(m, j)];
            }
            for j in 0..NU {
                gamma[(NX - N_UNACTUATED + m, j)] = ts * rows.b[(m, j)];
            }
        }
        (phi, gamma)
    }

    #[test]
    fn a_structured_step_equals_the_dense_formula_23() {
        let (rows, ts, r) = (rows(), 1e-2, 0.01);
        let q = SVector::<f64, NX>::from_fn(|i, _| 1.0 + i as f64);
        let seed = StateMatrix::from_fn(|i, j| ((i * 7 + j * 3) % 11) as f64 - 5.0);
        let p = seed * seed.transpose() + StateMatrix::identity();
        let (gain, next) = riccati_step(&p, &rows, &q, r, ts).expect("positive definite");
        let (phi, gamma) = dense(&rows, ts);
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
        let (_, again) = riccati_step(&x, &rows, &q, r, ts).expect("positive definite");
        assert!((again - x).amax() < 1e-9 * x.amax(), "moves by {}", (again - x).amax() / x.amax());
    }
}
