//! The factorisation, a sweep from the target to the start, and the solution of one right-hand side with it: a sweep back
//! and one forth.

use super::variables::{Entering, KnotRow, Leaving, U};
use super::{Kkt, KnotDynamics, KnotParts, NewtonStep, Rhs};
use crate::fixed::{ActuatedVector, NU, NX, NZ, vector};
use crate::rows::{KNOT_ROW, Pivot, STATE_ROW, StateRow, add_scaled};

/// Stiffness of the target rows in the factorised matrix. Large against the curvature of the problem, small
/// enough that its products keep eight digits of that curvature.
const TARGET_STIFFNESS: f64 = 1e6;

/// The inputs' block of a quadratic.
fn inputs_block(p: &[KnotRow; NZ]) -> [[f64; NU]; NU] {
    std::array::from_fn(|i| std::array::from_fn(|j| p[U + i][U + j]))
}

/// What the backward sweep leaves for one interval.
#[derive(Clone, Debug)]
struct Interval {
    leaving: Leaving,
    entering: Entering,
    /// (f_k + f_{k+1}) / (2 N)
    along_t: StateRow,
    /// Value function of stages k+1..N as one of s_k: its matrix S and the product with dt.
    value: [StateRow; NX],
    value_t: StateRow,
    /// The pivot block and du_{k+1} = K s_k + k_t dt + ...
    pivot: Pivot,
    gain: [StateRow; NU],
    gain_t: ActuatedVector,
}

/// The factorised matrix.
#[derive(Clone, Debug)]
pub struct Factor {
    intervals: Vec<Interval>,
    /// d^2 / du_0 dx_0 of the whole problem's value function, and its products with dt.
    value_ux: [StateRow; NU],
    value_xt: StateRow,
    pivot: Pivot,
    gain_t: ActuatedVector,
    pivot_t: f64,
}

impl Factor {
    /// Memory for a factor of `n` intervals.
    pub fn new(n: usize) -> Self {
        let none = KnotDynamics::zeros();
        let interval = Interval {
            leaving: Leaving::new(0.0, &none),
            entering: Entering::new(0.0, &none),
            along_t: [0.0; STATE_ROW],
            value: [[0.0; STATE_ROW]; NX],
            value_t: [0.0; STATE_ROW],
            pivot: Pivot::ZERO,
            gain: [[0.0; STATE_ROW]; NU],
            gain_t: ActuatedVector::zeros(),
        };
        Self {
            intervals: vec![interval; n],
            value_ux: [[0.0; STATE_ROW]; NU],
            value_xt: [0.0; STATE_ROW],
            pivot: Pivot::ZERO,
            gain_t: ActuatedVector::zeros(),
            pivot_t: 0.0,
        }
    }
}

impl Kkt {
    /// Backward sweep with `damping` added to the diagonal of every H_k and to w (inertia correction): one
    /// number for states and t, one for inputs. `factor` must be one for as many intervals. `false`, with a useless
    /// factor, if the reduced Hessian is not positive definite.
    pub fn factor_into(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> bool {
        self.try_factor(damping, input_damping, factor).is_some()
    }

    fn try_factor(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> Option<()> {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        let add_knot = |p: &mut [KnotRow; NZ], k: usize| {
            let columns = self.hessian[k].as_slice().chunks_exact(NZ);
            for (i, (row, column)) in p.iter_mut().zip(columns).enumerate() {
                for j in 0..NZ {
                    row[j] += column[j];
                }
                row[i] += if i < NX { damping } else { input_damping };
            }
        };
        let mut p = [[0.0; KNOT_ROW]; NZ];
        add_knot(&mut p, n);
        for row in &self.target {
            let c = &row.coefficients;
            for j in 0..NX {
                for i in 0..NX {
                    p[i][j] += TARGET_STIFFNESS * c[i] * c[j];
                }
            }
        }
        let mut p_t = self.with_t[n];
        let mut t_t = self.t_t + damping;
        for k in (0..n).rev() {
            let (near, far) = (&self.dynamics[k], &self.dynamics[k + 1]);
            let i = &mut factor.intervals[k];
            i.entering = Entering::new(half_h, far);
            i.leaving = Leaving::new(half_h, near);
            for l in 0..NX {
                i.along_t[l] = (near.f[l] + far.f[l]) / (2.0 * n as f64);
            }
            // In (s_k, du_{k+1}).
            i.entering.congruence(&mut p);
            let on_t = i.entering.apply_transposed(&p_t);
            // Without du_{k+1}.
            i.pivot = Pivot::new(&inputs_block(&p))?;
            for (gain, row) in i.gain.iter_mut().zip(&p[U..]) {
                gain.copy_from_slice(&row[..STATE_ROW]);
                gain[NX..].fill(0.0);
            }
            i.pivot.forward(&mut i.gain);
            for (a, (value, row)) in i.value.iter_mut().zip(&p).enumerate() {
                value.copy_from_slice(&row[..STATE_ROW]);
                value[NX..].fill(0.0);
                for y in &i.gain {
                    add_scaled(value, -y[a], y);
                }
            }
            for a in 0..NX {
                for b in 0..a {
                    let mean = 0.5 * (i.value[a][b] + i.value[b][a]);
                    (i.value[a][b], i.value[b][a]) = (mean, mean);
                }
            }
            i.pivot.backward(&mut i.gain);
            i.gain.iter_mut().flatten().for_each(|v| *v = -*v);
            i.gain_t = i.pivot.solve_negative(&on_t[U..]);
            i.value_t.copy_from_slice(&on_t[..STATE_ROW]);
            i.value_t[NX..].fill(0.0);
            for (l, gain) in i.gain.iter().enumerate() {
                add_scaled(&mut i.value_t, on_t[U + l], gain);
                t_t += on_t[U + l] * i.gain_t[l];
            }
            // In dz_k.
            let mut on_s = i.value_t;
            for (value, t) in i.value.iter().zip(&i.along_t) {
                add_scaled(&mut on_s, *t, value);
            }
            for l in 0..NX {
                t_t += i.along_t[l] * (on_s[l] + i.value_t[l]);
            }
            i.leaving.congruence(&i.value, &mut p);
            add_knot(&mut p, k);
            let on_z = i.leaving.apply_transposed(&on_s);
            for l in 0..NZ {
                p_t[l] = self.with_t[k][l] + on_z[l];
            }
        }
        // At the start dx_0 is given: u_0 and t are left.
        factor.pivot = Pivot::new(&inputs_block(&p))?;
        for (value, row) in factor.value_ux.iter_mut().zip(&p[U..]) {
            value.copy_from_slice(&row[..STATE_ROW]);
            value[NX..].fill(0.0);
        }
        factor.value_xt[..NX].copy_from_slice(&p_t.as_slice()[..NX]);
        factor.gain_t = factor.pivot.solve_negative(&p_t.as_slice()[U..]);
        factor.pivot_t = t_t + (0..NU).map(|l| p_t[U + l] * factor.gain_t[l]).sum::<f64>();
        (factor.pivot_t.is_finite() && factor.pivot_t > 0.0).then_some(())
    }

    /// One solve with the factorised matrix; its target rows hold to 1 / stiffness only.
    pub(super) fn sweep(
        &self,
        factor: &Factor,
        rhs: &Rhs,
        gradient: &mut [StateRow],
        feedforward: &mut [ActuatedVector],
        step: &mut NewtonStep,
    ) {
        let n = self.intervals();
        let mut p = rhs.g[n];
        for (row, r) in self.target.iter().zip(&rhs.target) {
            for i in 0..NX {
                p[i] += TARGET_STIFFNESS * row.coefficients[i] * r;
            }
        }
        let mut p_t = rhs.g_t;
        for k in (0..n).rev() {
            let i = &factor.intervals[k];
            let on = i.entering.apply_transposed(&p);
            feedforward[k] = i.pivot.solve_negative(&on[U..]);
            let mut on_s = [0.0; STATE_ROW];
            on_s[..NX].copy_from_slice(&on[..NX]);
            for (l, gain) in i.gain.iter().enumerate() {
                add_scaled(&mut on_s, on[U + l], gain);
                p_t += i.gain_t[l] * on[U + l];
            }
            gradient[k] = on_s;
            for (value, r) in i.value.iter().zip(rhs.defects[k].iter()) {
                add_scaled(&mut on_s, -r, value);
            }
            for l in 0..NX {
                p_t += i.along_t[l] * on_s[l] - i.value_t[l] * rhs.defects[k][l];
            }
            let on_z = i.leaving.apply_transposed(&on_s);
            for l in 0..NZ {
                p[l] = rhs.g[k][l] + on_z[l];
            }
        }
        let dx0 = rhs.start;
        let mut on_u = [0.0; NU];
        let mut on_t = p_t;
        for l in 0..NX {
            on_t += factor.value_xt[l] * dx0[l];
        }
        for (l, value) in factor.value_ux.iter().enumerate() {
            on_u[l] = p[U + l];
            for j in 0..NX {
                on_u[l] += value[j] * dx0[j];
            }
            on_t += factor.gain_t[l] * on_u[l];
        }
        let t = -on_t / factor.pivot_t;
        let u0 = factor.pivot.solve_negative(&on_u) + factor.gain_t * t;
        step.t = t;
        step.z[0].x_mut().copy_from(&dx0);
        step.z[0].fixed_rows_mut::<NU>(U).copy_from(&u0);
        for k in 0..n {
            let i = &factor.intervals[k];
            let mut s = i.leaving.apply(&step.z[k]) - rhs.defects[k];
            for l in 0..NX {
                s[l] += i.along_t[l] * t;
            }
            let mut lambda = gradient[k];
            add_scaled(&mut lambda, t, &i.value_t);
            for (value, s) in i.value.iter().zip(s.iter()) {
                add_scaled(&mut lambda, *s, value);
            }
            for l in 0..NX {
                step.lambda[k][l] = -lambda[l];
            }
            let mut u = feedforward[k] + i.gain_t * t;
            for (l, gain) in i.gain.iter().enumerate() {
                for j in 0..NX {
                    u[l] += gain[j] * s[j];
                }
            }
            step.z[k + 1] = i.entering.apply(&s, &u);
        }
        for (m, (row, r)) in step.lambda_target.iter_mut().zip(self.target.iter().zip(&rhs.target)) {
            *m = TARGET_STIFFNESS * (vector::<NX>(&row.coefficients).dot(&step.z[n].x()) + r);
        }
    }
}
