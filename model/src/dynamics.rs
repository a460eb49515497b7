//! Equations of motion (1)-(5), (9), (11), (24), by recursions over the chain in the world frame.

use crate::positive;
use crate::spatial::{SpatialInertia, SpatialVector};
use crate::{
    ActuatedMatrix, ActuatedVector, JointMatrix, JointParts, JointVector, Model, N_UNACTUATED, NQ, NU, State,
    StateParts, UnactuatedVector,
};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// M_UU, the mass matrix of the unactuated joints.
type UnactuatedMatrix = SMatrix<f64, N_UNACTUATED, N_UNACTUATED>;

/// Scratch memory of the recursions over the chain, owned by the caller. It holds the quantities of the state that was
/// evaluated last.
///
/// Index i of a joint quantity is joint i; index i of `velocity` and `acceleration` is the body *before* joint i, so that
/// index 0 is the base.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// S_i, axis of joint i.
    pub(crate) axis: [SpatialVector; NQ],
    /// I_i, inertia of body i.
    pub(crate) body: [SpatialInertia; NQ],
    /// I^C_i, inertia of the bodies i..NQ together.
    pub(crate) composite: [SpatialInertia; NQ],
    /// V_i, velocity.
    pub(crate) velocity: [SpatialVector; NQ + 1],
    /// A_i, acceleration, with gravity as an upward acceleration of the base.
    pub(crate) acceleration: [SpatialVector; NQ + 1],
    /// psi_i = V_{i-1} x S_i
    pub(crate) psi: [SpatialVector; NQ],
    /// F_i, force that the bodies i..NQ need for their motion.
    pub(crate) force: [SpatialVector; NQ],
}

impl Default for Workspace {
    fn default() -> Self {
        let none = SpatialInertia { mass: 0.0, moment: Vector3::zeros(), rotational: Matrix3::zeros() };
        Self {
            axis: [SpatialVector::ZERO; NQ],
            body: [none; NQ],
            composite: [none; NQ],
            velocity: [SpatialVector::ZERO; NQ + 1],
            acceleration: [SpatialVector::ZERO; NQ + 1],
            psi: [SpatialVector::ZERO; NQ],
            force: [SpatialVector::ZERO; NQ],
        }
    }
}

impl Workspace {
    /// I^C_i S_i: its product with S_j, j <= i, is the entry M_ji.
    #[inline]
    pub(crate) fn composite_axis(&self, i: usize) -> SpatialVector {
        self.composite[i].apply(&self.axis[i])
    }

    /// M(q) of the bodies, without the rotors, kg m^2.
    pub(crate) fn mass_matrix(&self) -> JointMatrix {
        let mut m = JointMatrix::zeros();
        for j in 0..NQ {
            let carried = self.composite_axis(j);
            for i in 0..=j {
                m[(i, j)] = self.axis[i].dot(&carried);
                m[(j, i)] = m[(i, j)];
            }
        }
        m
    }

    /// The columns [M_AU; M_UU] of M(q) (2) that belong to the unactuated joints, kg m^2, at the q that was evaluated last.
    pub fn unactuated_columns(&self) -> SMatrix<f64, NQ, N_UNACTUATED> {
        let mut m = SMatrix::<f64, NQ, N_UNACTUATED>::zeros();
        for c in 0..N_UNACTUATED {
            let j = NU + c;
            let carried = self.composite_axis(j);
            for i in 0..=j {
                m[(i, c)] = self.axis[i].dot(&carried);
            }
            for other in 0..c {
                m[(j, other)] = m[(NU + other, c)];
            }
        }
        m
    }
}

/// The unknowns of the hybrid dynamics, in which the actuated joints have a given acceleration u = qdd_A and the unactuated
/// ones have no torque (Featherstone, *Rigid Body Dynamics Algorithms*, chapter 9).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HybridDynamics {
    /// qdd_U (3a), rad/s^2.
    pub qdd_u: UnactuatedVector,
    /// tau_A (3b), (9), N m.
    pub tau: ActuatedVector,
}

impl Model {
    /// Joint torques M(q) qdd + C(q, qd) qd + g(q), N m: the left-hand side of (1), for `q` in rad, `qd` in rad/s and `qdd`
    /// in rad/s^2.
    pub fn inverse_dynamics(
        &self,
        q: &JointVector,
        qd: &JointVector,
        qdd: &JointVector,
        work: &mut Workspace,
    ) -> JointVector {
        self.update_positions(q, work);
        self.update_velocities(qd, work);
        self.update_accelerations(qd, qdd, work);
        let mut force = generalized_force(work);
        for i in 0..NU {
            force[i] += self.rotors[i] * qdd[i];
        }
        force
    }

    /// Mass matrix M(q) (1), kg m^2, symmetric and positive definite, for `q` in rad.
    pub fn mass_matrix(&self, q: &JointVector, work: &mut Workspace) -> JointMatrix {
        self.update_positions(q, work);
        self.with_rotor_inertia(work.mass_matrix())
    }

    /// The mass matrix of bodies and rotors, for that of the bodies.
    fn with_rotor_inertia(&self, mut bodies: JointMatrix) -> JointMatrix {
        for i in 0..NU {
            bodies[(i, i)] += self.rotors[i];
        }
        bodies
    }

    /// Joint torques C(q, qd) qd + g(q) (1), N m: [`Self::inverse_dynamics`] with qdd = 0.
    pub fn nonlinear_effects(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> JointVector {
        self.inverse_dynamics(q, qd, &JointVector::zeros(), work)
    }

    /// Gravity vector g(q) (1), N m: [`Self::nonlinear_effects`] with qd = 0.
    pub fn gravity_torque(&self, q: &JointVector, work: &mut Workspace) -> JointVector {
        self.nonlinear_effects(q, &JointVector::zeros(), work)
    }

    /// The hybrid dynamics (3a), (3b): acceleration of the unactuated joints and motor torque at the state `x` (rad, rad/s)
    /// for the input `u` (rad/s^2).
    pub fn hybrid_dynamics(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> HybridDynamics {
        self.hybrid_dynamics_at(&x.q(), &x.qd(), u, work)
    }

    /// Motor torque tau_A = M~ u + C~ qd + g~ (9), N m; with u = u_d + K dx the torque law (24).
    pub fn torque(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> ActuatedVector {
        self.hybrid_dynamics(x, u, work).tau
    }

    /// Reduced mass matrix M~ (10), kg m^2, symmetric and positive definite, at the q that was evaluated last with `work`.
    pub fn reduced_inertia(&self, work: &Workspace) -> ActuatedMatrix {
        let mass = self.with_rotor_inertia(work.mass_matrix());
        let columns = work.unactuated_columns();
        let m_au = columns.fixed_rows::<NU>(0);
        mass.fixed_view::<NU, NU>(0, 0)
            - m_au * solve_unactuated(&unactuated_block(&columns), &m_au.transpose())
    }

    /// Torque M~ a (10), N m, of the accelerations `a` (rad/s^2), at the q that was evaluated last with `work`.
    pub fn reduced_inertia_times(&self, a: &ActuatedVector, work: &Workspace) -> ActuatedVector {
        let mut qdd = JointVector::zeros();
        qdd.actuated_mut().copy_from(a);
        reduce(&(self.with_rotor_inertia(work.mass_matrix()) * qdd), work).tau
    }

    /// Motor torque without its Coriolis part M~ u + g~ (11), N m: [`Self::torque`] at qd = 0.
    pub fn torque_without_coriolis(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> ActuatedVector {
        self.hybrid_dynamics_at(&x.q(), &JointVector::zeros(), u, work).tau
    }

    /// Coriolis part of the motor torque C~(q, qd) qd = C_A - M_AU M_U^-1 C_U with [C_A; C_U] = C(q, qd) qd (10), N m, for `q`
    /// in rad and `qd` in rad/s: the difference of [`Self::torque`] and [`Self::torque_without_coriolis`] at any u.
    pub fn coriolis_torque(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> ActuatedVector {
        self.update_positions(q, work);
        self.update_velocities(qd, work);
        // Without gravity and without qdd, C qd is what remains of (1).
        accelerate_chain(SpatialVector::ZERO, qd, &JointVector::zeros(), work);
        reduce(&generalized_force(work), work).tau
    }

    /// Dynamics f(x, u) (4), (5): the time derivative [qd, u, qdd_U] of the state, rad/s and rad/s^2.
    pub fn f(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> State {
        state_derivative(x, u, &self.hybrid_dynamics(x, u, work).qdd_u)
    }

    /// f(x, u) (5) and the motor torque (9), N m, of one evaluation.
    pub fn derivative_and_torque(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> (State, ActuatedVector) {
        let HybridDynamics { qdd_u, tau } = self.hybrid_dynamics(x, u, work);
        (state_derivative(x, u, &qdd_u), tau)
    }

    /// Forward dynamics: accelerations qdd = M^-1 (tau - C qd - g), rad/s^2, of all joints under the joint torques `tau` (N m,
    /// including friction). `None` if M is not positive definite, which happens only for a `q` that is not finite.
    pub fn forward_dynamics(
        &self,
        q: &JointVector,
        qd: &JointVector,
        tau: &JointVector,
        work: &mut Workspace,
    ) -> Option<JointVector> {
        let bias = self.nonlinear_effects(q, qd, work);
        positive::solve(&self.with_rotor_inertia(work.mass_matrix()), &(tau - bias))
    }

    /// Kinetic plus potential energy of the bodies and the rotors, J.
    pub fn energy(&self, x: &State, work: &mut Workspace) -> f64 {
        let (q, qd) = (x.q(), x.qd());
        0.5 * qd.dot(&(self.mass_matrix(&q, work) * qd)) + self.potential_energy(&q)
    }

    /// [`Self::hybrid_dynamics`] of a state given as `q` and `qd`.
    pub(crate) fn hybrid_dynamics_at(
        &self,
        q: &JointVector,
        qd: &JointVector,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> HybridDynamics {
        let mut qdd = JointVector::zeros();
        qdd.actuated_mut().copy_from(u);
        reduce(&self.inverse_dynamics(q, qd, &qdd, work), work)
    }

    /// Computes joint axes and inertias at q.
    pub(crate) fn update_positions(&self, q: &JointVector, work: &mut Workspace) {
        let mut parent = self.base;
        for (i, joint) in self.joints.iter().enumerate() {
            parent = joint.frame(&parent, q[i]);
            let axis = parent.rotation * joint.axis;
            work.axis[i] = SpatialVector::new(axis, parent.origin.cross(&axis));
            work.body[i] = joint.world_inertia(&parent);
        }
        work.composite[NQ - 1] = work.body[NQ - 1];
        for i in (0..NQ - 1).rev() {
            work.composite[i] = work.composite[i + 1] + work.body[i];
        }
    }

    /// Computes velocities at qd, after [`Self::update_positions`].
    pub(crate) fn update_velocities(&self, qd: &JointVector, work: &mut Workspace) {
        work.velocity[0] = SpatialVector::ZERO;
        for i in 0..NQ {
            work.psi[i] = work.velocity[i].cross_motion(&work.axis[i]);
            work.velocity[i + 1] = work.velocity[i] + work.axis[i] * qd[i];
        }
    }

    /// Computes accelerations and forces at qdd, after [`Self::update_velocities`].
    pub(crate) fn update_accelerations(&self, qd: &JointVector, qdd: &JointVector, work: &mut Workspace) {
        accelerate_chain(SpatialVector::new(Vector3::zeros(), -self.gravity), qd, qdd, work);
    }
}

/// Computes accelerations and forces at qdd of a chain whose base accelerates with `base`, after
/// [`Model::update_velocities`].
fn accelerate_chain(base: SpatialVector, qd: &JointVector, qdd: &JointVector, work: &mut Workspace) {
    work.acceleration[0] = base;
    for i in 0..NQ {
        work.acceleration[i + 1] = work.acceleration[i] + work.axis[i] * qdd[i] + work.psi[i] * qd[i];
    }
    let mut carried = SpatialVector::ZERO;
    for i in (0..NQ).rev() {
        let (v, body) = (&work.velocity[i + 1], &work.body[i]);
        carried += body.apply(&work.acceleration[i + 1]) + v.cross_force(&body.apply(v));
        work.force[i] = carried;
    }
}

/// The hybrid dynamics (3a), (3b), for the joint torques `r` (N m) that the motion with qdd_U = 0 would need: the unactuated
/// joints accelerate so that their torques vanish.
fn reduce(r: &JointVector, work: &Workspace) -> HybridDynamics {
    let columns = work.unactuated_columns();
    let qdd_u = -solve_unactuated(&unactuated_block(&columns), &r.unactuated());
    let tau = r.actuated() + columns.fixed_rows::<NU>(0) * qdd_u;
    HybridDynamics { qdd_u, tau }
}

/// Joint torques S_i . F_i, N m.
fn generalized_force(work: &Workspace) -> JointVector {
    JointVector::from_fn(|i, _| work.axis[i].dot(&work.force[i]))
}

/// The time derivative [qd, u, qdd_U] of the state (4).
pub(crate) fn state_derivative(x: &State, u: &ActuatedVector, qdd_u: &UnactuatedVector) -> State {
    let mut f = State::zeros();
    f.q_mut().copy_from(&x.qd());
    f.qd_a_mut().copy_from(u);
    f.qd_u_mut().copy_from(qdd_u);
    f
}

/// M_UU out of [M_AU; M_UU].
pub(crate) fn unactuated_block(columns: &SMatrix<f64, NQ, N_UNACTUATED>) -> UnactuatedMatrix {
    columns.fixed_view::<N_UNACTUATED, N_UNACTUATED>(NU, 0).into()
}

/// M_UU^-1 r by Gaussian elimination: M_UU is positive definite, so that no pivot vanishes.
pub(crate) fn solve_unactuated<const C: usize>(
    m_u: &UnactuatedMatrix,
    r: &SMatrix<f64, N_UNACTUATED, C>,
) -> SMatrix<f64, N_UNACTUATED, C> {
    let (mut m, mut x) = (*m_u, *r);
    for p in 0..N_UNACTUATED {
        for row in p + 1..N_UNACTUATED {
            let factor = m[(row, p)] / m[(p, p)];
            for c in p..N_UNACTUATED {
                m[(row, c)] -= factor * m[(p, c)];
            }
            for c in 0..C {
                x[(row, c)] -= factor * x[(p, c)];
            }
        }
    }
    for p in (0..N_UNACTUATED).rev() {
        for c in 0..C {
            let mut sum = x[(p, c)];
            for k in p + 1..N_UNACTUATED {
                sum -= m[(p, k)] * x[(k, c)];
            }
            x[(p, c)] = sum / m[(p, p)];
        }
    }
    x
}
