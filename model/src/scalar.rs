//! The numbers with which the recursions over the chain compute.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A number of the recursions over the chain: a single one (`f64`), or several evaluations side by side ([`Lanes`]).
pub trait Scalar:
    Copy
    + Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Mul<f64, Output = Self>
{
    /// 0
    const ZERO: Self;

    /// The constant `v`.
    fn constant(v: f64) -> Self;

    /// Sine and cosine of the number in rad.
    fn sin_cos(self) -> (Self, Self);
}

impl Scalar for f64 {
    const ZERO: Self = 0.0;

    #[inline(always)]
    fn constant(v: f64) -> Self {
        v
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        libm::sincos(self)
    }
}

/// One number of each of `L` evaluations, for example of the states at `L` knots. Each operation is that of `f64` in each lane, so that
/// an evaluation has the same bits as one alone.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub struct Lanes<const L: usize>(pub [f64; L]);

macro_rules! lane_operations {
    ($($trait:ident $function:ident $operator:tt;)*) => {$(
        impl<const L: usize> $trait for Lanes<L> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                let mut out = self.0;
                for i in 0..L {
                    out[i] = self.0[i] $operator other.0[i];
                }
                Self(out)
            }
        }
    )*};
}

lane_operations! {
    Add add +;
    Sub sub -;
    Mul mul *;
    Div div /;
}

impl<const L: usize> Neg for Lanes<L> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|v| -v))
    }
}

impl<const L: usize> AddAssign for Lanes<L> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const L: usize> SubAssign for Lanes<L> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<const L: usize> Mul<f64> for Lanes<L> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Self([factor; L])
    }
}

impl<const L: usize> Scalar for Lanes<L> {
    const ZERO: Self = Self([0.0; L]);

    #[inline(always)]
    fn constant(v: f64) -> Self {
        Self([v; L])
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (mut sin, mut cos) = ([0.0; L], [0.0; L]);
        for i in 0..L {
            (sin[i], cos[i]) = libm::sincos(self.0[i]);
        }
        (Self(sin), Self(cos))
    }
}
