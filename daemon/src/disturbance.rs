//! What the model does not know: an estimate of the torque that acts on joints 1 to 7 besides the commanded one
//! (friction, another mass, an offset of a torque sensor), to be taken off the command.
//!
//! The torque law (24) with tau = M~ u + ... - tau^ makes the arm follow M~ (qdd_A - u) = tau_d - tau^ with an unknown
//! tau_d. The filtered velocity v lags by T_1; with u and tau^ made to lag alike (u_f, tau^_f),
//! tau^' = L (M~ (v' - u_f) + tau^_f - tau^) is tau^ = L / (s + L) 1 / (T_1 s + 1) tau_d: it knows a constant tau_d after
//! a few 1 / L, and an exact model gives tau^ = 0. It is a torque that is kept, not an acceleration: where M~ is nearly
//! singular (q2 near 0, axes 1 and 3 parallel) the acceleration that belongs to it changes quickly. The paper does without.
//!
//! There half a newton metre accelerates so much that L is too slow when the brakes open. Torque sensors on the side of the
//! links see the load that the brakes hold: what gravity does not explain of it is tau_d before anything moves.

use upswing_model::{ActuatedVector, Model, NU, Workspace};

/// The estimate and its memory.
#[derive(Clone, Debug)]
pub struct Disturbance {
    /// L, rad/s; 0 for none.
    bandwidth: f64,
    /// Largest tau^, N m: what is more is no disturbance but a collision, or nonsense.
    most: ActuatedVector,
    /// T_1, s.
    time_constant: f64,
    /// tau^ and tau^_f, N m.
    estimate: ActuatedVector,
    /// tau^ without a limit, N m.
    unlimited: ActuatedVector,
    lagging_estimate: ActuatedVector,
    /// u_f, rad/s^2.
    lagging_input: ActuatedVector,
    /// The last v, rad/s; none before the first.
    last: Option<ActuatedVector>,
    /// Since when loads have been taken in, s.
    weighed: f64,
}

impl Disturbance {
    /// With the bandwidth L (rad/s; 0 switches it off), the largest estimate (N m), and the time constant T_1 (s) of the
    /// velocity filter.
    pub fn new(bandwidth: f64, most: ActuatedVector, time_constant: f64) -> Self {
        let none = ActuatedVector::zeros();
        Self {
            bandwidth,
            most,
            time_constant,
            estimate: none,
            unlimited: none,
            lagging_estimate: none,
            lagging_input: none,
            last: None,
            weighed: 0.0,
        }
    }

    /// tau^, N m.
    pub fn estimate(&self) -> &ActuatedVector {
        &self.estimate
    }

    /// What acts besides the command however large it is, N m: tau^ without its limit.
    pub fn unexplained(&self) -> &ActuatedVector {
        &self.unlimited
    }

    /// Forgets everything: the brakes hold.
    pub fn reset(&mut self) {
        *self = Self::new(self.bandwidth, self.most, self.time_constant);
    }

    /// Takes in the torque `d` that acts on an arm at rest behind closed brakes, N m, `elapsed` (s) after the last one: the
    /// mean of what there is, later with the bandwidth L. More than the largest estimate on any joint is no offset of a
    /// sensor (a wrong model, a robot that leans on something), and not used.
    pub fn weigh(&mut self, d: &ActuatedVector, elapsed: f64) {
        if self.bandwidth == 0.0 || !(elapsed > 0.0) {
            return;
        }
        if !(0..NU).all(|i| d[i].abs() <= self.most[i]) {
            self.reset();
            return;
        }
        self.weighed += elapsed;
        let share = (elapsed / self.weighed).max(-(-elapsed * self.bandwidth).exp_m1());
        let estimate = self.estimate + (d - self.estimate) * share;
        *self = Self { weighed: self.weighed, ..Self::new(self.bandwidth, self.most, self.time_constant) };
        (self.estimate, self.unlimited, self.lagging_estimate) = (estimate, estimate, estimate);
    }

    /// Takes in the filtered velocity `v` (rad/s), `elapsed` (s) after the last one. `u` (rad/s^2) was the input to
    /// (24) in between, `work` the memory of its evaluation; `None` if the torque limiter cut it: then the arm did
    /// something else, and the estimate waits.
    pub fn update(
        &mut self,
        model: &Model,
        v: &ActuatedVector,
        u: Option<&ActuatedVector>,
        elapsed: f64,
        work: &Workspace,
    ) {
        if self.bandwidth == 0.0 || !(elapsed > 0.0) {
            return;
        }
        let last = self.last.replace(*v);
        let (Some(last), Some(u)) = (last, u) else { return };
        let lag = -(-elapsed / self.time_constant).exp_m1();
        self.lagging_input += (u - self.lagging_input) * lag;
        self.lagging_estimate += (self.estimate - self.lagging_estimate) * lag;
        let unexplained = (v - last) / elapsed - self.lagging_input;
        let torque = model.reduced_inertia_times(&unexplained, work) + self.lagging_estimate;
        let share = -(-elapsed * self.bandwidth).exp_m1();
        self.unlimited += (torque - self.unlimited) * share;
        let estimate = self.estimate + (torque - self.estimate) * share;
        self.estimate = estimate.inf(&self.most).sup(&-self.most);
    }
}

#[cfg(test)]
mod tests {
    use super::Disturbance;
    use upswing_config::{Config, PendulumStart};
    use upswing_model::{ActuatedVector, NQ, State, Workspace};

    const T_S: f64 = 125e-6;
    const T_1: f64 = 0.012;
    const L: f64 = 40.0;

    /// Joints 1 to 7 under a changing input and the torque `d` on top of it, with the filter of the velocity; the largest
    /// difference between the estimate and `d` after `seconds`, N m, and the estimate of joint 1.
    fn after(seconds: f64, d: &ActuatedVector) -> (f64, f64) {
        let config = Config::embedded().expect("embedded settings");
        let q = [0.3, -0.4, 0.1, -1.4, 0.2, 0.3, 0.0];
        let mut x: State = config.start_state(&q, PendulumStart::Rest).expect("a start at rest");
        let model = &config.model;
        let mut work = Workspace::default();
        let inertia_inverse = |x: &State| {
            let mut work = Workspace::default();
            let zero = model.torque(x, &ActuatedVector::zeros(), &mut work);
            let column = |i: usize, work: &mut Workspace| {
                let mut unit = ActuatedVector::zeros();
                unit[i] = 1.0;
                model.torque(x, &unit, work) - zero
            };
            let columns: Vec<_> = (0..7).map(|i| column(i, &mut work)).collect();
            nalgebra::SMatrix::<f64, 7, 7>::from_columns(&columns).try_inverse().expect("regular")
        };
        let mut estimate = Disturbance::new(L, ActuatedVector::repeat(30.0), T_1);
        let (mut filtered, mut u) = (ActuatedVector::zeros(), ActuatedVector::zeros());
        for i in 0..(seconds / T_S) as usize {
            estimate.update(model, &filtered, Some(&u), T_S, &work);
            u = ActuatedVector::from_fn(|j, _| (10.0 * i as f64 * T_S + j as f64).sin());
            let inverse = inertia_inverse(&x);
            model.torque(&x, &u, &mut work);
            let u_real = u + inverse * (d - estimate.estimate());
            let f = model.f(&x, &u_real, &mut Workspace::default());
            x += f * T_S;
            let v: ActuatedVector = x.fixed_rows::<7>(NQ).into();
            filtered += (v - filtered) * T_S / T_1;
        }
        ((estimate.estimate() - d).amax(), estimate.estimate()[0])
    }

    #[test]
    fn an_exact_model_leaves_nothing_whatever_the_input() {
        let (left, _) = after(0.3, &ActuatedVector::zeros());
        assert!(left < 0.05, "{left} N m");
    }

    #[test]
    fn a_constant_torque_is_known_after_a_few_time_constants() {
        let d = ActuatedVector::from_column_slice(&[3.0, -2.0, 1.0, 0.5, 0.1, -0.2, 0.05]);
        // 1 - exp(-t L), later by the lag of the filter.
        let (_, early) = after(1.0 / L, &d);
        assert!(early > 0.3 * d[0] && early < 0.7 * d[0], "{early} of {} N m after 1 / L", d[0]);
        let (left, _) = after(0.3, &d);
        assert!(left < 0.05, "off by {left} N m after 12 / L");
    }

    #[test]
    fn it_waits_while_the_limiter_cuts_and_forgets_at_a_reset() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        let none = ActuatedVector::zeros();
        model.torque(&x, &none, &mut work);
        let mut estimate = Disturbance::new(L, ActuatedVector::repeat(30.0), T_1);
        estimate.update(model, &none, Some(&none), T_S, &work);
        estimate.update(model, &ActuatedVector::repeat(0.1), Some(&none), T_S, &work);
        let known = *estimate.estimate();
        assert!(known.amax() > 0.0);
        estimate.update(model, &ActuatedVector::repeat(0.5), None, T_S, &work);
        assert_eq!(*estimate.estimate(), known);
        estimate.reset();
        assert_eq!(*estimate.estimate(), none);
    }

    #[test]
    fn a_blow_moves_it_no_further_than_allowed() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        let none = ActuatedVector::zeros();
        model.torque(&x, &none, &mut work);
        let most = ActuatedVector::from_column_slice(&[3.0, 3.0, 2.0, 2.0, 1.0, 0.4, 0.4]);
        let mut estimate = Disturbance::new(L, most, T_1);
        estimate.update(model, &none, Some(&none), T_S, &work);
        estimate.update(model, &ActuatedVector::repeat(2.0), Some(&none), T_S, &work);
        let got = estimate.estimate();
        assert!((0..7).all(|i| got[i].abs() <= most[i]) && got[1].abs() == most[1], "{got}");
    }

    #[test]
    fn a_load_behind_closed_brakes_is_known_at_once_and_averaged() {
        let most = ActuatedVector::repeat(2.0);
        let mut estimate = Disturbance::new(L, most, T_1);
        let d = ActuatedVector::from_column_slice(&[0.5, -0.2, 0.1, 0.0, 0.3, -0.4, 0.05]);
        estimate.weigh(&d, T_S);
        assert_eq!(*estimate.estimate(), d);
        estimate.weigh(&(d * 3.0), T_S);
        assert!((estimate.estimate() - d * 2.0).amax() < 1e-12, "the mean of two");
        for _ in 0..8000 {
            estimate.weigh(&d, T_S);
        }
        assert!((estimate.estimate() - d).amax() < 1e-12, "what was long ago is forgotten");
        for bad in [2.1, -2.1, f64::NAN, f64::INFINITY] {
            let mut wrong = d;
            wrong[4] = bad;
            estimate.weigh(&wrong, T_S);
            assert_eq!(*estimate.estimate(), ActuatedVector::zeros(), "{bad} N m");
            estimate.weigh(&d, T_S);
            assert_eq!(*estimate.estimate(), d, "begins anew after {bad} N m");
        }
    }

    #[test]
    fn without_bandwidth_there_is_no_estimate() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        model.torque(&x, &ActuatedVector::zeros(), &mut work);
        let mut estimate = Disturbance::new(0.0, ActuatedVector::repeat(30.0), T_1);
        for i in 0..10 {
            let v = ActuatedVector::repeat(f64::from(i));
            estimate.update(model, &v, Some(&ActuatedVector::zeros()), T_S, &work);
        }
        estimate.weigh(&ActuatedVector::repeat(0.1), T_S);
        assert_eq!(*estimate.estimate(), ActuatedVector::zeros());
    }
}
