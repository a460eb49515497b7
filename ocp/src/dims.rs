//! Compilation of the numerical routines for a list of sizes and for wide registers.
//!
//! A routine is written once, generic over [`Registers`], and compiled for sizes known at run time and for those of
//! [`with_dims`](upswing_model::with_dims), each for the registers of every CPU and for those of AVX2. [`dispatch`] chooses once per
//! public call. All instances compute the same bits: no order of a sum depends on the width of a register, and multiplications and
//! additions are not fused.

use upswing_model::Dims;

/// Dimensions of a routine, and the registers that it is compiled for.
///
/// # Safety
/// Values of a type with [`Self::AVX2`] exist only where the CPU has AVX2.
pub(crate) unsafe trait Registers: Dims {
    /// Whether the routine is compiled for AVX2.
    const AVX2: bool;
}

/// Registers that every CPU has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Baseline<D>(pub(crate) D);

/// Registers of 256 bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2<D>(D);

impl<D: Dims> Avx2<D> {
    /// `None` if the CPU does not have AVX2.
    pub(crate) fn detect(dims: D) -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Some(Self(dims));
        }
        let _ = dims;
        None
    }
}

macro_rules! registers {
    ($($name:ident: $avx2:literal;)*) => {$(
        impl<D: Dims> Dims for $name<D> {
            #[inline(always)]
            fn joints(self) -> usize {
                self.0.joints()
            }

            #[inline(always)]
            fn actuated(self) -> usize {
                self.0.actuated()
            }
        }

        // SAFETY: `Avx2::detect` alone makes a value of `Avx2`.
        unsafe impl<D: Dims> Registers for $name<D> {
            const AVX2: bool = $avx2;
        }
    )*};
}

registers! {
    Baseline: false;
    Avx2: true;
}

/// Evaluates an expression with `$d`: the dimensions of `$sizes` and the widest registers of the CPU.
macro_rules! dispatch {
    ($sizes:expr, |$d:ident| $body:expr) => {
        upswing_model::with_dims!($sizes, |dims| {
            match $crate::dims::Avx2::detect(dims) {
                Some($d) => $body,
                None => {
                    let $d = $crate::dims::Baseline(dims);
                    $body
                }
            }
        })
    };
}

/// Declares functions that are compiled for the registers of their first argument, whose type implements [`Registers`].
///
/// Each is a function of its own in the binary: inlined into a large caller, the compiler no longer knows that its slices do not
/// overlap, which costs half of the speed. Functions that it calls are inlined if they are marked so, and then compiled for the same
/// registers.
macro_rules! kernels {
    ($(
        $(#[$attribute:meta])*
        $visibility:vis fn $name:ident($d:ident: D $(, $argument:ident: $type:ty)* $(,)?) $(-> $out:ty)? $body:block
    )*) => {$(
        $(#[$attribute])*
        #[inline(always)]
        $visibility fn $name<D: $crate::dims::Registers>($d: D $(, $argument: $type)*) $(-> $out)? {
            #[inline(always)]
            fn body<D: $crate::dims::Registers>($d: D $(, $argument: $type)*) $(-> $out)? {
                // Some need its type only.
                let _ = $d;
                $body
            }

            #[inline(never)]
            fn baseline<D: $crate::dims::Registers>($d: D $(, $argument: $type)*) $(-> $out)? {
                body($d $(, $argument)*)
            }

            #[cfg(target_arch = "x86_64")]
            #[inline(never)]
            #[target_feature(enable = "avx2")]
            fn avx2<D: $crate::dims::Registers>($d: D $(, $argument: $type)*) $(-> $out)? {
                body($d $(, $argument)*)
            }

            #[cfg(target_arch = "x86_64")]
            if D::AVX2 {
                // SAFETY: a value of such a type exists only where the CPU has AVX2, as `Registers` demands.
                return unsafe { avx2($d $(, $argument)*) };
            }
            baseline($d $(, $argument)*)
        }
    )*};
}

pub(crate) use {dispatch, kernels};
