//! Exact first and second derivatives of the hybrid dynamics (3a), (3b), and with them of f (5) and of the motor torque (9), (11).
//!
//! Moving joint i carries body i and all bodies after it rigidly along, which changes no scalar product among them; what
//! remains is that velocity and acceleration of the bodies *before* i do not move along. Relative to the rigid
//! motion they change by psi_i = V_{i-1} x S_i and psi''_i = A_{i-1} x S_i + V_{i-1} x psi_i. With this,
//! the derivatives of r = M qdd + C qd + g become scalar products of one vector per joint (first
//! derivatives as in Singh, Russell, Wensing, *Efficient Analytical Derivatives of Rigid-Body Dynamics using
//! Spatial Vector Algebra*, IEEE RA-L 2022), and so do the second derivatives of eta . r for a constant eta,
//! in which W = sum S_j eta_j is a virtual velocity and omega_i = W_{i-1} x S_i its counterpart of psi_i.
//!
//! The unactuated acceleration is eliminated by an adjoint: with nu = -M_UU^-1 (w + M_UA mu) the function
//! w . qdd_U + mu . tau equals w . a_U + [mu, nu] . r(q, qd, [u, a_U]) for every a_U near qdd_U to first order.

use crate::dynamics::{HybridValues, solve_unactuated, state_derivative};
use crate::spatial::{Matrix3, SpatialVector, Vector3, product, skew};
use crate::{
    ActuatedVector, Dims, HybridDynamics, MOST_JOINTS, Model, Scalar, Sizes, State, UnactuatedVector,
    Workspace, with_dims,
};
use nalgebra::DMatrix;

/// Velocity-product terms of body i and all bodies after it together: D p = [d1 p_ang, 2 p_ang x momentum] with
/// D_b p = I (p x V) + p x* I V + V x* I p, which does not depend on the linear part of p.
#[derive(Clone, Copy, Debug)]
struct Coriolis<T> {
    d1: Matrix3<T>,
    momentum: Vector3<T>,
}

impl<T: Scalar> Coriolis<T> {
    const ZERO: Self = Self { d1: Matrix3::ZERO, momentum: Vector3::ZERO };

    #[inline(always)]
    fn apply(&self, p_ang: &Vector3<T>) -> SpatialVector<T> {
        let lin = p_ang.cross(&self.momentum);
        SpatialVector::new(self.d1.times(p_ang), lin + lin)
    }

    /// The angular part of D^T m (the linear part vanishes).
    #[inline(always)]
    fn apply_transposed(&self, m: &SpatialVector<T>) -> Vector3<T> {
        let lin = self.momentum.cross(&m.lin);
        self.d1.tr_times(&m.ang) + (lin + lin)
    }
}

/// First derivatives of the hybrid dynamics (3a), (3b) at one state and input: one dense row over z = [q, qd, u] for each motor torque
/// and then for each unactuated acceleration.
///
/// The rows of q and qd in A = df/dx and B = df/du (19) that are constant are not stored. Memory is made once per chain.
#[derive(Clone, Debug)]
pub struct Linearization<T = f64> {
    value: HybridValues<T>,
    sizes: Sizes,
    /// Rows of the length [`Dims::knot_row`], 0 beyond the length of z.
    rows: Vec<T>,
    coriolis: [Coriolis<T>; MOST_JOINTS],
    psi_dd: [SpatialVector<T>; MOST_JOINTS],
    /// D_i^T S_i, angular part.
    swept: [Vector3<T>; MOST_JOINTS],
}

impl<T: Scalar> Linearization<T> {
    /// Memory for the derivatives of a chain.
    pub fn new(sizes: Sizes) -> Self {
        Self {
            value: HybridValues::ZERO,
            sizes,
            rows: vec![T::ZERO; sizes.joints() * sizes.knot_row()],
            coriolis: [Coriolis::ZERO; MOST_JOINTS],
            psi_dd: [SpatialVector::ZERO; MOST_JOINTS],
            swept: [Vector3::ZERO; MOST_JOINTS],
        }
    }

    /// Numbers of joints of the chain.
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// All rows: those of tau_A, then those of qdd_U, each of the length [`Dims::knot_row`].
    #[inline(always)]
    pub fn rows(&self) -> &[T] {
        &self.rows
    }

    /// Row `i`, with the length [`Dims::knot_row`].
    #[inline(always)]
    fn row(&self, i: usize) -> &[T] {
        let stride = self.sizes.knot_row();
        &self.rows[i * stride..][..stride]
    }

    /// d tau_A / dz of the motor of actuated joint `a`.
    #[inline(always)]
    pub fn tau(&self, a: usize) -> &[T] {
        &self.row(a)[..self.sizes.knot()]
    }

    /// d qdd_U / dz of unactuated joint `c`.
    #[inline(always)]
    pub fn qdd_u(&self, c: usize) -> &[T] {
        &self.row(self.sizes.actuated() + c)[..self.sizes.knot()]
    }

    /// tau_A at the point of the derivatives, followed by numbers without a meaning.
    #[inline(always)]
    pub fn tau_values(&self) -> &[T; MOST_JOINTS] {
        &self.value.tau
    }

    /// qdd_U at the point of the derivatives, followed by numbers without a meaning.
    #[inline(always)]
    pub fn qdd_u_values(&self) -> &[T; MOST_JOINTS] {
        &self.value.qdd_u
    }
}

impl Linearization {
    /// qdd_U and tau_A at the point of the derivatives.
    pub fn value(&self) -> HybridDynamics {
        HybridDynamics {
            qdd_u: UnactuatedVector::from_fn(self.sizes, |i| self.value.qdd_u[i]),
            tau: ActuatedVector::from_fn(self.sizes, |i| self.value.tau[i]),
        }
    }

    /// f(x, u) (5) at the point of the derivatives.
    pub fn f(&self, x: &State, u: &ActuatedVector) -> State {
        state_derivative(x, u, &self.value().qdd_u)
    }

    /// A = df/dx (19), `[[0, I], [0, 0], [d qdd_U / dx]]`.
    pub fn a(&self) -> DMatrix<f64> {
        let (n, actuated) = (self.sizes.joints(), self.sizes.actuated());
        DMatrix::from_fn(2 * n, 2 * n, |i, j| match i {
            i if i < n => f64::from(u8::from(j == n + i)),
            i if i < n + actuated => 0.0,
            i => self.qdd_u(i - n - actuated)[j],
        })
    }

    /// B = df/du (19), `[[0], [I], [d qdd_U / du]]`.
    pub fn b(&self) -> DMatrix<f64> {
        let (n, actuated) = (self.sizes.joints(), self.sizes.actuated());
        DMatrix::from_fn(2 * n, actuated, |i, j| match i {
            i if i < n => 0.0,
            i if i < n + actuated => f64::from(u8::from(j == i - n)),
            i => self.qdd_u(i - n - actuated)[2 * n + j],
        })
    }
}

impl Model {
    /// First derivatives of the hybrid dynamics at `x` and `u` (sorted, as [`State`] and [`ActuatedVector`]), and the state of `work` that
    /// [`Self::hessian`] needs.
    ///
    /// # Panics
    /// If `x`, `u` or `out` are shorter than the sizes of the chain.
    pub fn linearize<T: Scalar>(
        &self,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut Linearization<T>,
    ) {
        assert_eq!(out.sizes, self.sizes(), "memory of another chain");
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has AVX2.
            return unsafe { self.linearize_avx2(x, u, work, out) };
        }
        with_dims!(self.sizes(), |d| self.linearize_with(d, x, u, work, out));
    }

    /// [`Self::linearize`] with registers of 256 bits, and the same bits: nothing is contracted to fused operations.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn linearize_avx2<T: Scalar>(
        &self,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut Linearization<T>,
    ) {
        with_dims!(self.sizes(), |d| self.linearize_with(d, x, u, work, out));
    }

    /// First derivatives of the hybrid dynamics at qd = 0, whose torque M~ u + g~ (11) does not depend on qd. `x` is the state; its
    /// velocities are ignored.
    pub fn linearize_without_coriolis<T: Scalar>(
        &self,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut Linearization<T>,
    ) {
        let n = self.sizes().joints();
        let mut at_rest = [T::ZERO; crate::LARGEST_STATE];
        at_rest[..n].copy_from_slice(&x[..n]);
        self.linearize(&at_rest[..2 * n], u, work, out);
        let stride = self.sizes().knot_row();
        for row in out.rows.chunks_exact_mut(stride) {
            row[n..2 * n].fill(T::ZERO);
        }
    }

    /// Second derivatives of `w` . qdd_U + `mu` . tau with respect to z = [q, qd, u], symmetric, into `h`: rows of the length
    /// [`Dims::knot_row`]. `first` and `work` are the result and the scratch memory of the last call of [`Self::linearize`].
    ///
    /// # Panics
    /// If `w`, `mu` or `h` are shorter than the sizes of the chain.
    pub fn hessian<T: Scalar>(
        &self,
        w: &[T],
        mu: &[T],
        first: &Linearization<T>,
        work: &mut Workspace<T>,
        h: &mut [T],
    ) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has AVX2.
            return unsafe { self.hessian_avx2(w, mu, first, work, h) };
        }
        with_dims!(self.sizes(), |d| self.hessian_with(d, w, mu, first, work, h));
    }

    /// [`Self::hessian`] with registers of 256 bits, and the same bits.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn hessian_avx2<T: Scalar>(
        &self,
        w: &[T],
        mu: &[T],
        first: &Linearization<T>,
        work: &mut Workspace<T>,
        h: &mut [T],
    ) {
        with_dims!(self.sizes(), |d| self.hessian_with(d, w, mu, first, work, h));
    }

    /// Second derivatives of `mu` . (M~ u + g~) (11) with respect to z = [q, qd, u] into `h`, as in [`Self::hessian`]. `first` and `work`
    /// are the result and the scratch memory of the last call of [`Self::linearize_without_coriolis`].
    pub fn hessian_without_coriolis<T: Scalar>(
        &self,
        mu: &[T],
        first: &Linearization<T>,
        work: &mut Workspace<T>,
        h: &mut [T],
    ) {
        self.hessian(&[T::ZERO; MOST_JOINTS], mu, first, work, h);
        let (n, stride) = (self.sizes().joints(), self.sizes().knot_row());
        for (i, row) in h.chunks_exact_mut(stride).enumerate() {
            if (n..2 * n).contains(&i) {
                row.fill(T::ZERO);
            } else {
                row[n..2 * n].fill(T::ZERO);
            }
        }
    }

    /// g_U (N m or N) and, by rows, its derivative with respect to q_U, at rest.
    pub(crate) fn unactuated_gravity(
        &self,
        q: &[f64],
        work: &mut Workspace,
        out: &mut Linearization,
    ) -> (UnactuatedVector, crate::vector::Matrix<crate::vector::Unactuated, crate::vector::Unactuated>) {
        let (sizes, stride) = (self.sizes(), self.sizes().knot_row());
        let actuated = sizes.actuated();
        let rest = [0.0; MOST_JOINTS];
        self.update_positions(sizes, q, work);
        self.update_velocities(sizes, &rest, work);
        work.qdd = rest;
        self.update_accelerations(sizes, self.upward(), &rest, work);
        self.inverse_dynamics_rows(sizes, work, out);
        let gravity = UnactuatedVector::from_fn(sizes, |c| {
            let i = self.order.joint(actuated + c);
            work.axis[i].dot(&work.force[i])
        });
        let curvature =
            crate::vector::Matrix::from_fn(sizes, |r, c| out.rows[(actuated + r) * stride + actuated + c]);
        (gravity, curvature)
    }

    #[inline(always)]
    fn linearize_with<T: Scalar>(
        &self,
        d: impl Dims,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut Linearization<T>,
    ) {
        let (n, actuated, unactuated) = (d.joints(), d.actuated(), d.unactuated());
        self.hybrid_values(d, x, u, work, &mut out.value);
        for c in 0..unactuated {
            work.qdd[self.order.joint(actuated + c)] = out.value.qdd_u[c];
        }
        self.update_accelerations(d, self.upward(), &x[n..2 * n], work);
        self.inverse_dynamics_rows(d, work, out);
        self.eliminate_unactuated(d, work, out);
    }

    /// Rows of dr/dz, r = M qdd + C qd + D qd + g, at the state of `work`, in which the accelerations are complete: all of q and qd, and of qdd
    /// the columns of the actuated joints.
    #[inline(always)]
    fn inverse_dynamics_rows<T: Scalar>(
        &self,
        d: impl Dims,
        work: &mut Workspace<T>,
        out: &mut Linearization<T>,
    ) {
        let (n, actuated, stride) = (d.joints(), d.actuated(), d.knot_row());
        let mut sum = Coriolis::ZERO;
        for i in (0..n).rev() {
            let (v, body) = (&work.velocity[i + 1], &work.body[i]);
            let w = skew(&v.ang);
            let wi = product(&w, &body.rotational.full());
            let mut d1 = Matrix3::ZERO;
            for r in 0..3 {
                for c in 0..3 {
                    // I w = -(w I)' for symmetric I and skew w.
                    d1.0[r][c] = wi.0[r][c] + wi.0[c][r];
                }
            }
            let hv = product(&skew(&body.moment), &skew(&v.lin));
            let d1 = d1.minus(&skew(&body.rotational.times(&v.ang))).minus(&hv.plus(&hv));
            sum.d1 = sum.d1.plus(&d1);
            sum.momentum += body.apply(v).lin;
            out.coriolis[i] = sum;
        }
        for i in 0..n {
            work.carried[i] = work.composite[i].apply(&work.axis[i]);
            out.swept[i] = out.coriolis[i].apply_transposed(&work.axis[i]);
            out.psi_dd[i] = work.acceleration[i].cross_motion(&work.axis[i])
                + work.velocity[i].cross_motion(&work.psi[i]);
        }
        for i in 0..n {
            let (s, psi, psi_dd) = (&work.axis[i], &work.psi[i], &out.psi_dd[i]);
            let coriolis = &out.coriolis[i];
            let on_q =
                s.cross_force(&work.force[i]) + work.composite[i].apply(psi_dd) + coriolis.apply(&psi.ang);
            let on_qd = work.composite[i].apply(psi).twice() + coriolis.apply(&s.ang);
            let column = self.order.coordinate(i);
            for k in 0..i {
                let row = &mut out.rows[self.order.coordinate(k) * stride..][..stride];
                row[column] = work.axis[k].dot(&on_q);
                row[n + column] = work.axis[k].dot(&on_qd);
                if column < actuated {
                    row[2 * n + column] = work.axis[k].dot(&work.carried[i]);
                }
            }
            for k in i..n {
                let row = &mut out.rows[self.order.coordinate(k) * stride..][..stride];
                row[column] = psi_dd.dot(&work.carried[k]) + psi.ang.dot(&out.swept[k]);
                let carried = psi.dot(&work.carried[k]);
                row[n + column] = s.ang.dot(&out.swept[k]) + (carried + carried);
                if column < actuated {
                    row[2 * n + column] = s.dot(&work.carried[k]);
                }
            }
        }
        for a in 0..actuated {
            out.rows[a * stride + 2 * n + a] += T::constant(self.rotors[a]);
        }
        for (c, i) in (actuated..n).enumerate() {
            out.rows[i * stride + n + i] += T::constant(self.friction[c]);
        }
    }

    /// Turns rows of dr/dz into rows of dqdd_U/dz = -M_UU^-1 dr_U/dz and dtau_A/dz = dr_A/dz + M_AU dqdd_U/dz.
    #[inline(always)]
    fn eliminate_unactuated<T: Scalar>(&self, d: impl Dims, work: &Workspace<T>, out: &mut Linearization<T>) {
        let (actuated, unactuated, stride) = (d.actuated(), d.unactuated(), d.knot_row());
        let (rows_a, rows_u) = out.rows.split_at_mut(actuated * stride);
        let m = &work.eliminated;
        for p in 0..unactuated {
            for r in p + 1..unactuated {
                let factor = m[r][p];
                let (upper, lower) = rows_u.split_at_mut(r * stride);
                for (l, u) in lower[..stride].iter_mut().zip(&upper[p * stride..][..stride]) {
                    *l -= factor * *u;
                }
            }
        }
        for p in (0..unactuated).rev() {
            let (upper, lower) = rows_u.split_at_mut((p + 1) * stride);
            let row = &mut upper[p * stride..];
            for k in p + 1..unactuated {
                let factor = m[p][k];
                // The rows below are those of dqdd_U/dz already, with the opposite sign.
                for (r, l) in row.iter_mut().zip(&lower[(k - p - 1) * stride..][..stride]) {
                    *r += factor * *l;
                }
            }
            let pivot = m[p][p];
            for r in row.iter_mut() {
                *r = -(*r / pivot);
            }
        }
        for a in 0..actuated {
            let row = &mut rows_a[a * stride..][..stride];
            for c in 0..unactuated {
                let factor = work.columns[c][a];
                for (r, l) in row.iter_mut().zip(&rows_u[c * stride..][..stride]) {
                    *r += factor * *l;
                }
            }
        }
    }

    #[inline(always)]
    fn hessian_with<T: Scalar>(
        &self,
        d: impl Dims,
        w: &[T],
        mu: &[T],
        first: &Linearization<T>,
        work: &mut Workspace<T>,
        h: &mut [T],
    ) {
        let (n, actuated, unactuated, stride) = (d.joints(), d.actuated(), d.unactuated(), d.knot_row());
        let mut nu = [T::ZERO; MOST_JOINTS];
        for c in 0..unactuated {
            let mut sum = w[c];
            for a in 0..actuated {
                sum += work.columns[c][a] * mu[a];
            }
            nu[c] = -sum;
        }
        solve_unactuated(d, work, &mut nu);
        let mut eta = [T::ZERO; MOST_JOINTS];
        for i in 0..n {
            let c = self.order.coordinate(i);
            eta[i] = if c < actuated { mu[c] } else { nu[c - actuated] };
        }
        // W_{i-1}, omega_i = W_{i-1} x S_i
        work.virtual_velocity[0] = SpatialVector::ZERO;
        for i in 0..n {
            work.omega[i] = work.virtual_velocity[i].cross_motion(&work.axis[i]);
            work.virtual_velocity[i + 1] = work.virtual_velocity[i] + work.axis[i] * eta[i];
        }
        h[..d.knot() * stride].fill(T::ZERO);
        // Sums over body i and all bodies after it: G = I W, H = D^T W (angular), and e1 of
        // E p = [e1 p_ang + 2 p_lin x G_lin, 0], the derivative of D^T W along V.
        let mut g = SpatialVector::ZERO;
        let mut swept = Vector3::ZERO;
        let mut e1 = Matrix3::ZERO;
        for i in (0..n).rev() {
            let body = &work.body[i];
            let (alpha, beta) = (&work.virtual_velocity[i + 1].ang, &work.virtual_velocity[i + 1].lin);
            g += body.apply(&work.virtual_velocity[i + 1]);
            let ia = product(&body.rotational.full(), &skew(alpha));
            let bm = product(&skew(beta), &skew(&body.moment));
            let mut e = Matrix3::ZERO;
            for r in 0..3 {
                for c in 0..3 {
                    // -alpha I = (I alpha)' for symmetric I and skew alpha.
                    e.0[r][c] = ia.0[r][c] + ia.0[c][r];
                }
            }
            let e = e.minus(&skew(&body.rotational.times(alpha))).plus(&bm.plus(&bm));
            e1 = e1.plus(&e);
            let own = if i + 1 < n {
                Coriolis {
                    d1: first.coriolis[i].d1.minus(&first.coriolis[i + 1].d1),
                    momentum: first.coriolis[i].momentum - first.coriolis[i + 1].momentum,
                }
            } else {
                first.coriolis[i]
            };
            swept += own.apply_transposed(&work.virtual_velocity[i + 1]);

            let (s, psi, inertia) = (&work.axis[i], &work.psi[i], &work.composite[i]);
            let coriolis = &first.coriolis[i];
            // Derivatives of d(eta.r)/dq_i along (omega, psi'', psi) of an earlier joint ...
            let q_omega =
                s.cross_force(&work.force[i]) + inertia.apply(&first.psi_dd[i]) + coriolis.apply(&psi.ang);
            let q_psi_dd = s.cross_force(&g) + inertia.apply(&work.omega[i]);
            let q_psi = psi.cross_force(&g).twice()
                + SpatialVector::new(
                    s.ang.cross(&swept) + coriolis.apply_transposed(&work.omega[i]),
                    Vector3::ZERO,
                )
                + e_transposed(&e1, &g, &psi.ang);
            // ... of d(eta.r)/dqd_i ...
            let qd_omega = inertia.apply(psi).twice() + coriolis.apply(&s.ang);
            let qd_psi = s.cross_force(&g).twice() + e_transposed(&e1, &g, &s.ang);
            // ... and of d(eta.r)/dqdd_i.
            let qdd_omega = work.carried[i];
            let ci = self.order.coordinate(i);
            for j in 0..=i {
                let (s_j, psi_j, omega_j) = (&work.axis[j], &work.psi[j], &work.omega[j]);
                let cj = self.order.coordinate(j);
                let q_q = q_omega.dot(omega_j) + q_psi_dd.dot(&first.psi_dd[j]) + q_psi.dot(psi_j);
                h[ci * stride + cj] = q_q;
                h[cj * stride + ci] = q_q;
                let qd_qd = qd_psi.dot(s_j);
                h[(n + ci) * stride + n + cj] = qd_qd;
                h[(n + cj) * stride + n + ci] = qd_qd;
                let q_j_qd_i = qd_omega.dot(omega_j) + qd_psi.dot(psi_j);
                h[cj * stride + n + ci] = q_j_qd_i;
                h[(n + ci) * stride + cj] = q_j_qd_i;
                let q_j_qdd_i = qdd_omega.dot(omega_j);
                if ci < actuated {
                    h[cj * stride + 2 * n + ci] = q_j_qdd_i;
                    h[(2 * n + ci) * stride + cj] = q_j_qdd_i;
                } else {
                    work.q_qdd_u[ci - actuated][cj] = q_j_qdd_i;
                }
                if j < i {
                    let half = q_psi_dd.dot(psi_j);
                    let q_i_qd_j = (half + half) + q_psi.dot(s_j);
                    h[ci * stride + n + cj] = q_i_qd_j;
                    h[(n + cj) * stride + ci] = q_i_qd_j;
                    let q_i_qdd_j = q_psi_dd.dot(s_j);
                    if cj < actuated {
                        h[ci * stride + 2 * n + cj] = q_i_qdd_j;
                        h[(2 * n + cj) * stride + ci] = q_i_qdd_j;
                    } else {
                        work.q_qdd_u[cj - actuated][ci] = q_i_qdd_j;
                    }
                }
            }
        }
        // The path through qdd_U: q_qdd_U (dqdd_U/dz) and its transpose.
        for c in 0..unactuated {
            let row_u = &first.rows[(actuated + c) * stride..][..stride];
            for r in 0..n {
                let factor = work.q_qdd_u[c][r];
                let row = &mut h[r * stride..][..stride];
                for (h, z) in row.iter_mut().zip(row_u) {
                    *h += factor * *z;
                }
                for (column, z) in row_u.iter().enumerate().take(d.knot()) {
                    h[column * stride + r] += factor * *z;
                }
            }
        }
    }
}

/// E^T v, for v with angular part `v_ang`.
#[inline(always)]
fn e_transposed<T: Scalar>(e1: &Matrix3<T>, g: &SpatialVector<T>, v_ang: &Vector3<T>) -> SpatialVector<T> {
    let lin = g.lin.cross(v_ang);
    SpatialVector::new(e1.tr_times(v_ang), lin + lin)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cart with a pendulum, so that sizes are among those known to the compiler.
    const CART: &str = r#"<robot name="cart"><link name="base"/>
        <link name="cart"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
        <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="0.2"/>
            <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
        <joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
            <limit lower="-1" upper="1" velocity="2" effort="10"/></joint>
        <joint name="swing" type="continuous"><parent link="cart"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"#;

    #[test]
    fn sizes_known_to_the_compiler_and_wide_registers_change_no_bit() {
        for text in [CART, include_str!("../../config/systems/iiwa-pendulum/robot.urdf")] {
            let model = Model::from_urdf(text).expect("a chain");
            let sizes = model.sizes();
            let z: Vec<f64> = (0..sizes.knot()).map(|i| 0.7 - 0.3 * i as f64).collect();
            let (x, u) = z.split_at(sizes.state());
            let (w, mu) = ([0.4, -0.9], [0.3, 0.1, -0.2, 0.5, 0.8, -0.6, 0.7]);
            let [mut chosen, mut any] = [0; 2].map(|_| Linearization::new(sizes));
            let [mut chosen_h, mut any_h] = [0; 2].map(|_| vec![0.0; sizes.knot() * sizes.knot_row()]);
            let mut work = Workspace::default();
            model.linearize(x, u, &mut work, &mut chosen);
            model.hessian(&w, &mu, &chosen, &mut work, &mut chosen_h);
            model.linearize_with(sizes, x, u, &mut work, &mut any);
            model.hessian_with(sizes, &w, &mu, &any, &mut work, &mut any_h);
            assert_eq!(chosen.rows, any.rows);
            assert_eq!(chosen_h, any_h);
        }
    }
}
