//! Exact first and second derivatives of f (5) and of the motor torque (9), (11).
//!
//! Turning joint i carries bodies i..NQ rigidly along, which changes no scalar product among them; what
//! remains is that velocity and acceleration of the bodies *before* i do not turn. Relative to the rigid
//! motion they change by psi_i = V_{i-1} x S_i and psi''_i = A_{i-1} x S_i + V_{i-1} x psi_i. With this,
//! the derivatives of r = M qdd + C qd + g become scalar products of one vector per joint (first
//! derivatives as in Singh, Russell, Wensing, *Efficient Analytical Derivatives of Rigid-Body Dynamics using
//! Spatial Vector Algebra*, IEEE RA-L 2022), and so do the second derivatives of eta . r for a constant eta,
//! in which W = sum S_j eta_j is a virtual velocity and omega_i = W_{i-1} x S_i its counterpart of psi_i.
//!
//! The unactuated acceleration is eliminated by an adjoint: with nu = -M_UU^-1 (w + M_UA mu) the function
//! w . qdd_U + mu . tau equals w . a_U + [mu, nu] . r(q, qd, [u, a_U]) for every a_U near qdd_U to first order.

use crate::dynamics::{solve_unactuated, state_derivative, unactuated_block};
use crate::spatial::{SpatialVector, skew};
use crate::{
    ActuatedVector, HybridDynamics, JointMatrix, JointParts, JointVector, Model, N_UNACTUATED, NQ, NU, NX,
    NZ, State, StateParts, UnactuatedVector, Workspace,
};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Symmetric matrix of the second derivatives with respect to z = [q, qd, u].
pub type Hessian = SMatrix<f64, NZ, NZ>;

/// First derivatives of the hybrid dynamics (3a), (3b) at one state and input.
#[derive(Clone, Debug)]
pub struct Derivatives {
    /// qdd_U and tau_A at the point of the derivatives.
    pub value: HybridDynamics,
    /// d qdd_U / dx: the only rows of A = df/dx (19) that are not constant.
    pub qdd_u_x: SMatrix<f64, N_UNACTUATED, NX>,
    /// d qdd_U / du: the only rows of B = df/du (19) that are not constant.
    pub qdd_u_u: SMatrix<f64, N_UNACTUATED, NU>,
    /// d tau_A / dx.
    pub tau_x: SMatrix<f64, NU, NX>,
    /// d tau_A / du = M~ (10), kg m^2.
    pub tau_u: SMatrix<f64, NU, NU>,
}

impl Derivatives {
    /// A = df/dx (19), `[[0, I], [0, 0], [d qdd_U / dx]]`.
    pub fn a(&self) -> SMatrix<f64, NX, NX> {
        let mut a = SMatrix::<f64, NX, NX>::zeros();
        for i in 0..NQ {
            a[(i, NQ + i)] = 1.0;
        }
        a.fixed_rows_mut::<N_UNACTUATED>(NX - N_UNACTUATED).copy_from(&self.qdd_u_x);
        a
    }

    /// B = df/du (19), `[[0], [I], [d qdd_U / du]]`.
    pub fn b(&self) -> SMatrix<f64, NX, NU> {
        let mut b = SMatrix::<f64, NX, NU>::zeros();
        for i in 0..NU {
            b[(NQ + i, i)] = 1.0;
        }
        b.fixed_rows_mut::<N_UNACTUATED>(NX - N_UNACTUATED).copy_from(&self.qdd_u_u);
        b
    }

    /// f(x, u) (5) at the point of the derivatives, rad/s and rad/s^2.
    pub fn f(&self, x: &State, u: &ActuatedVector) -> State {
        state_derivative(x, u, &self.value.qdd_u)
    }
}

impl Model {
    /// First derivatives of the hybrid dynamics at (x, u), and the state of `work` that [`Self::hessian`] needs.
    pub fn derivatives(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> Derivatives {
        self.derivatives_at(&x.q(), &x.qd(), u, work)
    }

    /// First derivatives of the hybrid dynamics at qd = 0, whose torque M~ u + g~ (11) does not depend on qd.
    pub fn derivatives_without_coriolis(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> Derivatives {
        let mut d = self.derivatives_at(&x.q(), &JointVector::zeros(), u, work);
        d.qdd_u_x.fixed_columns_mut::<NQ>(NQ).fill(0.0);
        d.tau_x.fixed_columns_mut::<NQ>(NQ).fill(0.0);
        d
    }

    fn derivatives_at(
        &self,
        q: &JointVector,
        qd: &JointVector,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> Derivatives {
        let value = self.hybrid_dynamics_at(q, qd, u, work);
        let mut qdd = JointVector::zeros();
        qdd.actuated_mut().copy_from(u);
        qdd.unactuated_mut().copy_from(&value.qdd_u);
        self.update_accelerations(qd, &qdd, work);

        let m = work.mass_matrix();
        let m_au = m.fixed_view::<NU, N_UNACTUATED>(0, NU);
        let m_ua = m.fixed_view::<N_UNACTUATED, NU>(NU, 0).into_owned();
        let m_uu = unactuated_block(&m.fixed_columns::<N_UNACTUATED>(NU).into());
        let (r_q, r_qd) = work.inverse_dynamics_derivatives();
        let mut r_x = SMatrix::<f64, NQ, NX>::zeros();
        r_x.fixed_columns_mut::<NQ>(0).copy_from(&r_q);
        r_x.fixed_columns_mut::<NQ>(NQ).copy_from(&r_qd);

        let qdd_u_x = -solve_unactuated(&m_uu, &r_x.fixed_rows::<N_UNACTUATED>(NU).into());
        let qdd_u_u = -solve_unactuated(&m_uu, &m_ua);
        Derivatives {
            value,
            qdd_u_x,
            qdd_u_u,
            tau_x: r_x.fixed_rows::<NU>(0) + m_au * qdd_u_x,
            tau_u: m.fixed_view::<NU, NU>(0, 0) + SMatrix::from_diagonal(&self.rotors) + m_au * qdd_u_u,
        }
    }

    /// Second derivatives of `w` . qdd_U + `mu` . tau with respect to z = [q, qd, u], symmetric. `first` and
    /// `work` are the result and the scratch memory of the last call of [`Self::derivatives`].
    pub fn hessian(
        &self,
        w: &UnactuatedVector,
        mu: &ActuatedVector,
        first: &Derivatives,
        work: &Workspace,
    ) -> Hessian {
        let columns = work.unactuated_columns();
        let m_ua_mu = columns.fixed_rows::<NU>(0).transpose() * mu;
        let nu = -solve_unactuated(&unactuated_block(&columns), &(w + m_ua_mu));
        let mut eta = JointVector::zeros();
        eta.actuated_mut().copy_from(mu);
        eta.unactuated_mut().copy_from(&nu);

        let second = work.second_derivatives(&eta);
        let mut h = Hessian::zeros();
        h.fixed_view_mut::<NQ, NQ>(0, 0).copy_from(&second.q_q);
        h.fixed_view_mut::<NQ, NQ>(0, NQ).copy_from(&second.q_qd);
        h.fixed_view_mut::<NQ, NQ>(NQ, 0).copy_from(&second.q_qd.transpose());
        h.fixed_view_mut::<NQ, NQ>(NQ, NQ).copy_from(&second.qd_qd);
        let q_u = second.q_qdd.fixed_columns::<NU>(0);
        h.fixed_view_mut::<NQ, NU>(0, NX).copy_from(&q_u);
        h.fixed_view_mut::<NU, NQ>(NX, 0).copy_from(&q_u.transpose());
        // The path through a_U: q_qdd_U (d qdd_U / dz) and its transpose.
        let q_a = second.q_qdd.fixed_columns::<N_UNACTUATED>(NU);
        for row in 0..NQ {
            for col in 0..NZ {
                let mut sum = 0.0;
                for j in 0..N_UNACTUATED {
                    let a_z = if col < NX { first.qdd_u_x[(j, col)] } else { first.qdd_u_u[(j, col - NX)] };
                    sum += q_a[(row, j)] * a_z;
                }
                h[(row, col)] += sum;
                h[(col, row)] += sum;
            }
        }
        h
    }

    /// Second derivatives of `mu` . (M~ u + g~) (11) with respect to z = [q, qd, u]. `first` and `work` are the result and the
    /// scratch memory of the last call of [`Self::derivatives_without_coriolis`].
    pub fn hessian_without_coriolis(
        &self,
        mu: &ActuatedVector,
        first: &Derivatives,
        work: &Workspace,
    ) -> Hessian {
        let mut h = self.hessian(&UnactuatedVector::zeros(), mu, first, work);
        for i in NQ..NX {
            h.row_mut(i).fill(0.0);
            h.column_mut(i).fill(0.0);
        }
        h
    }
}

/// Second derivatives of eta . r(q, qd, qdd); those with respect to (qd, qdd) and (qdd, qdd) vanish.
struct SecondDerivatives {
    q_q: JointMatrix,
    q_qd: JointMatrix,
    qd_qd: JointMatrix,
    q_qdd: JointMatrix,
}

/// Velocity-product terms of the bodies i..NQ together: D p = [d1 p_ang, 2 p_ang x momentum] with
/// D_b p = I (p x V) + p x* I V + V x* I p, which does not depend on the linear part of p.
#[derive(Clone, Copy)]
struct Coriolis {
    d1: Matrix3<f64>,
    momentum: Vector3<f64>,
}

impl Coriolis {
    fn apply(&self, p_ang: &Vector3<f64>) -> SpatialVector {
        SpatialVector::new(self.d1 * p_ang, 2.0 * p_ang.cross(&self.momentum))
    }

    /// The angular part of D^T m (the linear part vanishes).
    fn apply_transposed(&self, m: &SpatialVector) -> Vector3<f64> {
        self.d1.tr_mul(&m.ang) + 2.0 * self.momentum.cross(&m.lin)
    }
}

impl Workspace {
    /// The velocity-product terms for every i.
    fn coriolis(&self) -> [Coriolis; NQ] {
        let mut sum = Coriolis { d1: Matrix3::zeros(), momentum: Vector3::zeros() };
        let mut all = [sum; NQ];
        for i in (0..NQ).rev() {
            let (v, body) = (&self.velocity[i + 1], &self.body[i]);
            let w = skew(&v.ang);
            sum.d1 += w * body.rotational
                - body.rotational * w
                - skew(&(body.rotational * v.ang))
                - 2.0 * skew(&body.moment) * skew(&v.lin);
            sum.momentum += body.apply(v).lin;
            all[i] = sum;
        }
        all
    }

    /// psi''_i = A_{i-1} x S_i + V_{i-1} x psi_i
    fn psi_dd(&self, i: usize) -> SpatialVector {
        self.acceleration[i].cross_motion(&self.axis[i]) + self.velocity[i].cross_motion(&self.psi[i])
    }

    /// dr/dq and dr/dqd of r = M qdd + C qd + g at the state of the last [`Model::inverse_dynamics`], N m per
    /// rad and per rad/s.
    pub(crate) fn inverse_dynamics_derivatives(&self) -> (JointMatrix, JointMatrix) {
        let coriolis = self.coriolis();
        let carried: [SpatialVector; NQ] = std::array::from_fn(|k| self.composite_axis(k));
        let swept: [Vector3<f64>; NQ] = std::array::from_fn(|k| coriolis[k].apply_transposed(&self.axis[k]));
        let (mut r_q, mut r_qd) = (JointMatrix::zeros(), JointMatrix::zeros());
        for i in 0..NQ {
            let (s, psi, psi_dd) = (&self.axis[i], &self.psi[i], self.psi_dd(i));
            let on_q = s.cross_force(&self.force[i])
                + self.composite[i].apply(&psi_dd)
                + coriolis[i].apply(&psi.ang);
            let on_qd = self.composite[i].apply(psi) * 2.0 + coriolis[i].apply(&s.ang);
            for k in 0..i {
                r_q[(k, i)] = self.axis[k].dot(&on_q);
                r_qd[(k, i)] = self.axis[k].dot(&on_qd);
            }
            for k in i..NQ {
                r_q[(k, i)] = psi_dd.dot(&carried[k]) + psi.ang.dot(&swept[k]);
                r_qd[(k, i)] = s.ang.dot(&swept[k]) + 2.0 * psi.dot(&carried[k]);
            }
        }
        (r_q, r_qd)
    }

    /// Second derivatives of eta . r at the state of the last [`Model::derivatives`].
    fn second_derivatives(&self, eta: &JointVector) -> SecondDerivatives {
        let coriolis = self.coriolis();
        let psi_dd: [SpatialVector; NQ] = std::array::from_fn(|i| self.psi_dd(i));
        // W_{i-1}, omega_i = W_{i-1} x S_i
        let mut w = [SpatialVector::ZERO; NQ + 1];
        let mut omega = [SpatialVector::ZERO; NQ];
        for i in 0..NQ {
            omega[i] = w[i].cross_motion(&self.axis[i]);
            w[i + 1] = w[i] + self.axis[i] * eta[i];
        }
        // Sums over bodies i..NQ: G = I W, H = D^T W (angular), and e1 of
        // E p = [e1 p_ang + 2 p_lin x G_lin, 0], the derivative of D^T W along V.
        let mut g = SpatialVector::ZERO;
        let mut h = Vector3::zeros();
        let mut e1 = Matrix3::zeros();
        let mut second = SecondDerivatives {
            q_q: JointMatrix::zeros(),
            q_qd: JointMatrix::zeros(),
            qd_qd: JointMatrix::zeros(),
            q_qdd: JointMatrix::zeros(),
        };
        for i in (0..NQ).rev() {
            let body = &self.body[i];
            let (alpha, beta) = (&w[i + 1].ang, &w[i + 1].lin);
            let alpha_skew = skew(alpha);
            g += body.apply(&w[i + 1]);
            e1 += body.rotational * alpha_skew
                - alpha_skew * body.rotational
                - skew(&(body.rotational * alpha))
                + 2.0 * skew(beta) * skew(&body.moment);
            let own = Coriolis {
                d1: coriolis[i].d1 - if i + 1 < NQ { coriolis[i + 1].d1 } else { Matrix3::zeros() },
                momentum: coriolis[i].momentum
                    - if i + 1 < NQ { coriolis[i + 1].momentum } else { Vector3::zeros() },
            };
            h += own.apply_transposed(&w[i + 1]);

            // E^T v, for v with angular part v_ang.
            let e_transposed =
                |v_ang: &Vector3<f64>| SpatialVector::new(e1.tr_mul(v_ang), 2.0 * g.lin.cross(v_ang));
            let (s, psi, inertia, d) = (&self.axis[i], &self.psi[i], &self.composite[i], &coriolis[i]);
            // Derivatives of d(eta.r)/dq_i along (omega, psi'', psi) of an earlier joint ...
            let q_omega = s.cross_force(&self.force[i]) + inertia.apply(&psi_dd[i]) + d.apply(&psi.ang);
            let q_psi_dd = s.cross_force(&g) + inertia.apply(&omega[i]);
            let q_psi = psi.cross_force(&g) * 2.0
                + SpatialVector::new(s.ang.cross(&h) + d.apply_transposed(&omega[i]), Vector3::zeros())
                + e_transposed(&psi.ang);
            // ... of d(eta.r)/dqd_i ...
            let qd_omega = inertia.apply(psi) * 2.0 + d.apply(&s.ang);
            let qd_psi = s.cross_force(&g) * 2.0 + e_transposed(&s.ang);
            // ... and of d(eta.r)/dqdd_i.
            let qdd_omega = inertia.apply(s);
            for j in 0..=i {
                let (s_j, psi_j, omega_j) = (&self.axis[j], &self.psi[j], &omega[j]);
                let q_q = q_omega.dot(omega_j) + q_psi_dd.dot(&psi_dd[j]) + q_psi.dot(psi_j);
                (second.q_q[(i, j)], second.q_q[(j, i)]) = (q_q, q_q);
                let qd_qd = qd_psi.dot(s_j);
                (second.qd_qd[(i, j)], second.qd_qd[(j, i)]) = (qd_qd, qd_qd);
                second.q_qd[(j, i)] = qd_omega.dot(omega_j) + qd_psi.dot(psi_j);
                second.q_qdd[(j, i)] = qdd_omega.dot(omega_j);
                if j < i {
                    second.q_qd[(i, j)] = 2.0 * q_psi_dd.dot(psi_j) + q_psi.dot(s_j);
                    second.q_qdd[(i, j)] = q_psi_dd.dot(s_j);
                }
            }
        }
        second
    }
}
