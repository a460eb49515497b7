//! Observer: estimates the state x = [q, qd] from measurements, and decides whether a measurement can be used.

use crate::checks::Checks;
use crate::filter::{DifferentialFilter, LagCompensation};
use crate::trip::{Trip, TripCause};
use std::f64::consts::{PI, TAU};
use upswing_config::{CycleSettings, VelocityEstimate};
use upswing_ipc::{Clock, Measurement};
use upswing_model::{ActuatedVector, JointKind, JointVector, Model, Order, State};

/// Angle by which a joint may exceed half a turn before a turn is dropped, rad: so that the angle of an upright rod does not alternate.
const SLACK: f64 = 0.5;

/// Result of taking a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Whether the measurement differs from that of the previous cycle.
    pub is_new: bool,
    /// The trip for a restart of the plant; `None` without one.
    pub restarted: Option<Trip>,
}

/// Observer of the plant: the newest measurement, filtered and checked.
#[derive(Clone, Debug)]
pub struct Observer {
    order: Order,
    /// Whether each joint turns over: an unactuated joint does, unless it is prismatic.
    turns_over: Vec<bool>,
    /// Positions of the newest measurement.
    measured: JointVector,
    /// Torques of the newest measurement.
    pub tau: ActuatedVector,
    filter: DifferentialFilter,
    lag_compensation: Option<LagCompensation>,
    /// x = [q, qd]: measured positions, and filtered velocities with the compensation of their lag.
    pub x: State,
    /// Velocities of the filter without the compensation of their lag.
    pub filtered: JointVector,
    /// The trip for a newest measurement that cannot be used; `None` if it can.
    pub unfit: Option<Trip>,
    /// Whether every drive is powered.
    pub drives_ready: bool,
    /// `seq` of the newest measurement.
    seq: u64,
    filtered_seq: u64,
    /// Code of the plant's clock.
    clock: u64,
    /// Time stamp of the newest measurement, ns.
    t_ns: u64,
    /// Age of the newest measurement, cycles: since the last one with a greater number and a later time stamp.
    age: u64,
    /// Cycles between the last two measurements in the filter.
    cycles: u64,
    /// Consecutive cycles in which the drives did not act although the brakes were commanded open.
    stopped: u64,
    /// Whole turns that were dropped, rad.
    turned: JointVector,
}

impl Observer {
    /// Creates an observer of the robot `model` without a measurement.
    pub fn new(cycle: &CycleSettings, model: &Model) -> Self {
        let sizes = model.sizes();
        let turns_over = |joint| joint >= sizes.actuated() && model.joint_kind(joint) != JointKind::Prismatic;
        Self {
            order: *model.order(),
            turns_over: (0..sizes.joints()).map(turns_over).collect(),
            measured: JointVector::zeros(sizes),
            tau: ActuatedVector::zeros(sizes),
            filter: DifferentialFilter::new(cycle.period.seconds(), cycle.velocity_filter),
            lag_compensation: (cycle.velocity == VelocityEstimate::Model)
                .then(|| LagCompensation::new(sizes, cycle.period.seconds(), cycle.velocity_filter)),
            x: State::zeros(sizes),
            filtered: JointVector::zeros(sizes),
            unfit: Some(Trip::plain(TripCause::NoMeasurement)),
            drives_ready: false,
            seq: 0,
            filtered_seq: 0,
            clock: 0,
            t_ns: 0,
            age: 0,
            cycles: 0,
            stopped: 0,
            turned: JointVector::zeros(sizes),
        }
    }

    /// Whether the brakes are open and the drives powered, or the brakes were commanded closed.
    pub fn drives_act(&self) -> bool {
        self.stopped == 0
    }

    /// Cycles between the last two measurements.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }

    /// Whether no measurement has come yet, or none since the plant was lost.
    pub fn is_new(&self) -> bool {
        self.seq == 0
    }

    /// Takes the newest measurement, whether or not it is new. `now_ns`: time of the cycle, used on the clock `wall`
    /// only. `expected`: qdd for which the last command was computed; `None` if the limiter cut it. `braked`: the brakes
    /// were closed, so that motion since the previous measurement is no fault.
    #[inline(always)]
    pub fn observe(
        &mut self,
        measurement: &Measurement,
        now_ns: u64,
        checks: &mut Checks,
        expected: Option<&JointVector>,
        braked: bool,
    ) -> Observation {
        let vectors = measurement.vectors(&self.order);
        if let Ok((q, tau)) = vectors {
            (self.measured, self.tau) = (q, tau);
        }
        let wall = measurement.clock().is_ok_and(Clock::is_real_time);
        if measurement.seq == self.seq {
            if wall && self.seq > 0 {
                self.age += 1;
                self.unfit = checks.age(self.age).or(self.unfit);
            }
            return Observation { is_new: false, restarted: None };
        }
        let restarts = measurement.seq < self.seq || (self.seq > 0 && measurement.clock != self.clock);
        let restarted = restarts.then(|| self.restart());
        if measurement.seq == 0 {
            return Observation { is_new: false, restarted };
        }
        let elapsed = if self.seq == 0 { 1 } else { measurement.seq - self.seq };
        self.age = if measurement.t_ns > self.t_ns { 0 } else { self.age.saturating_add(elapsed) };
        if wall {
            let on_the_way = now_ns.saturating_sub(measurement.t_ns) / measurement.period_ns.max(1);
            self.age = self.age.max(on_the_way);
        }
        (self.seq, self.t_ns, self.clock) = (measurement.seq, measurement.t_ns, measurement.clock);
        self.drives_ready = measurement.status & Measurement::DRIVES_READY != 0;
        let acts = self.drives_ready && measurement.status & Measurement::BRAKES_CLOSED == 0;
        self.stopped = if acts || braked { 0 } else { self.stopped.saturating_add(elapsed) };
        if let Err(other) = vectors {
            self.unfit = Some(checks.other_chain(&other));
            return Observation { is_new: true, restarted };
        }
        let not_finite = checks.finite(&self.measured);
        self.unfit = checks
            .measurement(measurement, &self.tau, not_finite)
            .or(checks.age(self.age))
            .or(checks.drives(self.stopped));
        if not_finite.is_some() {
            return Observation { is_new: true, restarted };
        }
        let gap = checks.gap(elapsed - 1).filter(|_| !braked);
        self.unfit = self.unfit.or(gap);
        let q = self.position();
        let cycles = self.seq - self.filtered_seq;
        let last = self.filter.last();
        if let Some(trip) = last.and_then(|last| checks.jump(last, &q, cycles)) {
            self.forget();
            // Behind closed brakes, the robot may have been moved by hand.
            self.unfit = self.unfit.or(Some(trip).filter(|_| !braked));
        }
        self.filtered = self.filter.update(&q, cycles);
        let none = JointVector::zeros(q.sizes());
        let expected = expected.unwrap_or(&none);
        let lag = self.lag_compensation.as_mut().map_or(none, |lag| lag.update(expected, cycles));
        self.x = State::new(&q, &(self.filtered + lag));
        (self.filtered_seq, self.cycles) = (self.seq, cycles);
        // The limits apply to the measured motion of the arm, without the accelerations of the model.
        let arm = checks.arm(&q, &self.filtered);
        self.unfit = self.unfit.or(arm);
        Observation { is_new: true, restarted }
    }

    /// Measured positions without the dropped turns.
    pub fn position(&self) -> JointVector {
        self.measured - self.turned
    }

    /// Drops whole turns of the unactuated joints: a pendulum that fell over to the other side hangs at 0 again, where plans can begin.
    /// To be called only while the reference does not contain these joints.
    pub fn drop_turns(&mut self) {
        let q = self.x.q();
        let turns = JointVector::from_fn(q.sizes(), |i| {
            if self.turns_over[i] && q[i].abs() > PI + SLACK { (q[i] / TAU).round() * TAU } else { 0.0 }
        });
        if turns.amax() > 0.0 {
            self.turned += turns;
            self.x = State::new(&(q - turns), &self.x.qd());
            self.filter.shift(&-turns);
        }
    }

    /// Resets the observer for a plant that was lost or has restarted; returns the trip.
    pub fn restart(&mut self) -> Trip {
        let trip = Trip::plain(TripCause::MeasurementRestarted);
        self.forget();
        (self.seq, self.filtered_seq) = (0, 0);
        self.turned = JointVector::zeros(self.turned.sizes());
        (self.t_ns, self.age, self.stopped) = (0, 0, 0);
        self.unfit = Some(trip);
        trip
    }

    fn forget(&mut self) {
        self.filter.reset();
        if let Some(lag) = &mut self.lag_compensation {
            lag.reset();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Observer;
    use crate::checks::Checks;
    use crate::trip::TripCause;
    use std::sync::LazyLock;
    use upswing_config::{Config, VelocityEstimate};
    use upswing_ipc::{Clock, Measurement};
    use upswing_model::{ActuatedVector, JointVector};

    const PERIOD_NS: u64 = 125_000;

    static CONFIG: LazyLock<Config> = LazyLock::new(|| Config::embedded().expect("settings"));

    struct Seen {
        observer: Observer,
        checks: Checks,
    }

    impl Seen {
        fn new() -> Self {
            let config = &*CONFIG;
            Self { observer: Observer::new(&config.daemon.cycle, &config.model), checks: Checks::new(config) }
        }

        /// Takes a measurement without delay; returns the cause of a trip, and whether a restart was noticed.
        fn take(&mut self, measurement: &Measurement, braked: bool) -> (Option<TripCause>, bool) {
            let now = measurement.t_ns;
            let seen = self.observer.observe(measurement, now, &mut self.checks, None, braked);
            (self.observer.unfit.map(|trip| trip.cause), seen.restarted.is_some())
        }
    }

    fn measured(seq: u64, q: f64, clock: Clock) -> Measurement {
        let model = &CONFIG.model;
        let (q, tau) = (JointVector::repeat(model.sizes(), q), ActuatedVector::zeros(model.sizes()));
        Measurement {
            seq,
            t_ns: seq * PERIOD_NS,
            status: Measurement::DRIVES_READY,
            clock: clock.code(),
            period_ns: PERIOD_NS,
            ..Measurement::new(model.order(), &q, &tau)
        }
    }

    #[test]
    fn the_first_measurement_is_fit_whenever_it_comes() {
        for clock in [Clock::Wall, Clock::Paced, Clock::Lockstep] {
            for seq in [1, 5000] {
                let mut seen = Seen::new();
                // Before the first measurement, nothing can be too old.
                for _ in 0..100 {
                    let none =
                        Measurement { period_ns: PERIOD_NS, clock: clock.code(), ..Measurement::default() };
                    assert_eq!(seen.take(&none, true), (Some(TripCause::NoMeasurement), false));
                    assert!(seen.observer.is_new());
                }
                assert_eq!(seen.take(&measured(seq, 0.1, clock), false), (None, false), "{clock}, {seq}");
                assert!(!seen.observer.is_new());
            }
        }
    }

    #[test]
    fn another_clock_or_an_earlier_number_is_a_restart_and_forgets_the_plant_before() {
        for (seq, clock) in [(50, Clock::Lockstep), (3, Clock::Paced)] {
            // The pendulum of the first plant has turned; its time stamp has stood still for the longest time allowed.
            let mut seen = Seen::new();
            for seq in 1..=20 {
                seen.take(&measured(seq, 0.1, Clock::Paced), false);
            }
            seen.observer.x[7] = 6.5;
            seen.observer.drop_turns();
            for seq in 21..=40 {
                let stuck = Measurement { t_ns: 20 * PERIOD_NS, ..measured(seq, 0.1, Clock::Paced) };
                assert_eq!(seen.take(&stuck, false), (None, false));
            }
            // The time of the second plant begins at 0.
            for k in 0..30 {
                let next = Measurement { t_ns: k, ..measured(seq + k, 0.2, clock) };
                assert_eq!(seen.take(&next, false), (None, k == 0), "{clock}, measurement {k}");
                assert_eq!(seen.observer.position()[7], 0.2, "its turns are not those of the one before");
                assert_eq!(seen.observer.filtered.amax(), 0.0, "nor is its motion");
                assert_eq!(seen.observer.cycles(), if k == 0 { seq } else { 1 });
            }
            // The inactive drives of the first plant do not count for the second.
            let mut seen = Seen::new();
            seen.take(&measured(1, 0.1, Clock::Paced), false);
            seen.take(&Measurement { status: 0, ..measured(801, 0.1, Clock::Paced) }, false);
            let next = Measurement { status: 0, ..measured(seq, 0.1, clock) };
            assert_eq!(seen.take(&next, false), (None, true), "{clock}");
            seen.observer.restart();
            assert_eq!(seen.observer.unfit.map(|trip| trip.cause), Some(TripCause::MeasurementRestarted));
        }
    }

    #[test]
    fn whole_turns_of_the_pendulum_are_dropped_however_many_and_whichever_way() {
        for turns in [-3.0, -1.0, 1.0, 3.0] {
            let mut seen = Seen::new();
            let turn = turns * std::f64::consts::TAU;
            let mut turned = measured(1, 0.1, Clock::Paced);
            turned.q[7] += turn;
            seen.take(&turned, true);
            seen.observer.drop_turns();
            assert!((seen.observer.x[7] - 0.1).abs() < 1e-12, "{turns}: {}", seen.observer.x[7]);
            // The joint has not moved.
            let next = Measurement { seq: 2, t_ns: 2 * PERIOD_NS, ..turned };
            assert_eq!(seen.take(&next, false), (None, false), "{turns}");
            assert!((seen.observer.position()[7] - 0.1).abs() < 1e-12);
            assert!(seen.observer.filtered.amax() < 1e-9, "{:?}", seen.observer.filtered);
        }
        // The pendulum near the top may be on either side of it.
        for angle in [3.6, -3.6] {
            let mut seen = Seen::new();
            seen.take(&measured(1, angle, Clock::Paced), true);
            seen.observer.drop_turns();
            assert_eq!(seen.observer.x[7], angle);
        }
    }

    #[test]
    fn the_arm_is_as_fast_as_measured_whatever_the_model_expects() {
        let mut config = CONFIG.clone();
        config.daemon.cycle.velocity = VelocityEstimate::Model;
        let mut observer = Observer::new(&config.daemon.cycle, &config.model);
        let mut checks = Checks::new(&config);
        for seq in 1..1000 {
            let next = measured(seq, 0.1, Clock::Paced);
            let expected = JointVector::repeat(config.model.sizes(), 1e3);
            observer.observe(&next, 0, &mut checks, Some(&expected), false);
            assert_eq!(observer.unfit, None);
        }
        let qd = observer.x.qd();
        assert!(qd[0] > 5.0, "what is expected enters the state: {}", qd[0]);
    }

    #[test]
    fn a_stamp_that_does_not_go_on_is_as_old_as_the_measurements_since() {
        // A time stamp that goes back counts like one that stands still.
        for back in [0, 1] {
            let mut seen = Seen::new();
            let mut at =
                |seq, t_ns| seen.take(&Measurement { t_ns, ..measured(seq, 0.1, Clock::Paced) }, false).0;
            assert_eq!([at(1, 1), at(2, u64::MAX)], [None; 2]);
            // Every second measurement is missed.
            let unfit = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10].map(|k| at(4 + 2 * k, u64::MAX - back * k));
            assert_eq!(unfit[..10], [None; 10], "20 cycles are not too old");
            assert_eq!(unfit[10], Some(TripCause::StaleMeasurement));
        }
    }

    #[test]
    fn what_is_no_angle_enters_nothing_and_the_next_angle_has_had_the_time_since() {
        let mut seen = Seen::new();
        seen.take(&measured(1, 0.1, Clock::Paced), true);
        let x = seen.observer.x;
        for seq in 2..=10 {
            let mut bad = measured(seq, 0.1, Clock::Paced);
            bad.q[4] = f64::NAN;
            assert_eq!(seen.take(&bad, true).0, Some(TripCause::NotFinite));
            assert_eq!(seen.observer.x, x);
        }
        // An angle reached at the speed limit of the slowest joint in ten cycles; in one cycle it would be a jump.
        let q = 0.1 + 10.0 * 125e-6 * 1.3;
        assert_eq!(seen.take(&measured(11, q, Clock::Paced), false), (None, false));
        assert_eq!(seen.observer.cycles(), 10);
        assert!(seen.observer.filtered.iter().all(|v| *v > 0.1), "{:?}", seen.observer.filtered);
    }

    #[test]
    fn what_spoke_against_a_measurement_does_so_until_the_next_one() {
        let mut seen = Seen::new();
        seen.take(&measured(1, 0.1, Clock::Wall), false);
        let mut bad = measured(2, 0.1, Clock::Wall);
        bad.q[4] = f64::NAN;
        for _ in 0..3 {
            assert_eq!(seen.take(&bad, false).0, Some(TripCause::NotFinite));
        }
        assert_eq!(seen.take(&measured(3, 0.1, Clock::Wall), false).0, None);
    }

    #[test]
    fn drives_that_do_not_act_are_counted_in_cycles_not_in_measurements() {
        let mut seen = Seen::new();
        seen.take(&measured(1, 0.1, Clock::Paced), false);
        let mut at = |seq| {
            let next = Measurement { status: Measurement::BRAKES_CLOSED, ..measured(seq, 0.1, Clock::Paced) };
            seen.take(&next, false).0
        };
        // Every second measurement is missed; 800 cycles are allowed.
        assert_eq!((1..=400).find_map(|k| at(1 + 2 * k)), None);
        assert_eq!(at(803), Some(TripCause::DrivesStopped));
    }

    #[test]
    fn a_jump_behind_closed_brakes_begins_anew_and_is_none_afterwards() {
        for braked in [true, false] {
            let mut seen = Seen::new();
            seen.take(&measured(1, 0.1, Clock::Paced), braked);
            let unfit = seen.take(&measured(2, 0.9, Clock::Paced), braked).0;
            assert_eq!(unfit, (!braked).then_some(TripCause::EncoderJump));
            // The jump gives no speed: the robot was moved by other means.
            assert_eq!(seen.observer.filtered.amax(), 0.0);
            assert_eq!(seen.take(&measured(3, 0.9, Clock::Paced), braked), (None, false));
        }
    }
}
