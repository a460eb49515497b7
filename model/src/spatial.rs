//! Vectors, matrices, spatial vectors and rigid-body inertias over any [`Scalar`], all expressed in the world frame about its origin.
//!
//! Featherstone, *Rigid Body Dynamics Algorithms*, Springer 2008, chapter 2. nalgebra's types of three components are not used in the
//! recursions because [`crate::Lanes`] is no number of nalgebra.

use crate::scalar::Scalar;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// A vector of three components.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vector3<T>(pub [T; 3]);

impl<T: Scalar> Vector3<T> {
    pub(crate) const ZERO: Self = Self([T::ZERO; 3]);

    #[inline(always)]
    pub(crate) fn from(v: &[f64; 3]) -> Self {
        Self([T::constant(v[0]), T::constant(v[1]), T::constant(v[2])])
    }

    #[inline(always)]
    pub(crate) fn dot(&self, o: &Self) -> T {
        self.0[0] * o.0[0] + self.0[1] * o.0[1] + self.0[2] * o.0[2]
    }

    #[inline(always)]
    pub(crate) fn cross(&self, o: &Self) -> Self {
        let (a, b) = (&self.0, &o.0);
        Self([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    }
}

impl<T: Scalar> Add for Vector3<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self([self.0[0] + o.0[0], self.0[1] + o.0[1], self.0[2] + o.0[2]])
    }
}

impl<T: Scalar> Sub for Vector3<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self([self.0[0] - o.0[0], self.0[1] - o.0[1], self.0[2] - o.0[2]])
    }
}

impl<T: Scalar> Neg for Vector3<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self([-self.0[0], -self.0[1], -self.0[2]])
    }
}

impl<T: Scalar> Mul<T> for Vector3<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: T) -> Self {
        Self([self.0[0] * s, self.0[1] * s, self.0[2] * s])
    }
}

impl<T: Scalar> AddAssign for Vector3<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

/// A matrix of three rows and three columns, by rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Matrix3<T>(pub [[T; 3]; 3]);

impl<T: Scalar> Matrix3<T> {
    pub(crate) const ZERO: Self = Self([[T::ZERO; 3]; 3]);

    #[inline(always)]
    pub(crate) fn from(m: &[[f64; 3]; 3]) -> Self {
        let mut out = Self::ZERO;
        for i in 0..3 {
            for j in 0..3 {
                out.0[i][j] = T::constant(m[i][j]);
            }
        }
        out
    }

    #[inline(always)]
    pub(crate) fn times(&self, v: &Vector3<T>) -> Vector3<T> {
        let row = |i: usize| self.0[i][0] * v.0[0] + self.0[i][1] * v.0[1] + self.0[i][2] * v.0[2];
        Vector3([row(0), row(1), row(2)])
    }

    /// Transpose times v.
    #[inline(always)]
    pub(crate) fn tr_times(&self, v: &Vector3<T>) -> Vector3<T> {
        let col = |i: usize| self.0[0][i] * v.0[0] + self.0[1][i] * v.0[1] + self.0[2][i] * v.0[2];
        Vector3([col(0), col(1), col(2)])
    }

    /// Product with a constant matrix.
    #[inline(always)]
    pub(crate) fn times_const(&self, m: &[[f64; 3]; 3]) -> Self {
        let mut out = Self::ZERO;
        for i in 0..3 {
            for j in 0..3 {
                out.0[i][j] = self.0[i][0] * m[0][j] + self.0[i][1] * m[1][j] + self.0[i][2] * m[2][j];
            }
        }
        out
    }

    #[inline(always)]
    pub(crate) fn times_const_v(&self, v: &[f64; 3]) -> Vector3<T> {
        let row = |i: usize| self.0[i][0] * v[0] + self.0[i][1] * v[1] + self.0[i][2] * v[2];
        Vector3([row(0), row(1), row(2)])
    }

    #[inline(always)]
    pub(crate) fn column(&self, j: usize) -> Vector3<T> {
        Vector3([self.0[0][j], self.0[1][j], self.0[2][j]])
    }

    #[inline(always)]
    pub(crate) fn map2(&self, o: &Self, f: impl Fn(T, T) -> T) -> Self {
        let mut out = Self::ZERO;
        for i in 0..3 {
            for j in 0..3 {
                out.0[i][j] = f(self.0[i][j], o.0[i][j]);
            }
        }
        out
    }

    #[inline(always)]
    pub(crate) fn plus(&self, o: &Self) -> Self {
        self.map2(o, |a, b| a + b)
    }

    #[inline(always)]
    pub(crate) fn minus(&self, o: &Self) -> Self {
        self.map2(o, |a, b| a - b)
    }
}

/// A symmetric matrix of three rows and three columns: xx, xy, xz, yy, yz, zz.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Symmetric3<T>(pub [T; 6]);

impl<T: Scalar> Symmetric3<T> {
    pub(crate) const ZERO: Self = Self([T::ZERO; 6]);

    #[inline(always)]
    pub(crate) fn times(&self, v: &Vector3<T>) -> Vector3<T> {
        let (m, v) = (&self.0, &v.0);
        Vector3([
            m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
            m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
            m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
        ])
    }

    #[inline(always)]
    pub(crate) fn full(&self) -> Matrix3<T> {
        let m = &self.0;
        Matrix3([[m[0], m[1], m[2]], [m[1], m[3], m[4]], [m[2], m[4], m[5]]])
    }

    #[inline(always)]
    pub(crate) fn plus(&self, o: &Self) -> Self {
        let mut out = self.0;
        for i in 0..6 {
            out[i] = self.0[i] + o.0[i];
        }
        Self(out)
    }
}

/// A spatial vector: a motion (angular velocity, linear velocity of the body point at the origin) or a force (moment about the origin,
/// force).
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpatialVector<T> {
    pub ang: Vector3<T>,
    pub lin: Vector3<T>,
}

impl<T: Scalar> SpatialVector<T> {
    pub(crate) const ZERO: Self = Self { ang: Vector3::ZERO, lin: Vector3::ZERO };

    #[inline(always)]
    pub(crate) fn new(ang: Vector3<T>, lin: Vector3<T>) -> Self {
        Self { ang, lin }
    }

    /// Power of a force on a motion (symmetric in its arguments).
    #[inline(always)]
    pub(crate) fn dot(&self, o: &Self) -> T {
        self.ang.dot(&o.ang) + self.lin.dot(&o.lin)
    }

    /// m x n: rate of change of the motion n carried along with the motion m.
    #[inline(always)]
    pub(crate) fn cross_motion(&self, n: &Self) -> Self {
        Self::new(self.ang.cross(&n.ang), self.ang.cross(&n.lin) + self.lin.cross(&n.ang))
    }

    /// m x* f: rate of change of the force f carried along with the motion m; (a x b) . f = a . (b x* f).
    #[inline(always)]
    pub(crate) fn cross_force(&self, f: &Self) -> Self {
        Self::new(self.ang.cross(&f.ang) + self.lin.cross(&f.lin), self.ang.cross(&f.lin))
    }

    #[inline(always)]
    pub(crate) fn twice(&self) -> Self {
        *self + *self
    }
}

impl<T: Scalar> Add for SpatialVector<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::new(self.ang + o.ang, self.lin + o.lin)
    }
}

impl<T: Scalar> Sub for SpatialVector<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::new(self.ang - o.ang, self.lin - o.lin)
    }
}

impl<T: Scalar> AddAssign for SpatialVector<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<T: Scalar> Mul<T> for SpatialVector<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: T) -> Self {
        Self::new(self.ang * s, self.lin * s)
    }
}

/// Spatial inertia of one rigid body, or of several joined ones, about the world origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpatialInertia<T> {
    /// m, mass, kg.
    pub mass: f64,
    /// m c, mass times centre of mass, kg m.
    pub moment: Vector3<T>,
    /// Rotational inertia about the origin, kg m^2.
    pub rotational: Symmetric3<T>,
}

impl<T: Scalar> SpatialInertia<T> {
    pub(crate) const ZERO: Self = Self { mass: 0.0, moment: Vector3::ZERO, rotational: Symmetric3::ZERO };

    /// Momentum of the body in the motion `m`, or the force that the acceleration `m` needs.
    #[inline(always)]
    pub(crate) fn apply(&self, m: &SpatialVector<T>) -> SpatialVector<T> {
        SpatialVector::new(
            self.rotational.times(&m.ang) + self.moment.cross(&m.lin),
            m.lin * T::constant(self.mass) - self.moment.cross(&m.ang),
        )
    }

    #[inline(always)]
    pub(crate) fn plus(&self, o: &Self) -> Self {
        Self {
            mass: self.mass + o.mass,
            moment: self.moment + o.moment,
            rotational: self.rotational.plus(&o.rotational),
        }
    }
}

/// The matrix of the cross product: skew(a) b = a x b.
#[inline(always)]
pub(crate) fn skew<T: Scalar>(a: &Vector3<T>) -> Matrix3<T> {
    let [x, y, z] = a.0;
    Matrix3([[T::ZERO, -z, y], [z, T::ZERO, -x], [-y, x, T::ZERO]])
}

/// A B of two full matrices.
#[inline(always)]
pub(crate) fn product<T: Scalar>(a: &Matrix3<T>, b: &Matrix3<T>) -> Matrix3<T> {
    let mut out = Matrix3::ZERO;
    for i in 0..3 {
        for j in 0..3 {
            out.0[i][j] = a.0[i][0] * b.0[0][j] + a.0[i][1] * b.0[1][j] + a.0[i][2] * b.0[2][j];
        }
    }
    out
}
