//! Sizes of a chain in numerical routines: known at run time ([`Sizes`]) or to the compiler ([`Fixed`]).
//!
//! A routine takes `d: impl Dims` and is compiled once for any sizes and once for each size of [`with_dims`](crate::with_dims), where
//! loops of known length run 1.2 to 3 times as fast. It is the same source, so that the results have the same bits.

use crate::Sizes;

/// Numbers of joints of a chain, and the dimensions that follow from them.
pub trait Dims: Copy {
    /// n
    fn joints(self) -> usize;
    /// n_A
    fn actuated(self) -> usize;

    /// n_U
    #[inline(always)]
    fn unactuated(self) -> usize {
        self.joints() - self.actuated()
    }

    /// Dimension of x = [q, qd].
    #[inline(always)]
    fn state(self) -> usize {
        2 * self.joints()
    }

    /// Dimension of z = [x, u].
    #[inline(always)]
    fn knot(self) -> usize {
        self.state() + self.actuated()
    }

    /// Length in memory of a row over x: whole registers of four numbers.
    #[inline(always)]
    fn state_row(self) -> usize {
        self.state().next_multiple_of(4)
    }

    /// Length in memory of a row over z.
    #[inline(always)]
    fn knot_row(self) -> usize {
        self.knot().next_multiple_of(4)
    }
}

impl Dims for Sizes {
    #[inline(always)]
    fn joints(self) -> usize {
        Self::joints(self)
    }

    #[inline(always)]
    fn actuated(self) -> usize {
        Self::actuated(self)
    }
}

/// `N` joints, `A` of them actuated.
#[derive(Clone, Copy, Debug)]
pub struct Fixed<const N: usize, const A: usize>;

impl<const N: usize, const A: usize> Dims for Fixed<N, A> {
    #[inline(always)]
    fn joints(self) -> usize {
        N
    }

    #[inline(always)]
    fn actuated(self) -> usize {
        A
    }
}

/// Evaluates an expression with the dimensions `$d` of the sizes `$sizes`: known to the compiler for the arm with seven actuated and two
/// unactuated joints and for chains of two joints, read at run time for all others.
#[macro_export]
macro_rules! with_dims {
    ($sizes:expr, |$d:ident| $body:expr) => {{
        let sizes: $crate::Sizes = $sizes;
        match (sizes.joints(), sizes.actuated()) {
            (9, 7) => {
                let $d = $crate::Fixed::<9, 7>;
                $body
            }
            (2, 1) => {
                let $d = $crate::Fixed::<2, 1>;
                $body
            }
            _ => {
                let $d = sizes;
                $body
            }
        }
    }};
}
