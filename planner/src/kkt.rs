//! Factorisation of the linear systems of trajectory optimisation.
//!
//! Both the offline problem (6) and the replanning QP (16) lead to
//!
//! min 1/2 sum_k dz_k' H_k dz_k + g_k' dz_k + dt sum_k c_k' dz_k + 1/2 w dt^2 + g_t dt
//! s.t. dx_{k+1} - dx_k - h/2 (A_k dx_k + B_k du_k + A_{k+1} dx_{k+1} + B_{k+1} du_{k+1})
//!      - dt (f_k + f_{k+1}) / (2 N) + r_k = 0,  dx_0 = r_0,  T dx_N + r_N = 0
//!
//! over dz_k = (dx_k, du_k) and the scalar dt. Between two knots stands the vector
//!
//! s_k = dx_k + h/2 (A_k dx_k + B_k du_k) + dt (f_k + f_{k+1}) / (2 N) - r_k
//!     = dx_{k+1} - h/2 (A_{k+1} dx_{k+1} + B_{k+1} du_{k+1}),
//!
//! the state that leaves knot k and enters knot k+1. A backward sweep takes the value function of stages k+1..N, a
//! quadratic in dz_{k+1} and dt, writes it in (s_k, du_{k+1}), eliminates du_{k+1}, and writes what is left in dz_k:
//! a Riccati recursion whose gradient with respect to s_k is the multiplier of interval k. Both changes of variables
//! are those of a double integrator but for the two rows of qdd_U, so that they cost a few row operations instead of
//! products of full matrices. The reduced Hessian is positive definite exactly if every pivot block is; that is the
//! inertia test, for free. The target rows T enter as a stiff penalty, whose error iterative refinement removes.

use crate::rows::{Pivot, ROW, STATE_ROW, StateRow, add_scaled};
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

/// First row of the velocities, of the unactuated velocities, and of the inputs among z = (x, u).
const V: usize = NQ;
const V_U: usize = NQ + N_ACTUATED;
const U: usize = NX;

type Row = [f64; ROW];
/// z = T (s, u): dz_{k+1} from the state s_k that enters the knot and its input, with the two dense rows of T.
#[derive(Clone, Copy, Debug)]
struct Entering {
    half_h: f64,
    /// dqd_U = M (s, u)
    m: [Row; N_UNACTUATED],
}

impl Entering {
    fn new(half_h: f64, knot: &KnotDynamics) -> Self {
        let mut rhs = [[0.0; ROW]; N_UNACTUATED];
        for (i, rhs) in rhs.iter_mut().enumerate() {
            for j in 0..NQ {
                rhs[j] = half_h * knot.qdd_u_x[(i, j)];
            }
            for j in 0..N_ACTUATED {
                let on_v = half_h * (knot.qdd_u_x[(i, V + j)] + rhs[j]);
                rhs[V + j] = on_v;
                rhs[U + j] = half_h * (knot.qdd_u_u[(i, j)] + on_v);
            }
            rhs[V_U + i] = 1.0;
        }
        // E_UU of E = I - h/2 A, with the unactuated angles eliminated.
        let block = SMatrix::<f64, N_UNACTUATED, N_UNACTUATED>::from_fn(|i, j| {
            let position = knot.qdd_u_x[(i, N_ACTUATED + j)];
            let velocity = knot.qdd_u_x[(i, V_U + j)];
            f64::from(u8::from(i == j)) - half_h * velocity - half_h * half_h * position
        })
        .try_inverse()
        .unwrap_or_else(|| SMatrix::from_element(f64::NAN));
        let mut m = [[0.0; ROW]; N_UNACTUATED];
        for i in 0..N_UNACTUATED {
            for l in 0..N_UNACTUATED {
                add_scaled(&mut m[i], block[(i, l)], &rhs[l]);
            }
        }
        Self { half_h, m }
    }

    /// T (s, u)
    #[inline(always)]
    fn apply(&self, s: &State, u: &ActuatedVector) -> KnotVector {
        let mut z = KnotVector::zeros();
        for j in 0..N_ACTUATED {
            z[V + j] = s[V + j] + self.half_h * u[j];
            z[U + j] = u[j];
        }
        for (i, m) in self.m.iter().enumerate() {
            let mut v = 0.0;
            for j in 0..NX {
                v += m[j] * s[j];
            }
            for j in 0..NU {
                v += m[U + j] * u[j];
            }
            z[V_U + i] = v;
        }
        for i in 0..NQ {
            z[i] = s[i] + self.half_h * z[V + i];
        }
        z
    }

    /// T' p
    #[inline(always)]
    fn apply_transposed(&self, p: &KnotVector) -> Row {
        let mut out = [0.0; ROW];
        out[..NZ].copy_from_slice(p.as_slice());
        self.columns(&mut out);
        out
    }

    /// One row, or one column, of a quadratic: out = T' out.
    #[inline(always)]
    fn columns(&self, out: &mut Row) {
        for i in 0..NQ {
            out[V + i] += self.half_h * out[i];
        }
        for i in 0..N_ACTUATED {
            out[U + i] += self.half_h * out[V + i];
        }
        let on_v: [f64; N_UNACTUATED] = std::array::from_fn(|i| out[V_U + i]);
        out[V_U..V_U + N_UNACTUATED].fill(0.0);
        for (m, p) in self.m.iter().zip(on_v) {
            add_scaled(out, p, m);
        }
    }

    /// T' P T for a symmetric P.
    #[inline(always)]
    fn congruence(&self, p: &mut [Row; NZ]) {
        for i in 0..NQ {
            let q = p[i];
            add_scaled(&mut p[V + i], self.half_h, &q);
        }
        for i in 0..N_ACTUATED {
            let v = p[V + i];
            add_scaled(&mut p[U + i], self.half_h, &v);
        }
        let on_v: [Row; N_UNACTUATED] = std::array::from_fn(|i| p[V_U + i]);
        for i in 0..N_UNACTUATED {
            p[V_U + i] = [0.0; ROW];
        }
        for (j, row) in p.iter_mut().enumerate() {
            for (m, v) in self.m.iter().zip(&on_v) {
                add_scaled(row, m[j], v);
            }
            self.columns(row);
        }
    }
}

/// s = N dz_k: the state that leaves a knot, with the two dense rows of N.
#[derive(Clone, Copy, Debug)]
struct Leaving {
    half_h: f64,
    n: [Row; N_UNACTUATED],
}

impl Leaving {
    fn new(half_h: f64, knot: &KnotDynamics) -> Self {
        let mut n = [[0.0; ROW]; N_UNACTUATED];
        for (i, n) in n.iter_mut().enumerate() {
            for j in 0..NX {
                n[j] = half_h * knot.qdd_u_x[(i, j)];
            }
            for j in 0..NU {
                n[U + j] = half_h * knot.qdd_u_u[(i, j)];
            }
            n[V_U + i] += 1.0;
        }
        Self { half_h, n }
    }

    /// N z
    #[inline(always)]
    fn apply(&self, z: &KnotVector) -> State {
        let mut s = State::zeros();
        for i in 0..NQ {
            s[i] = z[i] + self.half_h * z[V + i];
        }
        for i in 0..N_ACTUATED {
            s[V + i] = z[V + i] + self.half_h * z[U + i];
        }
        for (i, n) in self.n.iter().enumerate() {
            let mut v = 0.0;
            for j in 0..NZ {
                v += n[j] * z[j];
            }
            s[V_U + i] = v;
        }
        s
    }

    /// N' p
    #[inline(always)]
    fn apply_transposed(&self, p: &StateRow) -> Row {
        let mut out = [0.0; ROW];
        out[..V_U].copy_from_slice(&p[..V_U]);
        for i in 0..NQ {
            out[V + i] += self.half_h * p[i];
        }
        for i in 0..N_ACTUATED {
            out[U + i] = self.half_h * p[V + i];
        }
        for (i, n) in self.n.iter().enumerate() {
            add_scaled(&mut out, p[V_U + i], n);
        }
        out
    }

    /// N' S N for a symmetric S.
    #[inline(always)]
    fn congruence(&self, s: &[StateRow; NX], p: &mut [Row; NZ]) {
        for (j, out) in p.iter_mut().enumerate() {
            let mut row = [0.0; STATE_ROW];
            if j < V_U {
                row = s[j];
            }
            if (V..U).contains(&j) {
                add_scaled(&mut row, self.half_h, &s[j - V]);
            } else if j >= U {
                add_scaled(&mut row, self.half_h, &s[j - U + V]);
            }
            for (i, n) in self.n.iter().enumerate() {
                add_scaled(&mut row, n[j], &s[V_U + i]);
            }
            *out = self.apply_transposed(&row);
        }
    }
}

/// The inputs' block of a quadratic.
fn inputs_block(p: &[Row; NZ]) -> [[f64; NU]; NU] {
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
        let none = KnotDynamics { qdd_u_x: SMatrix::zeros(), qdd_u_u: SMatrix::zeros(), f: State::zeros() };
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

/// Memory of [`Kkt::solve_into`].
#[derive(Clone, Debug)]
pub struct SolveWorkspace {
    /// Gradient of the value function of stages k+1..N at s_k = 0, and the input there.
    gradient: Vec<StateRow>,
    feedforward: Vec<ActuatedVector>,
    left: Rhs,
    next_left: Rhs,
    correction: Step,
    refined: Step,
}

impl SolveWorkspace {
    /// For systems of `n` intervals with `targets` target rows.
    pub fn new(n: usize, targets: usize) -> Self {
        Self {
            gradient: vec![[0.0; STATE_ROW]; n],
            feedforward: vec![ActuatedVector::zeros(); n],
            left: Rhs::zeros(n, targets),
            next_left: Rhs::zeros(n, targets),
            correction: Step::zeros(n, targets),
            refined: Step::zeros(n, targets),
        }
    }
}

impl Step {
    /// A step of the right size, all zero.
    pub fn zeros(n: usize, targets: usize) -> Self {
        Self {
            z: vec![KnotVector::zeros(); n + 1],
            t: 0.0,
            dynamics: vec![State::zeros(); n],
            target: vec![0.0; targets],
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.z.copy_from_slice(&other.z);
        self.t = other.t;
        self.dynamics.copy_from_slice(&other.dynamics);
        self.target.copy_from_slice(&other.target);
    }
}

impl Kkt {
    fn intervals(&self) -> usize {
        self.dynamics.len() - 1
    }

    /// Backward sweep with `damping` added to the diagonal of every H_k and to w (inertia correction): one
    /// number for states and t, one for inputs. `factor` must be one for as many intervals. `false`, with a useless
    /// factor, if the reduced Hessian is not positive definite.
    pub fn factor_into(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> bool {
        self.try_factor(damping, input_damping, factor).is_some()
    }

    fn try_factor(&self, damping: f64, input_damping: f64, factor: &mut Factor) -> Option<()> {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        let add_knot = |p: &mut [Row; NZ], k: usize| {
            let columns = self.hessian[k].as_slice().chunks_exact(NZ);
            for (i, (row, column)) in p.iter_mut().zip(columns).enumerate() {
                for j in 0..NZ {
                    row[j] += column[j];
                }
                row[i] += if i < NX { damping } else { input_damping };
            }
        };
        let mut p = [[0.0; ROW]; NZ];
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
    fn sweep(
        &self,
        factor: &Factor,
        rhs: &Rhs,
        gradient: &mut [StateRow],
        feedforward: &mut [ActuatedVector],
        step: &mut Step,
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
            for (value, r) in i.value.iter().zip(rhs.dynamics[k].iter()) {
                add_scaled(&mut on_s, -r, value);
            }
            for l in 0..NX {
                p_t += i.along_t[l] * on_s[l] - i.value_t[l] * rhs.dynamics[k][l];
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
        step.z[0].fixed_rows_mut::<NX>(0).copy_from(&dx0);
        step.z[0].fixed_rows_mut::<NU>(U).copy_from(&u0);
        for k in 0..n {
            let i = &factor.intervals[k];
            let mut s = i.leaving.apply(&step.z[k]) - rhs.dynamics[k];
            for l in 0..NX {
                s[l] += i.along_t[l] * t;
            }
            let mut lambda = gradient[k];
            add_scaled(&mut lambda, t, &i.value_t);
            for (value, s) in i.value.iter().zip(s.iter()) {
                add_scaled(&mut lambda, *s, value);
            }
            for l in 0..NX {
                step.dynamics[k][l] = -lambda[l];
            }
            let mut u = feedforward[k] + i.gain_t * t;
            for (l, gain) in i.gain.iter().enumerate() {
                for j in 0..NX {
                    u[l] += gain[j] * s[j];
                }
            }
            step.z[k + 1] = i.entering.apply(&s, &u);
        }
        for (m, (row, r)) in step.target.iter_mut().zip(self.target.iter().zip(&rhs.target)) {
            *m = TARGET_STIFFNESS * (row.coefficients.dot(&step.z[n].fixed_rows::<NX>(0)) + r);
        }
    }

    /// Adds to `left` what the constraints contribute to the conditions of a solution: their multipliers' forces
    /// on z and t, and their residuals at z and t.
    pub(crate) fn add_constraints(&self, step: &Step, left: &mut Rhs) {
        let n = self.intervals();
        let half_h = 0.5 * self.h;
        for k in 0..=n {
            // Multipliers of the intervals on both sides.
            let mut sum = State::zeros();
            let g = &mut left.g[k];
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
            *g -= self.dynamics[k].apply_transposed(&sum) * half_h;
            left.g_t -= sum.dot(&self.dynamics[k].f) / (2.0 * n as f64);
        }
        for (row, m) in self.target.iter().zip(&step.target) {
            for i in 0..NX {
                left.g[n][i] += row.coefficients[i] * m;
            }
        }
        let mut near = self.dynamics[0].apply(&step.z[0]);
        for k in 0..n {
            let far = self.dynamics[k + 1].apply(&step.z[k + 1]);
            let share = step.t / (2.0 * n as f64);
            for i in 0..NX {
                left.dynamics[k][i] += step.z[k + 1][i]
                    - step.z[k][i]
                    - (near[i] + far[i]) * half_h
                    - (self.dynamics[k].f[i] + self.dynamics[k + 1].f[i]) * share;
            }
            near = far;
        }
        left.start -= step.z[0].fixed_rows::<NX>(0);
        for (l, row) in left.target.iter_mut().zip(&self.target) {
            *l += row.coefficients.dot(&step.z[n].fixed_rows::<NX>(0));
        }
        // The start state carries a multiplier of its own, which nobody needs.
        for i in 0..NX {
            left.g[0][i] = 0.0;
        }
    }

    /// What is left of the right-hand side at `step`, with the damping of the factorisation.
    fn residual(&self, rhs: &Rhs, step: &Step, damping: f64, input_damping: f64, left: &mut Rhs) {
        left.copy_from(rhs);
        left.g_t += (self.t_t + damping) * step.t;
        for (k, z) in step.z.iter().enumerate() {
            let g = &mut left.g[k];
            g.gemv(1.0, &self.hessian[k], z, 1.0);
            g.axpy(step.t, &self.with_t[k], 1.0);
            for i in 0..NZ {
                g[i] += z[i] * if i < NX { damping } else { input_damping };
            }
            left.g_t += self.with_t[k].dot(z);
        }
        self.add_constraints(step, left);
    }

    /// Solves the system with the `damping` of the factorisation, refining until the residual stops shrinking: at most
    /// as often as given, and not once the residual is below the given share of the right-hand side.
    pub fn solve_into(
        &self,
        factor: &Factor,
        rhs: &Rhs,
        damping: (f64, f64),
        (refinements, accuracy): (usize, f64),
        work: &mut SolveWorkspace,
        step: &mut Step,
    ) {
        let SolveWorkspace { gradient, feedforward, left, next_left, correction, refined } = work;
        self.sweep(factor, rhs, gradient, feedforward, step);
        if refinements == 0 {
            return;
        }
        self.residual(rhs, step, damping.0, damping.1, left);
        let scale = rhs.norm().max(1e-300);
        let mut norm = left.norm();
        for _ in 0..refinements {
            if norm <= accuracy * scale {
                break;
            }
            self.sweep(factor, left, gradient, feedforward, correction);
            refined.copy_from(step);
            refined.add(correction);
            self.residual(rhs, refined, damping.0, damping.1, next_left);
            let next_norm = next_left.norm();
            // A NaN also ends the loop.
            if !(next_norm < norm) {
                break;
            }
            step.copy_from(refined);
            std::mem::swap(left, next_left);
            norm = next_norm;
        }
    }

    /// A right-hand side of the right size, all zero.
    pub fn zero_rhs(&self) -> Rhs {
        Rhs::zeros(self.intervals(), self.target.len())
    }
}

impl Rhs {
    /// Overwrites this with `other`, which has the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.g.copy_from_slice(&other.g);
        self.g_t = other.g_t;
        self.dynamics.copy_from_slice(&other.dynamics);
        self.start = other.start;
        self.target.copy_from_slice(&other.target);
    }

    /// Largest entry.
    fn norm(&self) -> f64 {
        let g = self.g.iter().map(|g| g.amax()).fold(self.g_t.abs(), f64::max);
        let d = self.dynamics.iter().map(|d| d.amax()).fold(self.start.amax(), f64::max);
        self.target.iter().map(|t| t.abs()).fold(g.max(d), f64::max)
    }
}
