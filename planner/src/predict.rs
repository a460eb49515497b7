//! Prediction of the state of a moving system at the start of a plan.

use std::convert::Infallible;
use upswing_config::HoldGains;
use upswing_model::{ActuatedVector, Model, State, Workspace, runge_kutta_step};
use upswing_trajectory::{LoopDelays, Plan};

/// Largest step of a prediction, s.
const STEP: f64 = 1e-3;

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

/// Predicts the state `seconds` after the daemon measured `x` (rad, rad/s) at the time `t` (s) of `plan`, which it tracks.
///
/// The measured velocities lag by the time constant T_1 of the differential filter, and so do those that the feedback sees: the model
/// includes the filter. At the begin, the velocities are the measured ones and what the plan has gained within T_1.
pub fn tracked(
    model: &Model,
    delays: &LoopDelays,
    plan: &Plan,
    t: f64,
    measured: &State,
    seconds: f64,
    work: &mut Workspace,
) -> State {
    let steps = (seconds / STEP).ceil().max(1.0);
    let h = seconds / steps;
    let (mut x, mut seen) = (*measured, *measured);
    let forgotten = delays.velocity_filter.map(|t_1| {
        let gained = plan.spline().derivative(t).qd() * t_1;
        x.qd_mut().iter_mut().zip(gained.iter()).for_each(|(v, gained)| *v += gained);
        -libm::expm1(-h / t_1)
    });
    for i in 0..steps as usize {
        let u = plan.reference(t + (i as f64 + 0.5) * h).input(&seen);
        let Ok(next) = runge_kutta_step(&x, h, |x| Ok::<_, Infallible>(model.f(x, &u, work)));
        seen = match forgotten {
            None => next,
            Some(share) => {
                let v = seen.qd() + ((x.qd() + next.qd()) * 0.5 - seen.qd()) * share;
                State::new(&next.q(), &v)
            }
        };
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
