//! Disturbance estimate: the torque on the actuated joints besides the commanded one that the model does not explain
//! (friction, another mass, an offset of a torque sensor). It is subtracted from the command.
//!
//! The torque law (24) with tau = M~ u + ... - tau^ makes the arm follow M~ (qdd_A - u) = tau_d - tau^ with an unknown
//! tau_d. The filtered velocity v lags by T_1; with u and tau^ filtered by the same lag (u_f, tau^_f),
//! tau^' = L (M~ (v' - u_f) + tau^_f - tau^) is tau^ = L / (s + L) 1 / (T_1 s + 1) tau_d: it converges to a constant tau_d within
//! a few 1 / L, and an exact model gives tau^ = 0. The state is a torque, not an acceleration: where M~ is nearly
//! singular (on the arm q2 near 0, axes 1 and 3 parallel), the corresponding acceleration changes quickly. The paper has no such estimate.
//!
//! L is a function of M~, L(M~) = L_heavy + (L_light - L_heavy) m (M~ + m)^-1, so that each direction has the bandwidth of its
//! inertia: a torque accelerates a light direction more, and the noise of its velocity is the noise of a smaller torque.
//!
//! Where M~ is nearly singular, 0.5 N m accelerate the arm so much that L is too slow when the brakes open. Torque sensors on the link side
//! measure the load that the brakes hold: its part that gravity does not explain is tau_d before anything moves.

use upswing_config::DisturbanceSettings;
use upswing_model::{ActuatedMatrix, ActuatedVector, JointVector};

/// Motion for which a command was computed.
#[derive(Clone, Copy, Debug)]
pub struct CommandedMotion<'a> {
    /// qdd = [u, qdd_U].
    pub qdd: &'a JointVector,
    /// M~.
    pub reduced_inertia: &'a ActuatedMatrix,
}

/// Shares of a change that the filters take in a cycle; cycles are as long as each other, so that they are rarely computed.
#[derive(Clone, Copy, Debug)]
struct Shares {
    /// Length of the cycle, s.
    elapsed: f64,
    /// Of the velocity filter.
    lag: f64,
    /// With the bandwidths L_heavy and L_light.
    heavy: f64,
    light: f64,
}

impl Shares {
    fn new(settings: &DisturbanceSettings, time_constant: f64, elapsed: f64) -> Self {
        let share = |rate: f64| -libm::expm1(-elapsed * rate);
        Self {
            elapsed,
            lag: -libm::expm1(-elapsed / time_constant),
            heavy: share(settings.bandwidth),
            light: share(settings.light_bandwidth),
        }
    }
}

/// Disturbance estimate with its filter states.
#[derive(Clone, Debug)]
pub struct DisturbanceEstimate {
    /// L_heavy, L_light, and the inertia m at their mean.
    settings: DisturbanceSettings,
    /// Largest tau^: a larger torque is a collision or a fault, not a disturbance.
    most: ActuatedVector,
    /// Time constant T_1 of the velocity filter, s.
    time_constant: f64,
    shares: Shares,
    /// tau^
    estimate: ActuatedVector,
    /// tau^ without its limit, with the bandwidth L_heavy.
    unlimited: ActuatedVector,
    lagging_estimate: ActuatedVector,
    /// u_f
    lagging_input: ActuatedVector,
    /// The last v; `None` before the first.
    last: Option<ActuatedVector>,
    /// Time over which loads have been averaged, s.
    weighed: f64,
}

impl DisturbanceEstimate {
    /// Creates an estimate of 0 with the limit `most` and the time constant T_1 (s) of the velocity filter.
    pub fn new(settings: &DisturbanceSettings, most: ActuatedVector, time_constant: f64) -> Self {
        let none = ActuatedVector::zeros(most.sizes());
        Self {
            settings: *settings,
            most,
            time_constant,
            shares: Shares { elapsed: 0.0, lag: 0.0, heavy: 0.0, light: 0.0 },
            estimate: none,
            unlimited: none,
            lagging_estimate: none,
            lagging_input: none,
            last: None,
            weighed: 0.0,
        }
    }

    /// The estimate tau^.
    pub fn estimate(&self) -> &ActuatedVector {
        &self.estimate
    }

    /// The unexplained torque: tau^ without its limit.
    pub fn unexplained(&self) -> &ActuatedVector {
        &self.unlimited
    }

    /// Resets the estimate to 0, for closed brakes.
    pub fn reset(&mut self) {
        *self = Self::new(&self.settings, self.most, self.time_constant);
    }

    /// Updates the estimate with the torque `d` on an arm at rest behind closed brakes, `elapsed` (s) after the previous one:
    /// first as a mean, later with the bandwidth L. A torque beyond the largest estimate on any joint is no offset of a
    /// sensor (a wrong model, a robot that leans on something) and resets the estimate.
    pub fn weigh(&mut self, d: &ActuatedVector, elapsed: f64) {
        if self.settings.bandwidth == 0.0 || !(elapsed > 0.0) {
            return;
        }
        if !d.iter().zip(self.most.iter()).all(|(d, most)| d.abs() <= *most) {
            self.reset();
            return;
        }
        self.weighed += elapsed;
        let share = (elapsed / self.weighed).max(-libm::expm1(-elapsed * self.settings.bandwidth));
        let estimate = self.estimate + (d - self.estimate) * share;
        *self = Self { weighed: self.weighed, ..Self::new(&self.settings, self.most, self.time_constant) };
        (self.estimate, self.unlimited, self.lagging_estimate) = (estimate, estimate, estimate);
    }

    /// Updates the estimate with the filtered velocity `v`, `elapsed` (s) after the previous one. `motion`: the motion for
    /// which the command in between was computed; `None` if the torque limiter cut the command, so that the arm moved otherwise:
    /// then the estimate stays as it is.
    #[inline(always)]
    pub fn update(&mut self, v: &ActuatedVector, motion: Option<CommandedMotion<'_>>, elapsed: f64) {
        if self.settings.bandwidth == 0.0 || !(elapsed > 0.0) {
            return;
        }
        let last = self.last.replace(*v);
        let (Some(last), Some(CommandedMotion { qdd, reduced_inertia })) = (last, motion) else { return };
        let u = qdd.actuated();
        if elapsed != self.shares.elapsed {
            self.shares = Shares::new(&self.settings, self.time_constant, elapsed);
        }
        let Shares { lag, heavy, .. } = self.shares;
        self.lagging_input += (u - self.lagging_input) * lag;
        self.lagging_estimate += (self.estimate - self.lagging_estimate) * lag;
        let unexplained = (v - last) / elapsed - self.lagging_input;
        let torque = reduced_inertia * &unexplained + self.lagging_estimate;
        self.unlimited += (torque - self.unlimited) * heavy;
        let estimate = self.estimate + self.share(reduced_inertia, &(torque - self.estimate), &self.shares);
        self.estimate = estimate.inf(&self.most).sup(&-self.most);
    }

    /// Part of `change` by which the estimate changes in a cycle, for the inertia M~.
    #[inline(always)]
    fn share(
        &self,
        inertia: &ActuatedMatrix,
        change: &ActuatedVector,
        &Shares { heavy, light, .. }: &Shares,
    ) -> ActuatedVector {
        let light_inertia = self.settings.light_inertia;
        let taken = change * heavy;
        if light <= heavy {
            return taken;
        }
        match inertia.solve_shifted(light_inertia, change) {
            Some(solved) => taken + solved * ((light - heavy) * light_inertia),
            None => taken,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CommandedMotion, DisturbanceEstimate, Shares};
    use nalgebra::{DMatrix, DVector};
    use upswing_config::{Config, DisturbanceSettings, PendulumStart};
    use upswing_model::{
        ActuatedMatrix, ActuatedVector, JointVector, Sizes, State, UnactuatedVector, Workspace,
    };

    const T_S: f64 = 125e-6;
    const T_1: f64 = 0.012;
    const L: f64 = 40.0;

    /// Those of the arm.
    fn sizes() -> Sizes {
        Sizes::new(9, 7).expect("sizes")
    }

    fn of_arm(values: [f64; 7]) -> ActuatedVector {
        ActuatedVector::from_slice(sizes(), &values).expect("seven joints")
    }

    fn all(value: f64) -> ActuatedVector {
        ActuatedVector::repeat(sizes(), value)
    }

    /// Updates the estimate with the velocity `v` (rad/s) after the input `u` (rad/s^2) and the inertia `reduced_inertia` (kg m^2).
    fn update(
        estimate: &mut DisturbanceEstimate,
        v: &ActuatedVector,
        u: &ActuatedVector,
        reduced_inertia: &ActuatedMatrix,
    ) {
        let qdd = JointVector::joined(u, &UnactuatedVector::zeros(u.sizes()));
        estimate.update(v, Some(CommandedMotion { qdd: &qdd, reduced_inertia }), T_S);
    }

    /// Settings with the same bandwidth in all directions.
    fn settings() -> DisturbanceSettings {
        DisturbanceSettings { bandwidth: L, light_bandwidth: L, light_inertia: 0.05, most: 1.0 }
    }

    /// Simulates the arm under a changing input and the torque `d`, with the velocity filter. Returns the largest
    /// difference between the estimate and `d` after `seconds`, N m, and the estimate.
    fn after(seconds: f64, d: &ActuatedVector, settings: &DisturbanceSettings) -> (f64, ActuatedVector) {
        let config = Config::embedded().expect("embedded settings");
        let q = [0.3, -0.4, 0.1, -1.4, 0.2, 0.3, 0.0];
        let mut x: State = config.start_state(&q, PendulumStart::Rest).expect("a start at rest");
        let model = &config.model;
        let mut work = Workspace::default();
        let inertia_inverse = |x: &State| {
            let mut work = Workspace::default();
            let zero = model.torque(x, &all(0.0), &mut work);
            let column = |i: usize, work: &mut Workspace| {
                let mut unit = all(0.0);
                unit[i] = 1.0;
                model.torque(x, &unit, work) - zero
            };
            let columns: Vec<_> = (0..7).map(|i| column(i, &mut work)).collect();
            DMatrix::from_fn(7, 7, |i, j| columns[j][i]).try_inverse().expect("regular")
        };
        let mut estimate = DisturbanceEstimate::new(settings, all(30.0), T_1);
        let (mut filtered, mut u) = (all(0.0), all(0.0));
        for i in 0..(seconds / T_S) as usize {
            update(&mut estimate, &filtered, &u, &model.reduced_inertia(&mut work));
            u = ActuatedVector::from_fn(sizes(), |j| (10.0 * i as f64 * T_S + j as f64).sin());
            let inverse = inertia_inverse(&x);
            model.torque(&x, &u, &mut work);
            let unexplained = inverse * DVector::from_column_slice(&(d - estimate.estimate()));
            let u_real = u + ActuatedVector::from_fn(sizes(), |i| unexplained[i]);
            let f = model.f(&x, &u_real, &mut Workspace::default());
            x += f * T_S;
            let v = x.qd_a();
            filtered += (v - filtered) * T_S / T_1;
        }
        ((estimate.estimate() - d).amax(), *estimate.estimate())
    }

    #[test]
    fn an_exact_model_leaves_nothing_whatever_the_input() {
        let (left, _) = after(0.3, &all(0.0), &settings());
        assert!(left < 0.05, "{left} N m");
    }

    #[test]
    fn a_constant_torque_is_known_after_a_few_time_constants() {
        let d = of_arm([3.0, -2.0, 1.0, 0.5, 0.1, -0.2, 0.05]);
        // 1 - exp(-t L), delayed by the filter.
        let early = after(1.0 / L, &d, &settings()).1[0];
        assert!(early > 0.3 * d[0] && early < 0.7 * d[0], "{early} of {} N m after 1 / L", d[0]);
        let (left, _) = after(0.3, &d, &settings());
        assert!(left < 0.05, "off by {left} N m after 12 / L");
    }

    #[test]
    fn what_is_light_is_known_sooner_and_what_is_heavy_as_before() {
        let faster = DisturbanceSettings { light_bandwidth: 10.0 * L, ..settings() };
        assert!(after(0.3, &all(0.0), &faster).0 < 0.05, "an exact model leaves nothing");
        // Joint 7 has 0.002 kg m^2.
        let d = of_arm([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.05]);
        let share = |settings| after(1.0 / L, &d, settings).1[6] / d[6];
        let (same, sooner) = (share(&settings()), share(&faster));
        assert!(same < 0.5 && sooner > 0.65, "{same} and {sooner} of it after 1 / L");
        // For the inertia m the bandwidth is the mean of both.
        let estimate = DisturbanceEstimate::new(&faster, all(30.0), T_1);
        for (inertia, bandwidth) in [(1e-6, 10.0 * L), (faster.light_inertia, 5.5 * L), (1e6, L)] {
            let inertia = ActuatedMatrix::from_diagonal_element(sizes(), inertia);
            let shares = Shares::new(&faster, T_1, 1e-6);
            let taken = estimate.share(&inertia, &all(1.0), &shares).amax() * 1e6;
            assert!((taken - bandwidth).abs() < 1e-3 * bandwidth, "{taken} instead of {bandwidth} rad/s");
        }
    }

    #[test]
    fn it_waits_while_the_limiter_cuts_and_forgets_at_a_reset() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        let none = all(0.0);
        model.torque(&x, &none, &mut work);
        let mut estimate = DisturbanceEstimate::new(&settings(), all(30.0), T_1);
        update(&mut estimate, &none, &none, &model.reduced_inertia(&mut work));
        update(&mut estimate, &all(0.1), &none, &model.reduced_inertia(&mut work));
        let known = *estimate.estimate();
        assert!(known.amax() > 0.0);
        estimate.update(&all(0.5), None, T_S);
        assert_eq!(*estimate.estimate(), known);
        estimate.reset();
        assert_eq!(*estimate.estimate(), none);
    }

    #[test]
    fn a_blow_moves_it_no_further_than_allowed() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        let none = all(0.0);
        model.torque(&x, &none, &mut work);
        let most = of_arm([3.0, 3.0, 2.0, 2.0, 1.0, 0.4, 0.4]);
        let mut estimate = DisturbanceEstimate::new(&settings(), most, T_1);
        update(&mut estimate, &none, &none, &model.reduced_inertia(&mut work));
        update(&mut estimate, &all(2.0), &none, &model.reduced_inertia(&mut work));
        let got = estimate.estimate();
        assert!((0..7).all(|i| got[i].abs() <= most[i]) && got[1].abs() == most[1], "{got:?}");
    }

    #[test]
    fn a_load_behind_closed_brakes_is_known_at_once_and_averaged() {
        let most = all(2.0);
        let mut estimate = DisturbanceEstimate::new(&settings(), most, T_1);
        let d = of_arm([0.5, -0.2, 0.1, 0.0, 0.3, -0.4, 0.05]);
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
            assert_eq!(*estimate.estimate(), all(0.0), "{bad} N m");
            estimate.weigh(&d, T_S);
            assert_eq!(*estimate.estimate(), d, "begins anew after {bad} N m");
        }
    }

    #[test]
    fn without_bandwidth_there_is_no_estimate() {
        let config = Config::embedded().expect("embedded settings");
        let (model, mut work) = (&config.model, Workspace::default());
        let x = config.start_state(&[0.0; 7], PendulumStart::Zero).expect("a start");
        model.torque(&x, &all(0.0), &mut work);
        let mut estimate =
            DisturbanceEstimate::new(&DisturbanceSettings { bandwidth: 0.0, ..settings() }, all(30.0), T_1);
        for i in 0..10 {
            update(&mut estimate, &all(f64::from(i)), &all(0.0), &model.reduced_inertia(&mut work));
        }
        estimate.weigh(&all(0.1), T_S);
        assert_eq!(*estimate.estimate(), all(0.0));
    }
}
