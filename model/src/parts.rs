//! Named parts of the vectors of a chain: q and qd of a state, and of both the actuated (A) and unactuated (U) joints (2).

use crate::{ActuatedVector, JointVector, N_UNACTUATED, NQ, NU, NX, State, UnactuatedVector};
use nalgebra::{Const, U1, VectorViewMut};

/// `R` consecutive components of a vector with `LENGTH` components, to be written.
type PartMut<'a, const R: usize, const LENGTH: usize> = VectorViewMut<'a, f64, Const<R>, U1, Const<LENGTH>>;

/// The parts of a state x = [q, qd], or of its time derivative.
pub trait StateParts {
    /// q, positions of all joints, rad.
    fn q(&self) -> JointVector;
    /// qd, velocities of all joints, rad/s.
    fn qd(&self) -> JointVector;
    /// q_A, positions of the actuated joints, rad.
    fn q_a(&self) -> ActuatedVector;
    /// q_U, positions of the unactuated joints, rad.
    fn q_u(&self) -> UnactuatedVector;
    /// qd_A, velocities of the actuated joints, rad/s.
    fn qd_a(&self) -> ActuatedVector;
    /// qd_U, velocities of the unactuated joints, rad/s.
    fn qd_u(&self) -> UnactuatedVector;
    /// q, to be written.
    fn q_mut(&mut self) -> PartMut<'_, NQ, NX>;
    /// qd, to be written.
    fn qd_mut(&mut self) -> PartMut<'_, NQ, NX>;
    /// q_A, to be written.
    fn q_a_mut(&mut self) -> PartMut<'_, NU, NX>;
    /// q_U, to be written.
    fn q_u_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NX>;
    /// qd_A, to be written.
    fn qd_a_mut(&mut self) -> PartMut<'_, NU, NX>;
    /// qd_U, to be written.
    fn qd_u_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NX>;
}

impl StateParts for State {
    #[inline]
    fn q(&self) -> JointVector {
        self.fixed_rows::<NQ>(0).into()
    }

    #[inline]
    fn qd(&self) -> JointVector {
        self.fixed_rows::<NQ>(NQ).into()
    }

    #[inline]
    fn q_a(&self) -> ActuatedVector {
        self.fixed_rows::<NU>(0).into()
    }

    #[inline]
    fn q_u(&self) -> UnactuatedVector {
        self.fixed_rows::<N_UNACTUATED>(NU).into()
    }

    #[inline]
    fn qd_a(&self) -> ActuatedVector {
        self.fixed_rows::<NU>(NQ).into()
    }

    #[inline]
    fn qd_u(&self) -> UnactuatedVector {
        self.fixed_rows::<N_UNACTUATED>(NQ + NU).into()
    }

    #[inline]
    fn q_mut(&mut self) -> PartMut<'_, NQ, NX> {
        self.fixed_rows_mut::<NQ>(0)
    }

    #[inline]
    fn qd_mut(&mut self) -> PartMut<'_, NQ, NX> {
        self.fixed_rows_mut::<NQ>(NQ)
    }

    #[inline]
    fn q_a_mut(&mut self) -> PartMut<'_, NU, NX> {
        self.fixed_rows_mut::<NU>(0)
    }

    #[inline]
    fn q_u_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NX> {
        self.fixed_rows_mut::<N_UNACTUATED>(NU)
    }

    #[inline]
    fn qd_a_mut(&mut self) -> PartMut<'_, NU, NX> {
        self.fixed_rows_mut::<NU>(NQ)
    }

    #[inline]
    fn qd_u_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NX> {
        self.fixed_rows_mut::<N_UNACTUATED>(NQ + NU)
    }
}

/// The parts of a vector with one component per joint: q, qd, qdd or torques.
pub trait JointParts {
    /// The components of the actuated joints.
    fn actuated(&self) -> ActuatedVector;
    /// The components of the unactuated joints.
    fn unactuated(&self) -> UnactuatedVector;
    /// The components of the actuated joints, to be written.
    fn actuated_mut(&mut self) -> PartMut<'_, NU, NQ>;
    /// The components of the unactuated joints, to be written.
    fn unactuated_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NQ>;
}

impl JointParts for JointVector {
    #[inline]
    fn actuated(&self) -> ActuatedVector {
        self.fixed_rows::<NU>(0).into()
    }

    #[inline]
    fn unactuated(&self) -> UnactuatedVector {
        self.fixed_rows::<N_UNACTUATED>(NU).into()
    }

    #[inline]
    fn actuated_mut(&mut self) -> PartMut<'_, NU, NQ> {
        self.fixed_rows_mut::<NU>(0)
    }

    #[inline]
    fn unactuated_mut(&mut self) -> PartMut<'_, N_UNACTUATED, NQ> {
        self.fixed_rows_mut::<N_UNACTUATED>(NU)
    }
}
