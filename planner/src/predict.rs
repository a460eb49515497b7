//! Prediction of the state of a moving system at the start of a plan.

use std::convert::Infallible;
use upswing_config::HoldGains;
use upswing_model::{ActuatedVector, Model, State, Workspace, runge_kutta_step};

/// Predicts the state `seconds` after `x` (rad, rad/s) while the daemon holds the arm at `q_hold` (rad) and the pendulum
/// swings freely; classical Runge-Kutta method with steps of at most a millisecond.
///
/// The certificate of a trajectory uses another method, with error control, so that no trajectory is verified by the method
/// that predicted its start.
pub fn held(
    model: &Model,
    gains: &HoldGains,
    x: &State,
    q_hold: &ActuatedVector,
    seconds: f64,
    work: &mut Workspace,
) -> State {
    /// Largest step, s.
    const STEP: f64 = 1e-3;
    let mut f = |x: &State| {
        let (q, qd) = (x.q_a(), x.qd_a());
        let u = ActuatedVector::from_fn(x.sizes(), |i| {
            gains.stiffness[i] * (q_hold[i] - q[i]) - gains.damping[i] * qd[i]
        });
        Ok::<_, Infallible>(model.f(x, &u, work))
    };
    let steps = (seconds / STEP).ceil().max(1.0);
    let h = seconds / steps;
    let mut x = *x;
    for _ in 0..steps as usize {
        let Ok(next) = runge_kutta_step(&x, h, &mut f);
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::held;
    use upswing_config::{Config, PendulumStart};
    use upswing_model::Workspace;

    fn rest(config: &Config) -> upswing_model::State {
        let q = [0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0].map(f64::to_radians);
        config.start_state(&q, PendulumStart::Rest).expect("a start at rest")
    }

    #[test]
    fn a_system_at_rest_stays() {
        let config = Config::embedded().expect("embedded settings");
        let x = rest(&config);
        let q_hold = x.q_a();
        let later = held(&config.model, &config.daemon.hold, &x, &q_hold, 0.5, &mut Workspace::default());
        assert!((later - x).amax() < 1e-9, "moved by {:e}", (later - x).amax());
    }

    #[test]
    fn energy_of_a_free_swing_is_kept_and_two_halves_make_a_whole() {
        let config = Config::embedded().expect("embedded settings");
        let mut work = Workspace::default();
        let mut x = rest(&config);
        x.q_u_mut()[1] += 0.3;
        let q_hold = x.q_a();
        let mut go = |x, seconds| held(&config.model, &config.daemon.hold, x, &q_hold, seconds, &mut work);
        let (half, whole) = (go(&x, 0.2), go(&x, 0.4));
        assert!((go(&half, 0.2) - whole).amax() < 1e-10);
        assert!((whole - x).amax() > 0.1, "the pendulum swings");
        let energy = |x| config.model.energy(x, &mut Workspace::default());
        assert!((energy(&whole) - energy(&x)).abs() < 1e-6);
    }
}
