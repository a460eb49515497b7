//! Equations of motion (1)-(5), (9), (11), (24), by recursions over the chain in the world frame.

use crate::positive;
use crate::spatial::{Inertia, Spatial};
use crate::{
    ActuatedMatrix, ActuatedVector, JointMatrix, JointVector, Model, N_UNACTUATED, NQ, NU, NX, State,
    UnactuatedVector, position, velocity,
};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// M_UU, the mass matrix of the unactuated joints.
type UnactuatedMatrix = SMatrix<f64, N_UNACTUATED, N_UNACTUATED>;

/// Scratch memory of the recursions, owned by the caller; holds the quantities of the state last evaluated.
///
/// Index i of a joint quantity is joint i; index i of `velocity` and `acceleration` is the body *before*
/// joint i, so that index 0 is the base.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// S_i: joint axis.
    pub(crate) axis: [Spatial; NQ],
    pub(crate) body: [Inertia; NQ],
    /// Inertia of bodies i..NQ.
    pub(crate) composite: [Inertia; NQ],
    /// V
    pub(crate) velocity: [Spatial; NQ + 1],
    /// A, with gravity as an upward acceleration of the base.
    pub(crate) acceleration: [Spatial; NQ + 1],
    /// psi_i = V_{i-1} x S_i
    pub(crate) psi: [Spatial; NQ],
    /// F_i: force that bodies i..NQ need.
    pub(crate) force: [Spatial; NQ],
}

impl Default for Workspace {
    fn default() -> Self {
        let none = Inertia { mass: 0.0, moment: Vector3::zeros(), rotational: Matrix3::zeros() };
        Self {
            axis: [Spatial::ZERO; NQ],
            body: [none; NQ],
            composite: [none; NQ],
            velocity: [Spatial::ZERO; NQ + 1],
            acceleration: [Spatial::ZERO; NQ + 1],
            psi: [Spatial::ZERO; NQ],
            force: [Spatial::ZERO; NQ],
        }
    }
}

impl Workspace {
    /// I^C_i S_i: its product with S_j, j <= i, is the entry M_ji.
    #[inline]
    pub(crate) fn composite_axis(&self, i: usize) -> Spatial {
        self.composite[i].apply(&self.axis[i])
    }

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

    /// Columns of M(q) that belong to the unactuated joints, [M_AU; M_UU], kg m^2, at the q of the last evaluation.
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

/// What the input u = qdd_A causes at a state: (3a) and (3b).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accelerations {
    /// qdd_U, rad/s^2 (3a).
    pub qdd_u: UnactuatedVector,
    /// tau_A, N m (3b), (9).
    pub tau: ActuatedVector,
}

impl Model {
    /// M(q) qdd + C(q, qd) qd + g(q), N m: the left-hand side of (1). `qdd` in rad/s^2.
    pub fn inverse_dynamics(
        &self,
        q: &JointVector,
        qd: &JointVector,
        qdd: &JointVector,
        work: &mut Workspace,
    ) -> JointVector {
        self.place(q, work);
        self.move_with(qd, work);
        self.accelerate_with(qd, qdd, work);
        let mut force = generalized_force(work);
        for i in 0..NU {
            force[i] += self.rotors[i] * qdd[i];
        }
        force
    }

    /// M(q), kg m^2 (1): symmetric, positive definite.
    pub fn mass_matrix(&self, q: &JointVector, work: &mut Workspace) -> JointMatrix {
        self.place(q, work);
        self.with_rotor_inertia(work.mass_matrix())
    }

    /// The mass matrix of bodies and rotors, given that of the bodies.
    fn with_rotor_inertia(&self, mut bodies: JointMatrix) -> JointMatrix {
        for i in 0..NU {
            bodies[(i, i)] += self.rotors[i];
        }
        bodies
    }

    /// C(q, qd) qd + g(q), N m (1); equal to [`Self::inverse_dynamics`] with qdd = 0.
    pub fn nonlinear_effects(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> JointVector {
        self.inverse_dynamics(q, qd, &JointVector::zeros(), work)
    }

    /// g(q), N m (1); equal to [`Self::nonlinear_effects`] with qd = 0.
    pub fn gravity_torque(&self, q: &JointVector, work: &mut Workspace) -> JointVector {
        self.nonlinear_effects(q, &JointVector::zeros(), work)
    }

    /// (3a) and (3b): acceleration of the unactuated joints and motor torque for the input `u` (rad/s^2).
    pub fn accelerations(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> Accelerations {
        self.accelerations_at(&position(x), &velocity(x), u, work)
    }

    /// M~ u + C~ qd + g~ (9), N m; with u = u_d + K dx the torque law (24).
    pub fn torque(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> ActuatedVector {
        self.accelerations(x, u, work).tau
    }

    /// M~ (10), kg m^2, symmetric and positive definite, at the q of the last evaluation with `work`.
    pub fn reduced_inertia(&self, work: &Workspace) -> ActuatedMatrix {
        let mass = self.with_rotor_inertia(work.mass_matrix());
        let columns = work.unactuated_columns();
        let m_au = columns.fixed_rows::<NU>(0);
        mass.fixed_view::<NU, NU>(0, 0)
            - m_au * solve_unactuated(&unactuated_block(&columns), &m_au.transpose())
    }

    /// M~ a (10), N m, for `a` in rad/s^2, at the q of the last evaluation with `work`.
    pub fn reduced_inertia_times(&self, a: &ActuatedVector, work: &Workspace) -> ActuatedVector {
        let mut carried = JointVector::zeros();
        carried.fixed_rows_mut::<NU>(0).copy_from(a);
        reduce(&(self.with_rotor_inertia(work.mass_matrix()) * carried), work).tau
    }

    /// M~ u + g~ (11), N m: the torque without its Coriolis part; equal to [`Self::torque`] at qd = 0.
    pub fn torque_without_coriolis(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> ActuatedVector {
        self.accelerations_at(&position(x), &JointVector::zeros(), u, work).tau
    }

    /// C~(q, qd) qd = C_A - M_AU M_U^-1 C_U with [C_A; C_U] = C(q, qd) qd (10), N m, q in rad, qd in rad/s; equal
    /// to the difference of [`Self::torque`] and [`Self::torque_without_coriolis`] at any u, at the cost of one.
    pub fn coriolis_torque(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> ActuatedVector {
        self.place(q, work);
        self.move_with(qd, work);
        // Without gravity and without qdd, C qd is what remains of (1).
        accelerate(Spatial::ZERO, qd, &JointVector::zeros(), work);
        reduce(&generalized_force(work), work).tau
    }

    /// f(x, u) (4), (5): d/dt x = [qd, u, qdd_U] (rad/s, rad/s^2).
    pub fn f(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> State {
        state_derivative(x, u, &self.accelerations(x, u, work).qdd_u)
    }

    /// f(x, u) and the torque (9) of the same evaluation.
    pub fn derivative_and_torque(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> (State, ActuatedVector) {
        let a = self.accelerations(x, u, work);
        (state_derivative(x, u, &a.qdd_u), a.tau)
    }

    /// qdd = M^-1 (tau - C qd - g), rad/s^2, of the whole chain under the torque `tau` (N m, one per joint,
    /// friction of the unactuated joints included); `None` if M is not positive definite (corrupt q).
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

    /// Kinetic plus potential energy, J.
    pub fn energy(&self, x: &State, work: &mut Workspace) -> f64 {
        let (q, qd) = (position(x), velocity(x));
        0.5 * qd.dot(&(self.mass_matrix(&q, work) * qd)) + self.potential_energy(&q)
    }

    pub(crate) fn accelerations_at(
        &self,
        q: &JointVector,
        qd: &JointVector,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> Accelerations {
        let mut qdd = JointVector::zeros();
        qdd.fixed_rows_mut::<NU>(0).copy_from(u);
        reduce(&self.inverse_dynamics(q, qd, &qdd, work), work)
    }

    /// Joint axes and inertias at q.
    pub(crate) fn place(&self, q: &JointVector, work: &mut Workspace) {
        let mut parent = self.base;
        for (i, joint) in self.joints.iter().enumerate() {
            parent = joint.frame(&parent, q[i]);
            let axis = parent.rotation * joint.axis;
            work.axis[i] = Spatial::new(axis, parent.origin.cross(&axis));
            work.body[i] = joint.world_inertia(&parent);
        }
        work.composite[NQ - 1] = work.body[NQ - 1];
        for i in (0..NQ - 1).rev() {
            work.composite[i] = work.composite[i + 1] + work.body[i];
        }
    }

    /// Velocities at qd; needs [`Self::place`].
    pub(crate) fn move_with(&self, qd: &JointVector, work: &mut Workspace) {
        work.velocity[0] = Spatial::ZERO;
        for i in 0..NQ {
            work.psi[i] = work.velocity[i].cross_motion(&work.axis[i]);
            work.velocity[i + 1] = work.velocity[i] + work.axis[i] * qd[i];
        }
    }

    /// Accelerations and forces at qdd; needs [`Self::move_with`].
    pub(crate) fn accelerate_with(&self, qd: &JointVector, qdd: &JointVector, work: &mut Workspace) {
        accelerate(Spatial::new(Vector3::zeros(), -self.gravity), qd, qdd, work);
    }
}

/// Accelerations and forces at qdd of a chain whose base accelerates with `base`; needs [`Model::move_with`].
fn accelerate(base: Spatial, qd: &JointVector, qdd: &JointVector, work: &mut Workspace) {
    work.acceleration[0] = base;
    for i in 0..NQ {
        work.acceleration[i + 1] = work.acceleration[i] + work.axis[i] * qdd[i] + work.psi[i] * qd[i];
    }
    let mut carried = Spatial::ZERO;
    for i in (0..NQ).rev() {
        let (v, body) = (&work.velocity[i + 1], &work.body[i]);
        carried += body.apply(&work.acceleration[i + 1]) + v.cross_force(&body.apply(v));
        work.force[i] = carried;
    }
}

/// (3a) and (3b) for the joint torques `r` that the motion with qdd_U = 0 needs: the unactuated joints, which have
/// no motors, accelerate until their torques vanish.
fn reduce(r: &JointVector, work: &Workspace) -> Accelerations {
    let columns = work.unactuated_columns();
    let qdd_u = -solve_unactuated(&unactuated_block(&columns), &r.fixed_rows::<N_UNACTUATED>(NU).into());
    let tau = r.fixed_rows::<NU>(0) + columns.fixed_rows::<NU>(0) * qdd_u;
    Accelerations { qdd_u, tau }
}

/// S_i . F_i for every joint.
fn generalized_force(work: &Workspace) -> JointVector {
    JointVector::from_fn(|i, _| work.axis[i].dot(&work.force[i]))
}

/// [qd, u, qdd_U] (4).
pub(crate) fn state_derivative(x: &State, u: &ActuatedVector, qdd_u: &UnactuatedVector) -> State {
    let mut f = SVector::<f64, NX>::zeros();
    f.fixed_rows_mut::<NQ>(0).copy_from(&x.fixed_rows::<NQ>(NQ));
    f.fixed_rows_mut::<NU>(NQ).copy_from(u);
    f.fixed_rows_mut::<N_UNACTUATED>(NQ + NU).copy_from(qdd_u);
    f
}

/// M_UU out of [M_AU; M_UU].
pub(crate) fn unactuated_block(columns: &SMatrix<f64, NQ, N_UNACTUATED>) -> UnactuatedMatrix {
    columns.fixed_view::<N_UNACTUATED, N_UNACTUATED>(NU, 0).into()
}

/// M_UU^-1 r by elimination in place: M_UU is positive definite, so no pivot vanishes.
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
