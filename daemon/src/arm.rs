//! The reference of the arm in Hold and Stop: a pose, or the way to rest.

use upswing_config::{DaemonSettings, HoldGains};
use upswing_model::{ActuatedVector, NQ, NU, State};

/// Speed below which a joint counts as at rest, rad/s, and how long it has to stay there, ns. A pendulum that swings
/// freely leaves joints 5 and 7 some 0.05 rad/s.
const REST_SPEED: f64 = 0.1;
const REST_TIME_NS: u64 = 50_000_000;

/// A pose of the arm to hold, or on its way to rest.
#[derive(Clone, Debug)]
pub struct ArmReference {
    gains: HoldGains,
    deceleration: [f64; NU],
    /// rad and rad/s.
    q: ActuatedVector,
    qd: ActuatedVector,
    /// Since when the arm has been at rest, ns.
    rest_since: Option<u64>,
}

impl ArmReference {
    /// The zero pose, with the gains and decelerations of the settings.
    pub fn new(settings: &DaemonSettings) -> Self {
        Self {
            gains: settings.hold,
            deceleration: settings.stop_deceleration,
            q: ActuatedVector::zeros(),
            qd: ActuatedVector::zeros(),
            rest_since: None,
        }
    }

    /// Stands still in the pose of `x` (rad, rad/s).
    pub fn hold(&mut self, x: &State) {
        self.q = x.fixed_rows::<NU>(0).into();
        self.qd = ActuatedVector::zeros();
    }

    /// Begins to decelerate from the pose and velocity of `x` (rad, rad/s).
    pub fn stop(&mut self, x: &State) {
        self.q = x.fixed_rows::<NU>(0).into();
        self.qd = x.fixed_rows::<NU>(NQ).into();
        self.rest_since = None;
    }

    /// Decelerates as set for `elapsed` s; returns u_d, rad/s^2.
    pub fn decelerate(&mut self, elapsed: f64) -> ActuatedVector {
        let mut u_d = ActuatedVector::zeros();
        for i in 0..NU {
            let (v, a) = (self.qd[i], self.deceleration[i]);
            let braking = elapsed.min(v.abs() / a);
            self.qd[i] = if braking < elapsed { 0.0 } else { v - v.signum() * a * braking };
            self.q[i] += 0.5 * (v + self.qd[i]) * braking;
            if self.qd[i] != 0.0 {
                u_d[i] = -v.signum() * a;
            }
        }
        u_d
    }

    /// Whether reference and arm have been at rest for a while at the time `now`, ns.
    pub fn is_settled(&mut self, x: &State, now: u64) -> bool {
        let speed = x.fixed_rows::<NU>(NQ).amax();
        if !(self.qd.amax() == 0.0 && speed < REST_SPEED) {
            self.rest_since = None;
            return false;
        }
        let since = *self.rest_since.get_or_insert(now);
        now.saturating_sub(since) >= REST_TIME_NS
    }

    /// x_d; the pendulum has no reference: it is where it is.
    pub fn state(&self, x: &State) -> State {
        let mut x_d = *x;
        x_d.fixed_rows_mut::<NU>(0).copy_from(&self.q);
        x_d.fixed_rows_mut::<NU>(NQ).copy_from(&self.qd);
        x_d
    }

    /// u = u_d + stiffness (q_d - q) + damping (qd_d - qd), rad/s^2.
    pub fn input(&self, x: &State, u_d: &ActuatedVector) -> ActuatedVector {
        ActuatedVector::from_fn(|i, _| {
            u_d[i]
                + self.gains.stiffness[i] * (self.q[i] - x[i])
                + self.gains.damping[i] * (self.qd[i] - x[NQ + i])
        })
    }
}
