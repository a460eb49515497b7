//! Integration of the dynamics over time.

use crate::State;

/// One step of the classical Runge-Kutta method of order 4: the state after `h` (s) from `x` (rad, rad/s) under dx/dt = `f`(x).
///
/// # Errors
/// The first error of `f`.
pub fn runge_kutta_step<E>(
    x: &State,
    h: f64,
    mut f: impl FnMut(&State) -> Result<State, E>,
) -> Result<State, E> {
    let k1 = f(x)?;
    let k2 = f(&(x + k1 * (0.5 * h)))?;
    let k3 = f(&(x + k2 * (0.5 * h)))?;
    let k4 = f(&(x + k3 * h))?;
    Ok(x + (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0))
}
