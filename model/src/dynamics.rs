//! Equations of motion (1)-(5), (9), (11), (24), by recursions over the chain in the world frame.
//!
//! The recursions run along the chain; vectors are sorted, and [`crate::Order`] says where a joint stands in them.

use crate::model::{Joint, JointKind};
use crate::spatial::{Matrix3, SpatialInertia, SpatialVector, Symmetric3, Vector3};
use crate::vector::{Joints, Matrix, Unactuated};
use crate::{
    ActuatedMatrix, ActuatedVector, Dims, JointMatrix, JointVector, LARGEST_STATE, Lanes, MOST_JOINTS, Model,
    Scalar, State, UnactuatedVector, with_dims,
};

/// Scratch memory of the recursions over the chain, owned by the caller. It holds the quantities of the state that was
/// evaluated last.
///
/// Index i of a joint quantity is joint i of the chain; index i of `velocity` and `acceleration` is the body *before* joint i, so that
/// index 0 is the base. No call clears it: kilobytes of zeros would cost more than a small chain.
#[derive(Clone, Debug)]
pub struct Workspace<T = f64> {
    /// S_i, axis of joint i.
    pub(crate) axis: [SpatialVector<T>; MOST_JOINTS],
    /// I_i, inertia of body i.
    pub(crate) body: [SpatialInertia<T>; MOST_JOINTS],
    /// I^C_i, inertia of body i and all bodies after it together.
    pub(crate) composite: [SpatialInertia<T>; MOST_JOINTS],
    /// V_i, velocity.
    pub(crate) velocity: [SpatialVector<T>; MOST_JOINTS + 1],
    /// A_i, acceleration, with gravity as an upward acceleration of the base.
    pub(crate) acceleration: [SpatialVector<T>; MOST_JOINTS + 1],
    /// psi_i = V_{i-1} x S_i
    pub(crate) psi: [SpatialVector<T>; MOST_JOINTS],
    /// F_i, force that body i and all bodies after it need for their motion.
    pub(crate) force: [SpatialVector<T>; MOST_JOINTS],
    /// I^C_i S_i: its product with S_j, j <= i, is the entry M_ji.
    pub(crate) carried: [SpatialVector<T>; MOST_JOINTS],
    /// qdd of joint i.
    pub(crate) qdd: [T; MOST_JOINTS],
    /// Columns of M of the unactuated joints, sorted: `columns[c][i]`.
    pub(crate) columns: [[T; MOST_JOINTS]; MOST_JOINTS],
    /// M_UU after Gaussian elimination, with the factors below the diagonal.
    pub(crate) eliminated: [[T; MOST_JOINTS]; MOST_JOINTS],
    /// Of the second derivatives: with respect to q and qdd_U.
    pub(crate) q_qdd_u: [[T; MOST_JOINTS]; MOST_JOINTS],
    /// W_i, virtual velocity of the second derivatives.
    pub(crate) virtual_velocity: [SpatialVector<T>; MOST_JOINTS + 1],
    /// omega_i = W_{i-1} x S_i
    pub(crate) omega: [SpatialVector<T>; MOST_JOINTS],
}

impl<T: Scalar> Default for Workspace<T> {
    fn default() -> Self {
        Self {
            axis: [SpatialVector::ZERO; MOST_JOINTS],
            body: [SpatialInertia::ZERO; MOST_JOINTS],
            composite: [SpatialInertia::ZERO; MOST_JOINTS],
            velocity: [SpatialVector::ZERO; MOST_JOINTS + 1],
            acceleration: [SpatialVector::ZERO; MOST_JOINTS + 1],
            psi: [SpatialVector::ZERO; MOST_JOINTS],
            force: [SpatialVector::ZERO; MOST_JOINTS],
            carried: [SpatialVector::ZERO; MOST_JOINTS],
            qdd: [T::ZERO; MOST_JOINTS],
            columns: [[T::ZERO; MOST_JOINTS]; MOST_JOINTS],
            eliminated: [[T::ZERO; MOST_JOINTS]; MOST_JOINTS],
            q_qdd_u: [[T::ZERO; MOST_JOINTS]; MOST_JOINTS],
            virtual_velocity: [SpatialVector::ZERO; MOST_JOINTS + 1],
            omega: [SpatialVector::ZERO; MOST_JOINTS],
        }
    }
}

/// The unknowns of the hybrid dynamics, in which the actuated joints have a given acceleration u = qdd_A and the unactuated
/// ones have no torque (Featherstone, *Rigid Body Dynamics Algorithms*, chapter 9).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HybridDynamics {
    /// qdd_U (3a), rad/s^2 or m/s^2.
    pub qdd_u: UnactuatedVector,
    /// tau_A (3b), (9), N m or N.
    pub tau: ActuatedVector,
}

/// The components of [`HybridDynamics`] over any number; entries beyond the sizes of the chain have no meaning.
#[derive(Clone, Copy, Debug)]
pub struct HybridValues<T> {
    /// qdd_U (3a), rad/s^2 or m/s^2.
    pub qdd_u: [T; MOST_JOINTS],
    /// tau_A (3b), (9), N m or N.
    pub tau: [T; MOST_JOINTS],
}

impl<T: Scalar> HybridValues<T> {
    /// All zero.
    pub const ZERO: Self = Self { qdd_u: [T::ZERO; MOST_JOINTS], tau: [T::ZERO; MOST_JOINTS] };
}

impl Model {
    /// Joint torques M(q) qdd + C(q, qd) qd + g(q), N m or N: the left-hand side of (1).
    pub fn inverse_dynamics(
        &self,
        q: &JointVector,
        qd: &JointVector,
        qdd: &JointVector,
        work: &mut Workspace,
    ) -> JointVector {
        let sizes = self.sizes();
        self.update_positions(sizes, q, work);
        self.update_velocities(sizes, qd, work);
        self.spread_over_chain(sizes, qdd, &mut work.qdd);
        self.update_accelerations(sizes, self.upward(), qd, work);
        let mut force = self.generalized_force(work);
        for (i, rotor) in self.rotors.iter().enumerate() {
            force[i] += rotor * qdd[i];
        }
        force
    }

    /// Mass matrix M(q) (1), symmetric and positive definite, in kg m^2, kg m or kg.
    pub fn mass_matrix(&self, q: &JointVector, work: &mut Workspace) -> JointMatrix {
        self.update_positions(self.sizes(), q, work);
        self.mass_matrix_of(work)
    }

    /// M at the q that was evaluated last with `work`.
    fn mass_matrix_of(&self, work: &mut Workspace) -> JointMatrix {
        let sizes = self.sizes();
        let mut m = JointMatrix::zeros(sizes);
        for j in 0..sizes.joints() {
            work.carried[j] = work.composite[j].apply(&work.axis[j]);
            for i in 0..=j {
                let entry = work.axis[i].dot(&work.carried[j]);
                let (a, b) = (self.order.coordinate(i), self.order.coordinate(j));
                (m[(a, b)], m[(b, a)]) = (entry, entry);
            }
        }
        for (i, rotor) in self.rotors.iter().enumerate() {
            m[(i, i)] += rotor;
        }
        m
    }

    /// Joint torques C(q, qd) qd + g(q) (1), N m or N: [`Self::inverse_dynamics`] with qdd = 0.
    pub fn nonlinear_effects(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> JointVector {
        self.inverse_dynamics(q, qd, &JointVector::zeros(self.sizes()), work)
    }

    /// Gravity vector g(q) (1), N m or N: [`Self::nonlinear_effects`] with qd = 0.
    pub fn gravity_torque(&self, q: &JointVector, work: &mut Workspace) -> JointVector {
        self.nonlinear_effects(q, &JointVector::zeros(self.sizes()), work)
    }

    /// The hybrid dynamics (3a), (3b): acceleration of the unactuated joints and motor torque at the state `x` for the input `u`.
    pub fn hybrid_dynamics(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> HybridDynamics {
        let sizes = self.sizes();
        let mut values = HybridValues::ZERO;
        with_dims!(sizes, |d| self.hybrid_values_here(d, x, u, work, &mut values));
        HybridDynamics {
            qdd_u: UnactuatedVector::from_fn(sizes, |i| values.qdd_u[i]),
            tau: ActuatedVector::from_fn(sizes, |i| values.tau[i]),
        }
    }

    /// [`Self::hybrid_values`] as a function of its own, so that the compiler knows that its arguments do not overlap.
    #[inline(never)]
    fn hybrid_values_here(
        &self,
        d: impl Dims,
        x: &[f64],
        u: &[f64],
        work: &mut Workspace,
        out: &mut HybridValues<f64>,
    ) {
        self.hybrid_values(d, x, u, work, out);
    }

    /// [`Self::hybrid_dynamics`] at `count` points, with the same bits: calls `visit` with the number, the state and the result of each, in
    /// order, until it returns an error. Four points are evaluated side by side.
    ///
    /// `point` writes the state and the input of a point.
    ///
    /// # Errors
    /// That of `visit`.
    pub fn try_hybrid_dynamics<E>(
        &self,
        count: usize,
        point: impl Fn(usize, &mut State, &mut ActuatedVector),
        mut visit: impl FnMut(usize, &State, &HybridDynamics) -> Result<(), E>,
    ) -> Result<(), E> {
        const LANES: usize = 4;
        let sizes = self.sizes();
        let mut states = [State::zeros(sizes); LANES];
        let mut input = ActuatedVector::zeros(sizes);
        let mut dynamics = HybridDynamics { qdd_u: UnactuatedVector::zeros(sizes), tau: input };
        let mut work = Workspace::<Lanes<LANES>>::default();
        let (mut x, mut u) = ([Lanes::ZERO; LARGEST_STATE], [Lanes::ZERO; MOST_JOINTS]);
        let mut values = HybridValues::ZERO;
        for first in (0..count).step_by(LANES) {
            for (lane, state) in states.iter_mut().enumerate() {
                // Lanes that are left over repeat the last point.
                point((first + lane).min(count - 1), state, &mut input);
                x.iter_mut().zip(state.iter()).for_each(|(x, v)| x.0[lane] = *v);
                u.iter_mut().zip(input.iter()).for_each(|(u, v)| u.0[lane] = *v);
            }
            self.hybrid_dynamics_of(&x[..sizes.state()], &u[..sizes.actuated()], &mut work, &mut values);
            for (lane, state) in states.iter().enumerate().take(count - first) {
                dynamics.qdd_u.iter_mut().zip(&values.qdd_u).for_each(|(out, v)| *out = v.0[lane]);
                dynamics.tau.iter_mut().zip(&values.tau).for_each(|(out, v)| *out = v.0[lane]);
                visit(first + lane, state, &dynamics)?;
            }
        }
        Ok(())
    }

    /// [`Self::hybrid_dynamics`] at x = [q, qd] and u, sorted, over any number: of one point, or of several side by side.
    pub fn hybrid_dynamics_of<T: Scalar>(
        &self,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut HybridValues<T>,
    ) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has AVX2.
            return unsafe { self.hybrid_values_avx2(x, u, work, out) };
        }
        with_dims!(self.sizes(), |d| self.hybrid_values(d, x, u, work, out));
    }

    /// [`Self::hybrid_values`] with registers of 256 bits, and the same bits: nothing is contracted to fused operations.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn hybrid_values_avx2<T: Scalar>(
        &self,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut HybridValues<T>,
    ) {
        with_dims!(self.sizes(), |d| self.hybrid_values(d, x, u, work, out));
    }

    /// f(x_k, u_k) (5) at many points, for example the knots of a trajectory.
    pub fn f_of_all(&self, x: &[State], u: &[ActuatedVector]) -> Vec<State> {
        let mut f = Vec::with_capacity(x.len());
        let all = self.try_hybrid_dynamics(
            x.len(),
            |k, state, input| {
                state.copy_from_slice(&x[k]);
                input.copy_from_slice(&u[k]);
            },
            |k, x, dynamics| {
                f.push(state_derivative(x, &u[k], &dynamics.qdd_u));
                Ok::<_, std::convert::Infallible>(())
            },
        );
        all.unwrap_or_else(|never| match never {});
        f
    }

    /// Motor torque tau_A = M~ u + C~ qd + g~ (9), N m or N; with u = u_d + K dx the torque law (24).
    pub fn torque(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> ActuatedVector {
        self.hybrid_dynamics(x, u, work).tau
    }

    /// Reduced mass matrix M~ = M_AA - M_AU M_UU^-1 M_UA (10), symmetric and positive definite, at the state that
    /// [`Self::hybrid_dynamics`] evaluated last with `work`.
    pub fn reduced_inertia(&self, work: &mut Workspace) -> ActuatedMatrix {
        let mut reduced = ActuatedMatrix::zeros(self.sizes());
        self.write_reduced_inertia(work, &mut reduced);
        reduced
    }

    /// [`Self::reduced_inertia`] into a matrix of this chain: the memory of a matrix is 2 KB, which the control cycle does not copy.
    pub fn write_reduced_inertia(&self, work: &mut Workspace, out: &mut ActuatedMatrix) {
        debug_assert_eq!(out.sizes(), self.sizes());
        with_dims!(self.sizes(), |d| self.reduced_inertia_here(d, work, out));
    }

    #[inline(never)]
    fn reduced_inertia_here(&self, d: impl Dims, work: &mut Workspace, out: &mut ActuatedMatrix) {
        let (n, actuated, unactuated) = (d.joints(), d.actuated(), d.unactuated());
        // The joints from the first unactuated one on are there already, see `update_columns`.
        for i in 0..self.order.joint(actuated) {
            work.carried[i] = work.composite[i].apply(&work.axis[i]);
        }
        let mut solved = [[0.0; MOST_JOINTS]; MOST_JOINTS];
        for a in 0..actuated {
            for c in 0..unactuated {
                solved[a][c] = work.columns[c][a];
            }
            solve_unactuated(d, work, &mut solved[a]);
        }
        for j in 0..n {
            let b = self.order.coordinate(j);
            if b >= actuated {
                continue;
            }
            for i in 0..=j {
                let a = self.order.coordinate(i);
                if a >= actuated {
                    continue;
                }
                let mut entry = work.axis[i].dot(&work.carried[j]);
                if i == j {
                    entry += self.rotors[a];
                }
                for c in 0..unactuated {
                    entry -= work.columns[c][a] * solved[b][c];
                }
                (out[(a, b)], out[(b, a)]) = (entry, entry);
            }
        }
    }

    /// Torque M~ a (10), N m or N, of the accelerations `a`, at the state that [`Self::hybrid_dynamics`] evaluated last with `work`.
    pub fn reduced_inertia_times(&self, a: &ActuatedVector, work: &mut Workspace) -> ActuatedVector {
        &self.reduced_inertia(work) * a
    }

    /// Writes the rows [M_UA, M_UU] of M(q) (2) that belong to the unactuated joints into `out`, at the state that
    /// [`Self::hybrid_dynamics`] evaluated last with `work`.
    pub fn write_unactuated_rows(&self, work: &Workspace, out: &mut Matrix<Unactuated, Joints>) {
        debug_assert_eq!(out.sizes(), self.sizes());
        for c in 0..self.sizes().unactuated() {
            out.row_mut(c).copy_from_slice(&work.columns[c][..self.sizes().joints()]);
        }
    }

    /// Motor torque without its Coriolis part M~ u + g~ (11), N m or N: [`Self::torque`] at qd = 0.
    pub fn torque_without_coriolis(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> ActuatedVector {
        self.torque(&State::new(&x.q(), &JointVector::zeros(self.sizes())), u, work)
    }

    /// Coriolis part of the motor torque C~(q, qd) qd = C_A - M_AU M_U^-1 C_U with [C_A; C_U] = C(q, qd) qd (10), N m or N: the
    /// difference of [`Self::torque`] and [`Self::torque_without_coriolis`] at any u.
    pub fn coriolis_torque(&self, q: &JointVector, qd: &JointVector, work: &mut Workspace) -> ActuatedVector {
        let sizes = self.sizes();
        self.update_positions(sizes, q, work);
        self.update_velocities(sizes, qd, work);
        // Without gravity and without qdd, C qd is what remains of (1).
        work.qdd = [0.0; MOST_JOINTS];
        self.update_accelerations(sizes, Vector3::ZERO, qd, work);
        self.update_columns(sizes, work);
        let force = self.generalized_force(work);
        let mut values = HybridValues::ZERO;
        reduce(sizes, &force, work, &mut values);
        ActuatedVector::from_fn(sizes, |i| values.tau[i])
    }

    /// Dynamics f(x, u) (4), (5): the time derivative [qd, u, qdd_U] of the state.
    pub fn f(&self, x: &State, u: &ActuatedVector, work: &mut Workspace) -> State {
        state_derivative(x, u, &self.hybrid_dynamics(x, u, work).qdd_u)
    }

    /// f(x, u) (5) and the motor torque (9), N m or N, of one evaluation.
    pub fn derivative_and_torque(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> (State, ActuatedVector) {
        let HybridDynamics { qdd_u, tau } = self.hybrid_dynamics(x, u, work);
        (state_derivative(x, u, &qdd_u), tau)
    }

    /// Forward dynamics: accelerations qdd = M^-1 (tau - C qd - g) of all joints under the joint torques `tau` (N m or N, including
    /// friction). `None` if M is not positive definite, which happens only for a `q` that is not finite.
    pub fn forward_dynamics(
        &self,
        q: &JointVector,
        qd: &JointVector,
        tau: &JointVector,
        work: &mut Workspace,
    ) -> Option<JointVector> {
        let bias = self.nonlinear_effects(q, qd, work);
        self.mass_matrix_of(work).solve_positive(&(tau - bias))
    }

    /// Kinetic plus potential energy of the bodies and the rotors, J.
    pub fn energy(&self, x: &State, work: &mut Workspace) -> f64 {
        let (q, qd) = (x.q(), x.qd());
        0.5 * qd.dot(&(&self.mass_matrix(&q, work) * &qd)) + self.potential_energy(&q)
    }

    /// Acceleration of the base that stands for gravity.
    #[inline(always)]
    pub(crate) fn upward<T: Scalar>(&self) -> Vector3<T> {
        let g = &self.gravity;
        Vector3::from(&[-g.x, -g.y, -g.z])
    }

    /// Joint torques S_i . F_i of the bodies, sorted.
    fn generalized_force(&self, work: &Workspace) -> JointVector {
        JointVector::from_fn(self.sizes(), |c| {
            let i = self.order.joint(c);
            work.axis[i].dot(&work.force[i])
        })
    }

    /// Copies the sorted vector `sorted` to the chain's order.
    #[inline(always)]
    pub(crate) fn spread_over_chain<T: Scalar>(
        &self,
        d: impl Dims,
        sorted: &[T],
        chain: &mut [T; MOST_JOINTS],
    ) {
        for (i, value) in chain.iter_mut().enumerate().take(d.joints()) {
            *value = sorted[self.order.coordinate(i)];
        }
    }

    /// qdd_U and tau_A at x = [q, qd] and u, sorted.
    #[inline(always)]
    pub(crate) fn hybrid_values<T: Scalar>(
        &self,
        d: impl Dims,
        x: &[T],
        u: &[T],
        work: &mut Workspace<T>,
        out: &mut HybridValues<T>,
    ) {
        let (n, actuated) = (d.joints(), d.actuated());
        let (q, qd) = (&x[..n], &x[n..2 * n]);
        for i in 0..n {
            let c = self.order.coordinate(i);
            work.qdd[i] = if c < actuated { u[c] } else { T::ZERO };
        }
        self.update_positions(d, q, work);
        self.update_velocities(d, qd, work);
        self.update_accelerations(d, self.upward(), qd, work);
        self.update_columns(d, work);
        let mut force = [T::ZERO; MOST_JOINTS];
        for i in 0..n {
            force[self.order.coordinate(i)] = work.axis[i].dot(&work.force[i]);
        }
        for a in 0..actuated {
            force[a] += u[a] * self.rotors[a];
        }
        for c in 0..d.unactuated() {
            force[actuated + c] += qd[actuated + c] * self.friction[c];
        }
        reduce(d, &force, work, out);
    }

    /// Computes joint axes and inertias at q.
    #[inline(always)]
    pub(crate) fn update_positions<T: Scalar>(&self, d: impl Dims, q: &[T], work: &mut Workspace<T>) {
        let n = d.joints();
        let mut frame = Frame::base();
        for (i, joint) in self.joints.iter().enumerate().take(n) {
            joint.advance(&mut frame, q[self.order.coordinate(i)]);
            work.axis[i] = joint.motion(&frame);
            work.body[i] = joint.world_inertia(&frame);
        }
        work.composite[n - 1] = work.body[n - 1];
        for i in (0..n - 1).rev() {
            work.composite[i] = work.composite[i + 1].plus(&work.body[i]);
        }
    }

    /// Computes velocities at qd, after [`Self::update_positions`].
    #[inline(always)]
    pub(crate) fn update_velocities<T: Scalar>(&self, d: impl Dims, qd: &[T], work: &mut Workspace<T>) {
        work.velocity[0] = SpatialVector::ZERO;
        for i in 0..d.joints() {
            work.psi[i] = work.velocity[i].cross_motion(&work.axis[i]);
            work.velocity[i + 1] = work.velocity[i] + work.axis[i] * qd[self.order.coordinate(i)];
        }
    }

    /// Computes accelerations and forces at `work.qdd` of a chain whose base accelerates with `base`, after
    /// [`Self::update_velocities`].
    #[inline(always)]
    pub(crate) fn update_accelerations<T: Scalar>(
        &self,
        d: impl Dims,
        base: Vector3<T>,
        qd: &[T],
        work: &mut Workspace<T>,
    ) {
        let n = d.joints();
        work.acceleration[0] = SpatialVector::new(Vector3::ZERO, base);
        for i in 0..n {
            work.acceleration[i + 1] = work.acceleration[i]
                + work.axis[i] * work.qdd[i]
                + work.psi[i] * qd[self.order.coordinate(i)];
        }
        let mut carried = SpatialVector::ZERO;
        for i in (0..n).rev() {
            let (v, body) = (&work.velocity[i + 1], &work.body[i]);
            carried += body.apply(&work.acceleration[i + 1]) + v.cross_force(&body.apply(v));
            work.force[i] = carried;
        }
    }

    /// Computes the columns of M of the unactuated joints and eliminates M_UU, after [`Self::update_positions`]. M_UU is positive
    /// definite, so that no pivot vanishes.
    #[inline(always)]
    pub(crate) fn update_columns<T: Scalar>(&self, d: impl Dims, work: &mut Workspace<T>) {
        let (n, actuated, unactuated) = (d.joints(), d.actuated(), d.unactuated());
        for i in self.order.joint(actuated)..n {
            work.carried[i] = work.composite[i].apply(&work.axis[i]);
        }
        for c in 0..unactuated {
            let j = self.order.joint(actuated + c);
            for i in 0..n {
                let entry = if i <= j {
                    work.axis[i].dot(&work.carried[j])
                } else {
                    work.axis[j].dot(&work.carried[i])
                };
                work.columns[c][self.order.coordinate(i)] = entry;
            }
        }
        for r in 0..unactuated {
            for c in 0..unactuated {
                work.eliminated[r][c] = work.columns[c][actuated + r];
            }
        }
        for p in 0..unactuated {
            for r in p + 1..unactuated {
                let factor = work.eliminated[r][p] / work.eliminated[p][p];
                work.eliminated[r][p] = factor;
                for c in p + 1..unactuated {
                    let above = work.eliminated[p][c];
                    work.eliminated[r][c] -= factor * above;
                }
            }
        }
    }
}

/// The hybrid dynamics (3a), (3b), for the joint torques `force` that the motion with qdd_U = 0 would need: the unactuated joints
/// accelerate so that their torques vanish. After [`Model::update_columns`].
#[inline(always)]
fn reduce<T: Scalar>(d: impl Dims, force: &[T], work: &Workspace<T>, out: &mut HybridValues<T>) {
    let (actuated, unactuated) = (d.actuated(), d.unactuated());
    for c in 0..unactuated {
        out.qdd_u[c] = -force[actuated + c];
    }
    solve_unactuated(d, work, &mut out.qdd_u);
    for a in 0..actuated {
        let mut sum = force[a];
        for c in 0..unactuated {
            sum += work.columns[c][a] * out.qdd_u[c];
        }
        out.tau[a] = sum;
    }
}

/// M_UU^-1 b in place, after [`Model::update_columns`].
#[inline(always)]
pub(crate) fn solve_unactuated<T: Scalar>(d: impl Dims, work: &Workspace<T>, b: &mut [T; MOST_JOINTS]) {
    let unactuated = d.unactuated();
    let m = &work.eliminated;
    for p in 0..unactuated {
        for r in p + 1..unactuated {
            let above = b[p];
            b[r] -= m[r][p] * above;
        }
    }
    for p in (0..unactuated).rev() {
        let mut sum = b[p];
        for k in p + 1..unactuated {
            sum -= m[p][k] * b[k];
        }
        b[p] = sum / m[p][p];
    }
}

/// The time derivative [qd, u, qdd_U] of the state (4).
pub(crate) fn state_derivative(x: &State, u: &ActuatedVector, qdd_u: &UnactuatedVector) -> State {
    State::new(&x.qd(), &JointVector::joined(u, qdd_u))
}

/// Pose of a body frame, with the joint axis as its z axis, in the world frame.
pub(crate) struct Frame<T> {
    pub rotation: Matrix3<T>,
    /// m
    pub origin: Vector3<T>,
}

impl<T: Scalar> Frame<T> {
    /// The world frame.
    #[inline(always)]
    pub(crate) fn base() -> Self {
        Self {
            rotation: Matrix3::from(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            origin: Vector3::ZERO,
        }
    }
}

/// (A B')_ij
#[inline(always)]
fn row_product<T: Scalar>(a: &Matrix3<T>, b: &Matrix3<T>, i: usize, j: usize) -> T {
    a.0[i][0] * b.0[j][0] + a.0[i][1] * b.0[j][1] + a.0[i][2] * b.0[j][2]
}

impl Joint {
    /// Replaces the frame of the parent by that of this body at the joint position `q`.
    #[inline(always)]
    pub(crate) fn advance<T: Scalar>(&self, frame: &mut Frame<T>, q: T) {
        let origin = frame.rotation.times_const_v(&self.origin) + frame.origin;
        let r = frame.rotation.times_const(&self.rotation);
        *frame = match self.kind {
            JointKind::Revolute | JointKind::Continuous => {
                let (sin, cos) = q.sin_cos();
                let mut rotation = r;
                for i in 0..3 {
                    rotation.0[i][0] = r.0[i][0] * cos + r.0[i][1] * sin;
                    rotation.0[i][1] = r.0[i][1] * cos - r.0[i][0] * sin;
                }
                Frame { rotation, origin }
            }
            JointKind::Prismatic => Frame { origin: origin + r.column(2) * q, rotation: r },
        };
    }

    /// S, the motion of the body at unit speed of the joint.
    #[inline(always)]
    fn motion<T: Scalar>(&self, frame: &Frame<T>) -> SpatialVector<T> {
        let axis = frame.rotation.column(2);
        match self.kind {
            JointKind::Revolute | JointKind::Continuous => {
                SpatialVector::new(axis, frame.origin.cross(&axis))
            }
            JointKind::Prismatic => SpatialVector::new(Vector3::ZERO, axis),
        }
    }

    /// Spatial inertia of the body in the world frame.
    #[inline(always)]
    fn world_inertia<T: Scalar>(&self, frame: &Frame<T>) -> SpatialInertia<T> {
        let r = &frame.rotation;
        let ri = r.times_const(&self.inertia);
        let com = r.times_const_v(&self.com) + frame.origin;
        let moment = com * T::constant(self.mass);
        let square = moment.dot(&com);
        let (h, c) = (&moment.0, &com.0);
        let rotational = Symmetric3([
            row_product(&ri, r, 0, 0) + (square - h[0] * c[0]),
            row_product(&ri, r, 0, 1) - h[0] * c[1],
            row_product(&ri, r, 0, 2) - h[0] * c[2],
            row_product(&ri, r, 1, 1) + (square - h[1] * c[1]),
            row_product(&ri, r, 1, 2) - h[1] * c[2],
            row_product(&ri, r, 2, 2) + (square - h[2] * c[2]),
        ]);
        SpatialInertia { mass: self.mass, moment, rotational }
    }
}
