//! The numbers of joints that the solvers are compiled for, and conversions to their types.

use nalgebra::SVector;
use upswing_model::Sizes;

/// n_A, n_U, n, and the dimensions of x and z.
pub(crate) const NU: usize = 7;
pub(crate) const N_UNACTUATED: usize = 2;
pub(crate) const NQ: usize = NU + N_UNACTUATED;
pub(crate) const NX: usize = 2 * NQ;
pub(crate) const NZ: usize = NX + NU;

pub(crate) type State = SVector<f64, NX>;
pub(crate) type ActuatedVector = SVector<f64, NU>;

/// The solvers are not compiled for a chain of these sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "optimisation serves chains of {NU} actuated and {N_UNACTUATED} unactuated joints, got {} and {}",
    .sizes.actuated(),
    .sizes.unactuated()
)]
pub struct UnsupportedSizes {
    /// Sizes of the chain.
    pub sizes: Sizes,
}

/// Checks that the solvers serve chains of these sizes; they panic for others.
///
/// # Errors
/// [`UnsupportedSizes`] if they do not.
pub fn check_sizes(sizes: Sizes) -> Result<(), UnsupportedSizes> {
    let served = sizes.actuated() == NU && sizes.unactuated() == N_UNACTUATED;
    served.then_some(()).ok_or(UnsupportedSizes { sizes })
}

/// The vector of `values`, of which there are D.
#[inline]
pub(crate) fn vector<const D: usize>(values: &[f64]) -> SVector<f64, D> {
    assert_eq!(values.len(), D, "a chain that the solvers are not compiled for");
    SVector::from_column_slice(values)
}
