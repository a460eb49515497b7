//! Factorisation of the linear systems of trajectory optimisation.
//!
//! Both the offline problem (6) and the replanning QP (16) lead to
//!
//! min 1/2 sum_k dz_k' H_k dz_k + g_k' dz_k + dt sum_k c_k' dz_k + 1/2 w dt^2 + g_t dt
//! s.t. dx_{k+1} - dx_k - h/2 (A_k dx_k + B_k du_k + A_{k+1} dx_{k+1} + B_{k+1} du_{k+1})
//!      - dt (f_k + f_{k+1}) / (2 N) + r_k = 0,  dx_0 = r_0,  T dx_N + r_N = 0
//!
//! over dz_k = (dx_k, du_k) and the scalar dt. A backward sweep eliminates du_{k+1} given dz_k: the value
//! function of stages k..N is a quadratic in dz_k and dt, as in a Riccati recursion for a system with state z_k
//! and control u_{k+1}. The reduced Hessian is positive definite exactly if every pivot block is; that is the
//! inertia test, for free. The target rows T enter as a stiff penalty, whose error iterative refinement removes.

use nalgebra::{SMatrix, SVector};
use upswing_model::{ActuatedVector, Derivatives, N_ACTUATED, N_UNACTUATED, NQ, NU, NX, NZ, State};

/// z_k = (x_k, u_k) or a derivative with respect to it.
pub type KnotVector = SVector<f64, NZ>;
/// Second derivatives with respect to z_k.
pub type KnotMatrix = SMatrix<f64, NZ, NZ>;

/// Stiffness of the target rows in the factorised matrix. Large against the curvature of the problem, small
/// enough that its products keep eight digits of that curvature.
const TARGET_STIFFNESS: f64 = 1e6;

/// Linearised dynamics of one knot.
#[derive(Clone, Debug)]
pub struct KnotDynamics {
    /// d qdd_U / dx and d qdd_U / du: the rows of A_k and B_k that are not those of double integrators.
    pub qdd_u_x: SMatrix<f64, N_UNACTUATED, NX>,
    /// See `qdd_u_x`.
    pub qdd_u_u: SMatrix<f64, N_UNACTUATED, NU>,
    /// f(x_k, u_k)
    pub f: State,
}

impl KnotDynamics {
    /// From the model's derivatives at (x, u).
    pub fn new(d: &Derivatives, x: &State, u: &ActuatedVector) -> Self {
        Self { qdd_u_x: d.qdd_u_x, qdd_u_u: d.qdd_u_u, f: d.f(x, u) }
    }

    /// A dx + B du
    pub fn apply(&self, dz: &KnotVector) -> State {
        let (dx, du) = (dz.fixed_rows::<NX>(0), dz.fixed_rows::<NU>(NX));
        let mut out = State::zeros();
        out.fixed_rows_mut::<NQ>(0).copy_from(&dz.fixed_rows::<NQ>(NQ));
        out.fixed_rows_mut::<N_ACTUATED>(NQ).copy_from(&du);
        let unactuated = self.qdd_u_x * dx + self.qdd_u_u * du;
        out.fixed_rows_mut::<N_UNACTUATED>(NX - N_UNACTUATED).copy_from(&unactuated);
        out
    }

    /// [A, B]' w
    pub fn apply_transposed(&self, w: &State) -> KnotVector {
        let w_u = w.fixed_rows::<N_UNACTUATED>(NX - N_UNACTUATED);
        let mut out = KnotVector::zeros();
        out.fixed_rows_mut::<NX>(0).copy_from(&(self.qdd_u_x.transpose() * w_u));
        for i in 0..NQ {
            out[NQ + i] += w[i];
        }
        let on_u = self.qdd_u_u.transpose() * w_u + w.fixed_rows::<N_ACTUATED>(NQ);
        out.fixed_rows_mut::<NU>(NX).copy_from(&on_u);
        out
    }

    /// The two coefficients of E = I - h/2 A that its inverse needs: (E_UU^-1 of the unactuated velocities).
    fn implicit_block(&self, half_h: f64) -> SMatrix<f64, N_UNACTUATED, N_UNACTUATED> {
        SMatrix::<f64, N_UNACTUATED, N_UNACTUATED>::from_fn(|i, j| {
            let position = self.qdd_u_x[(i, N_ACTUATED + j)];
            let velocity = self.qdd_u_x[(i, NQ + N_ACTUATED + j)];
            f64::from(u8::from(i == j)) - half_h * velocity - half_h * half_h * position
        })
        .try_inverse()
        .unwrap_or_else(|| SMatrix::from_element(f64::NAN))
    }

    /// (I - h/2 A)^-1 rhs, with the inverse block of [`Self::implicit_block`].
    fn solve_implicit(
        &self,
        half_h: f64,
        block: &SMatrix<f64, N_UNACTUATED, N_UNACTUATED>,
        rhs: &State,
    ) -> State {
        let mut y = *rhs;
        // y_q = r_q + h/2 y_v; the rows of y_v,A are those of the identity.
        let mut partial = *rhs;
        for i in 0..N_ACTUATED {
            partial[i] += half_h * rhs[NQ + i];
        }
        for i in 0..N_UNACTUATED {
            partial[NQ + N_ACTUATED + i] = 0.0;
        }
        let mut r_u = self.qdd_u_x * partial * half_h;
        for i in 0..N_UNACTUATED {
            r_u[i] += rhs[NQ + N_ACTUATED + i];
        }
        let y_u = block * r_u;
        y.fixed_rows_mut::<N_UNACTUATED>(NX - N_UNACTUATED).copy_from(&y_u);
        for i in 0..NQ {
            y[i] = rhs[i] + half_h * y[NQ + i];
        }
        y
    }

    /// (I - h/2 A)^-T rhs
    fn solve_implicit_transposed(
        &self,
        half_h: f64,
        block: &SMatrix<f64, N_UNACTUATED, N_UNACTUATED>,
        rhs: &State,
    ) -> State {
        // Transpose of solve_implicit, line by line in reverse.
        let mut v = *rhs;
        for i in 0..NQ {
            v[NQ + i] += half_h * rhs[i];
        }
        let w = block.transpose() * v.fixed_rows::<N_UNACTUATED>(NX - N_UNACTUATED) * half_h;
        let mut out = v;
        for i in 0..N_UNACTUATED {
            out[NQ + N_ACTUATED + i] = w[i] / half_h;
        }
        let through = self.qdd_u_x.transpose() * w;
        for i in 0..NQ {
            out[i] += through[i];
        }
        for i in 0..N_ACTUATED {
            out[NQ + i] += through[NQ + i] + half_h * through[i];
        }
        out
    }
}

/// One row of the target condition: `coefficients` . x_N = `value` (8).
#[derive(Clone, Debug, PartialEq)]
pub struct TargetRow {
    /// Of x_N.
    pub coefficients: State,
    /// What the product shall be.
    pub value: f64,
}

/// Right-hand side of the system: gradients and residuals.
#[derive(Clone, Debug)]
pub struct Rhs {
    /// g_k
    pub g: Vec<KnotVector>,
    /// g_t
    pub g_t: f64,
    /// r_k: defects of the dynamics, N of them.
    pub dynamics: Vec<State>,
    /// r_0: what dx_0 shall be.
    pub start: State,
    /// r_N: residual of each target row.
    pub target: Vec<f64>,
}

impl Rhs {
    fn zeros(n: usize, targets: usize) -> Self {
        Self {
            g: vec![KnotVector::zeros(); n + 1],
            g_t: 0.0,
            dynamics: vec![State::zeros(); n],
            start: State::zeros(),
            target: vec![0.0; targets],
        }
    }
}

/// Step and multipliers that solve the system.
#[derive(Clone, Debug)]
pub struct Step {
    /// dz_k
    pub z: Vec<KnotVector>,
    /// dt
    pub t: f64,
    /// Multipliers of the dynamics, N of them.
    pub dynamics: Vec<State>,
    /// Multipliers of the target rows.
    pub target: Vec<f64>,
}

impl Step {
    fn add(&mut self, other: &Self) {
        self.z.iter_mut().zip(&other.z).for_each(|(a, b)| *a += b);
        self.t += other.t;
        self.dynamics.iter_mut().zip(&other.dynamics).for_each(|(a, b)| *a += b);
        self.target.iter_mut().zip(&other.target).for_each(|(a, b)| *a += b);
    }
}

/// The matrix of the system.
#[derive(Clone, Debug)]
pub struct Kkt {
    /// h = t_F / N, s.
    pub h: f64,
    /// H_k, symmetric.
    pub hessian: Vec<KnotMatrix>,
    /// c_k: second derivatives with respect to z_k and t.
    pub with_t: Vec<KnotVector>,
    /// w: second derivative with respect to t.
    pub t_t: f64,
    /// A_k, B_k, f_k
    pub dynamics: Vec<KnotDynamics>,
    /// T
    pub target: Vec<TargetRow>,
}

/// What the backward sweep leaves for one interval.
#[derive(Clone, Debug)]
struct Interval {
    implicit: SMatrix<f64, N_UNACTUATED, N_UNACTUATED>,
    /// dx_{k+1} = F dz_k + G du_{k+1} + d dt + ...
    transition: SMatrix<f64, NX, NZ>,
    input: SMatrix<f64, NX, NU>,
    along_t: State,
    /// Value function of stages k+1..N: P_{k+1} and its products with dt.
    value: KnotMatrix,
    value_t: KnotVector,
    /// Cholesky factor of the pivot block and the gain du_{k+1} = K dz_k + ...
    pivot: nalgebra::Cholesky<f64, nalgebra::Const<NU>>,
    gain: SMatrix<f64, NU, NZ>,
    gain_t: ActuatedVector,
}

/// The factorised matrix.
#[derive(Clone, Debug)]
pub struct Factor {
    intervals: Vec<Interval>,
    value: KnotMatrix,
    value_t: KnotVector,
    pivot: nalgebra::Cholesky<f64, nalgebra::Const<NU>>,
    gain_t: ActuatedVector,
    pivot_t: f64,
}

/// c += a b
#[inline(always)]
fn multiply_add<const M: usize, const K: usize, const C: usize>(
    c: &mut SMatrix<f64, M, C>,
    a: &SMatrix<f64, M, K>,
    b: &SMatrix<f64, K, C>,
) {
    for j in 0..C {
        for k in 0..K {
            let s = b[(k, j)];
            for i in 0..M {
                c[(i, j)] += a[(i, k)] * s;
            }
        }
    }
}

impl Kkt {
    fn intervals(&self) -> usize {
        self.dynamics.len() - 1
    }

    /// Backward sweep with `damping` added to the diagonal of every H_k and to w (inertia correction): one
    /// number for states and t, one for inputs. `None` if the reduced Hessian is not positive definite.
    pub fn factor(&self, damping: f64, input_damping: f64) -> Option<Factor> {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        let damped = |k: usize| {
            let mut h = self.hessian[k];
            for i in 0..NZ {
                h[(i, i)] += if i < NX { damping } else { input_damping };
            }
            h
        };
        let mut value = damped(n);
        for row in &self.target {
            let c = &row.coefficients;
            for j in 0..NX {
                for i in 0..NX {
                    value[(i, j)] += TARGET_STIFFNESS * c[i] * c[j];
                }
            }
        }
        let mut value_t = self.with_t[n];
        let mut t_t = self.t_t + damping;
        let mut intervals = Vec::with_capacity(n);
        for k in (0..n).rev() {
            let (near, far) = (&self.dynamics[k], &self.dynamics[k + 1]);
            let implicit = far.implicit_block(half_h);
            let solve = |rhs: &State| far.solve_implicit(half_h, &implicit, rhs);
            let mut transition = SMatrix::<f64, NX, NZ>::zeros();
            let mut input = SMatrix::<f64, NX, NU>::zeros();
            for j in 0..NZ {
                let mut column = State::zeros();
                // Column j of [I + h/2 A, h/2 B] of the near knot.
                if j < NX {
                    column[j] = 1.0;
                    if j >= NQ {
                        column[j - NQ] += half_h;
                    }
                } else {
                    column[NQ + j - NX] = half_h;
                }
                for i in 0..N_UNACTUATED {
                    let row = NX - N_UNACTUATED + i;
                    column[row] +=
                        half_h * if j < NX { near.qdd_u_x[(i, j)] } else { near.qdd_u_u[(i, j - NX)] };
                }
                transition.set_column(j, &solve(&column));
            }
            for j in 0..NU {
                let mut column = State::zeros();
                column[NQ + j] = half_h;
                for i in 0..N_UNACTUATED {
                    column[NX - N_UNACTUATED + i] += half_h * far.qdd_u_u[(i, j)];
                }
                input.set_column(j, &solve(&column));
            }
            let along_t = solve(&((near.f + far.f) / (2.0 * n as f64)));

            let p_xx: SMatrix<f64, NX, NX> = value.fixed_view::<NX, NX>(0, 0).into();
            let p_xu: SMatrix<f64, NX, NU> = value.fixed_view::<NX, NU>(0, NX).into();
            let p_uu: SMatrix<f64, NU, NU> = value.fixed_view::<NU, NU>(NX, NX).into();
            let mut on_x = SMatrix::<f64, NX, NZ>::zeros();
            multiply_add(&mut on_x, &p_xx, &transition);
            // G' Pxx + Pux
            let mut on_u = p_xu.transpose();
            multiply_add(&mut on_u, &input.transpose(), &p_xx);
            let mut q_uu = p_uu;
            multiply_add(&mut q_uu, &on_u, &input);
            multiply_add(&mut q_uu, &input.transpose(), &p_xu);
            let pivot = q_uu.cholesky()?;
            let mut q_uz = SMatrix::<f64, NU, NZ>::zeros();
            multiply_add(&mut q_uz, &on_u, &transition);
            let vt_x: State = value_t.fixed_rows::<NX>(0).into();
            let vt_u: ActuatedVector = value_t.fixed_rows::<NU>(NX).into();
            let shifted = p_xx * along_t + vt_x;
            let q_ut = p_xu.transpose() * along_t + vt_u + input.transpose() * shifted;
            let gain = -pivot.solve(&q_uz);
            let gain_t = -pivot.solve(&q_ut);

            t_t += along_t.dot(&(p_xx * along_t + vt_x * 2.0)) + q_ut.dot(&gain_t);
            let mut next = damped(k);
            multiply_add(&mut next, &transition.transpose(), &on_x);
            multiply_add(&mut next, &q_uz.transpose(), &gain);
            let next_t = self.with_t[k] + transition.transpose() * shifted + gain.transpose() * q_ut;
            intervals.push(Interval {
                implicit,
                transition,
                input,
                along_t,
                value,
                value_t,
                pivot,
                gain,
                gain_t,
            });
            value = (next + next.transpose()) * 0.5;
            value_t = next_t;
        }
        intervals.reverse();
        // At the start dx_0 is given: u_0 and t are left.
        let p_uu: SMatrix<f64, NU, NU> = value.fixed_view::<NU, NU>(NX, NX).into();
        let pivot = p_uu.cholesky()?;
        let vt_u: ActuatedVector = value_t.fixed_rows::<NU>(NX).into();
        let gain_t = -pivot.solve(&vt_u);
        let pivot_t = t_t + vt_u.dot(&gain_t);
        (pivot_t.is_finite() && pivot_t > 0.0).then_some(Factor {
            intervals,
            value,
            value_t,
            pivot,
            gain_t,
            pivot_t,
        })
    }

    /// One solve with the factorised matrix; its target rows hold to 1 / stiffness only.
    fn sweep(&self, factor: &Factor, rhs: &Rhs) -> Step {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        let mut p = rhs.g[n];
        for (row, r) in self.target.iter().zip(&rhs.target) {
            for i in 0..NX {
                p[i] += TARGET_STIFFNESS * row.coefficients[i] * r;
            }
        }
        let mut p_t = rhs.g_t;
        let mut offsets = vec![State::zeros(); n];
        let mut feedforward = vec![ActuatedVector::zeros(); n];
        let mut gradients = vec![KnotVector::zeros(); n];
        for k in (0..n).rev() {
            let i = &factor.intervals[k];
            let far = &self.dynamics[k + 1];
            let offset = far.solve_implicit(half_h, &i.implicit, &-rhs.dynamics[k]);
            let p_x: State = p.fixed_rows::<NX>(0).into();
            let p_u: ActuatedVector = p.fixed_rows::<NU>(NX).into();
            let shifted = i.value.fixed_view::<NX, NX>(0, 0) * offset + p_x;
            let q_u = i.value.fixed_view::<NU, NX>(NX, 0) * offset + p_u + i.input.transpose() * shifted;
            let u = -i.pivot.solve(&q_u);
            // Terms in dt: (value_t + P along_t)' offset + along_t' p + q_ut' u, with q_ut = -Q gain_t.
            p_t += i.along_t.dot(&shifted) + i.value_t.fixed_rows::<NX>(0).dot(&offset) + i.gain_t.dot(&q_u);
            gradients[k] = p;
            p = rhs.g[k] + i.transition.transpose() * shifted + i.gain.transpose() * q_u;
            offsets[k] = offset;
            feedforward[k] = u;
        }
        let dx0 = rhs.start;
        let p_u: ActuatedVector = p.fixed_rows::<NU>(NX).into();
        let on_u = p_u + factor.value.fixed_view::<NU, NX>(NX, 0) * dx0;
        let on_t = p_t + factor.value_t.fixed_rows::<NX>(0).dot(&dx0) + factor.gain_t.dot(&on_u);
        let t = -on_t / factor.pivot_t;
        let u0 = -factor.pivot.solve(&on_u) + factor.gain_t * t;

        let mut step = Step {
            z: Vec::with_capacity(n + 1),
            t,
            dynamics: Vec::with_capacity(n),
            target: vec![0.0; rhs.target.len()],
        };
        let join = |x: &State, u: &ActuatedVector| {
            let mut z = KnotVector::zeros();
            z.fixed_rows_mut::<NX>(0).copy_from(x);
            z.fixed_rows_mut::<NU>(NX).copy_from(u);
            z
        };
        step.z.push(join(&dx0, &u0));
        for k in 0..n {
            let i = &factor.intervals[k];
            let z = &step.z[k];
            let u = i.gain * z + feedforward[k] + i.gain_t * t;
            let x = i.transition * z + i.input * u + i.along_t * t + offsets[k];
            let next = join(&x, &u);
            let on_x = i.value.fixed_rows::<NX>(0) * next
                + gradients[k].fixed_rows::<NX>(0)
                + i.value_t.fixed_rows::<NX>(0) * t;
            let lambda = self.dynamics[k + 1].solve_implicit_transposed(half_h, &i.implicit, &-on_x);
            step.dynamics.push(lambda);
            step.z.push(next);
        }
        for (m, (row, r)) in step.target.iter_mut().zip(self.target.iter().zip(&rhs.target)) {
            *m = TARGET_STIFFNESS * (row.coefficients.dot(&step.z[n].fixed_rows::<NX>(0)) + r);
        }
        step
    }

    /// What is left of the right-hand side at `step`, with the damping of the factorisation.
    fn residual(&self, rhs: &Rhs, step: &Step, damping: f64, input_damping: f64) -> Rhs {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        let mut left = rhs.clone();
        left.g_t += (self.t_t + damping) * step.t;
        for k in 0..=n {
            let z = &step.z[k];
            let mut g = self.hessian[k] * z + self.with_t[k] * step.t;
            for i in 0..NZ {
                g[i] += z[i] * if i < NX { damping } else { input_damping };
            }
            left.g_t += self.with_t[k].dot(z);
            // Multipliers of the intervals on both sides.
            let mut sum = State::zeros();
            if k < n {
                sum += step.dynamics[k];
                for i in 0..NX {
                    g[i] -= step.dynamics[k][i];
                }
            }
            if k > 0 {
                sum += step.dynamics[k - 1];
                for i in 0..NX {
                    g[i] += step.dynamics[k - 1][i];
                }
            }
            g -= self.dynamics[k].apply_transposed(&sum) * half_h;
            left.g_t -= sum.dot(&self.dynamics[k].f) / (2.0 * n as f64);
            left.g[k] += g;
        }
        for (row, m) in self.target.iter().zip(&step.target) {
            for i in 0..NX {
                left.g[n][i] += row.coefficients[i] * m;
            }
        }
        for k in 0..n {
            let (near, far) = (&self.dynamics[k], &self.dynamics[k + 1]);
            let dx: State = (step.z[k + 1] - step.z[k]).fixed_rows::<NX>(0).into();
            left.dynamics[k] += dx
                - (near.apply(&step.z[k]) + far.apply(&step.z[k + 1])) * half_h
                - (near.f + far.f) * (step.t / (2.0 * n as f64));
        }
        left.start -= step.z[0].fixed_rows::<NX>(0);
        for (l, row) in left.target.iter_mut().zip(&self.target) {
            *l += row.coefficients.dot(&step.z[n].fixed_rows::<NX>(0));
        }
        // The start state carries a multiplier of its own, which nobody needs.
        for i in 0..NX {
            left.g[0][i] = 0.0;
        }
        left
    }

    /// Solves the system, refining until the residual stops shrinking. `damping` as in [`Self::factor`].
    pub fn solve(&self, factor: &Factor, rhs: &Rhs, damping: f64, input_damping: f64) -> Step {
        /// Each refinement gains several digits; more than this many means there is nothing left to gain.
        const REFINEMENTS: usize = 8;
        let mut step = self.sweep(factor, rhs);
        let mut left = self.residual(rhs, &step, damping, input_damping);
        let scale = rhs.norm().max(1e-300);
        let mut norm = left.norm();
        for _ in 0..REFINEMENTS {
            if norm <= 1e-12 * scale {
                break;
            }
            let mut refined = step.clone();
            refined.add(&self.sweep(factor, &left));
            let next = self.residual(rhs, &refined, damping, input_damping);
            let next_norm = next.norm();
            // A NaN also ends the loop.
            if !(next_norm < norm) {
                break;
            }
            (step, left, norm) = (refined, next, next_norm);
        }
        step
    }

    /// A right-hand side of the right size, all zero.
    pub fn zero_rhs(&self) -> Rhs {
        Rhs::zeros(self.intervals(), self.target.len())
    }
}

impl Rhs {
    /// Largest entry.
    fn norm(&self) -> f64 {
        let g = self.g.iter().map(|g| g.amax()).fold(self.g_t.abs(), f64::max);
        let d = self.dynamics.iter().map(|d| d.amax()).fold(self.start.amax(), f64::max);
        self.target.iter().map(|t| t.abs()).fold(g.max(d), f64::max)
    }
}
