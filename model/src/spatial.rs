//! Spatial vectors and rigid-body inertias, all expressed in the world frame about its origin.
//!
//! Featherstone, *Rigid Body Dynamics Algorithms*, Springer 2008, chapter 2.

use nalgebra::{Matrix3, Vector3};
use std::ops::{Add, AddAssign, Mul, Sub};

/// A spatial vector: a motion (angular velocity, linear velocity of the body point at the origin) or a force (moment about
/// the origin, force).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpatialVector {
    pub ang: Vector3<f64>,
    pub lin: Vector3<f64>,
}

impl SpatialVector {
    pub(crate) const ZERO: Self = Self { ang: Vector3::new(0.0, 0.0, 0.0), lin: Vector3::new(0.0, 0.0, 0.0) };

    pub(crate) fn new(ang: Vector3<f64>, lin: Vector3<f64>) -> Self {
        Self { ang, lin }
    }

    /// Power of a force on a motion (symmetric in its arguments).
    #[inline]
    pub(crate) fn dot(&self, other: &Self) -> f64 {
        self.ang.dot(&other.ang) + self.lin.dot(&other.lin)
    }

    /// m x n: rate of change of the motion n carried along with the motion m.
    #[inline]
    pub(crate) fn cross_motion(&self, n: &Self) -> Self {
        Self::new(self.ang.cross(&n.ang), self.ang.cross(&n.lin) + self.lin.cross(&n.ang))
    }

    /// m x* f: rate of change of the force f carried along with the motion m; (a x b) . f = a . (b x* f).
    #[inline]
    pub(crate) fn cross_force(&self, f: &Self) -> Self {
        Self::new(self.ang.cross(&f.ang) + self.lin.cross(&f.lin), self.ang.cross(&f.lin))
    }
}

impl Add for SpatialVector {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self::new(self.ang + o.ang, self.lin + o.lin)
    }
}

impl Sub for SpatialVector {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self::new(self.ang - o.ang, self.lin - o.lin)
    }
}

impl AddAssign for SpatialVector {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        self.ang += o.ang;
        self.lin += o.lin;
    }
}

impl Mul<f64> for SpatialVector {
    type Output = Self;
    #[inline]
    fn mul(self, s: f64) -> Self {
        Self::new(self.ang * s, self.lin * s)
    }
}

/// Spatial inertia of one rigid body, or of several joined ones, about the world origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpatialInertia {
    /// m, mass, kg.
    pub mass: f64,
    /// m c, mass times centre of mass, kg m.
    pub moment: Vector3<f64>,
    /// Rotational inertia about the origin, kg m^2.
    pub rotational: Matrix3<f64>,
}

impl SpatialInertia {
    /// From mass (kg), centre of mass (m) and rotational inertia about that centre (kg m^2), world axes.
    pub(crate) fn new(mass: f64, com: Vector3<f64>, about_com: Matrix3<f64>) -> Self {
        let parallel_axis = (Matrix3::identity() * com.dot(&com) - com * com.transpose()) * mass;
        Self { mass, moment: com * mass, rotational: about_com + parallel_axis }
    }

    /// Momentum of the body in the motion `m`, or the force that the acceleration `m` needs.
    #[inline]
    pub(crate) fn apply(&self, m: &SpatialVector) -> SpatialVector {
        SpatialVector::new(
            self.rotational * m.ang + self.moment.cross(&m.lin),
            m.lin * self.mass - self.moment.cross(&m.ang),
        )
    }
}

impl Add for SpatialInertia {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self {
            mass: self.mass + o.mass,
            moment: self.moment + o.moment,
            rotational: self.rotational + o.rotational,
        }
    }
}

/// The matrix of the cross product: skew(a) b = a x b.
#[inline]
pub(crate) fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}
