//! From measurements to the state x = [q, qd], and whether it can be trusted.

use crate::checks::Checks;
use crate::filter::{DifferentialFilter, Lead};
use crate::trip::{Trip, TripCause};
use std::f64::consts::{PI, TAU};
use upswing_config::{CycleSettings, VelocityEstimate};
use upswing_ipc::{Clock, Measurement};
use upswing_model::{JointVector, NU, State, state};

/// The first joint of the pendulum, q8: the only one that can turn over.
const Q8: usize = NU;
/// How far past half a turn q8 may be before a turn is dropped, rad: so that a rod held upright does not flicker.
const SLACK: f64 = 0.5;

/// The newest measurement, filtered and checked.
#[derive(Clone, Debug)]
pub struct Observer {
    filter: DifferentialFilter,
    lead: Option<Lead>,
    /// x = [q, qd], measured and filtered, rad and rad/s.
    pub x: State,
    /// Velocities of the filter alone, rad/s.
    pub filtered: JointVector,
    /// What speaks against using the newest measurement.
    pub unfit: Option<Trip>,
    /// Whether every drive is powered.
    pub drives_ready: bool,
    /// `seq` of the newest measurement, and of the newest that entered the filter.
    seq: u64,
    filtered_seq: u64,
    /// Code of the plant's clock.
    clock: u64,
    /// Time stamp of the newest measurement, ns.
    t_ns: u64,
    /// Cycles without a new measurement: one with the next number and a later time stamp.
    age: u64,
    /// Cycles from the last but one measurement in the filter to the last.
    cycles: u64,
    /// Cycles in which the drives did not act although the brakes were commanded open.
    stopped: u64,
    /// Whole turns of q8 that do not count any more, rad.
    turned: f64,
}

impl Observer {
    /// An observer that has seen nothing.
    pub fn new(cycle: &CycleSettings) -> Self {
        Self {
            filter: DifferentialFilter::new(cycle.period.as_secs_f64(), cycle.velocity_filter),
            lead: (cycle.velocity == VelocityEstimate::Model)
                .then(|| Lead::new(cycle.period.as_secs_f64(), cycle.velocity_filter)),
            x: State::zeros(),
            filtered: JointVector::zeros(),
            unfit: Some(Trip::plain(TripCause::NoMeasurement)),
            drives_ready: false,
            seq: 0,
            filtered_seq: 0,
            clock: 0,
            t_ns: 0,
            age: 0,
            cycles: 0,
            stopped: 0,
            turned: 0.0,
        }
    }

    /// Whether the brakes are open and the drives powered.
    pub fn drives_act(&self) -> bool {
        self.stopped == 0
    }

    /// Cycles from the last but one measurement to the last.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }

    /// Whether no plant was measured yet, or the last one is gone.
    pub fn is_new(&self) -> bool {
        self.seq == 0
    }

    /// Takes in the newest measurement, whether or not it is new: whether it is, and whether a restart of the plant was
    /// noticed. `now_ns`: the time of the cycle, which counts on the wall clock only. `expected`: qdd that the last command
    /// was meant for, rad/s^2, where that is known. `braked`: the brakes hold; what the robot did then is no fault.
    pub fn observe(
        &mut self,
        measurement: &Measurement,
        now_ns: u64,
        checks: &Checks,
        expected: Option<&JointVector>,
        braked: bool,
        warnings: &mut u64,
    ) -> (bool, Option<Trip>) {
        let wall = measurement.clock() == Ok(Clock::Wall);
        if measurement.seq == self.seq {
            if wall && self.seq > 0 {
                self.age += 1;
                self.unfit = checks.age(self.age, warnings).or(self.unfit);
            }
            return (false, None);
        }
        let restarts = measurement.seq < self.seq || (self.seq > 0 && measurement.clock != self.clock);
        let restarted = restarts.then(|| self.restart());
        if measurement.seq == 0 {
            return (false, restarted);
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
        self.unfit = checks
            .measurement(measurement, warnings)
            .or(checks.age(self.age, warnings))
            .or(checks.drives(self.stopped, warnings));
        if checks.finite(measurement).is_some() {
            return (true, restarted);
        }
        let gap = checks.gap(elapsed - 1, warnings).filter(|_| !braked);
        self.unfit = self.unfit.or(gap);
        let q = self.position(measurement);
        let cycles = self.seq - self.filtered_seq;
        let last = self.filter.last();
        if let Some(trip) = last.and_then(|last| checks.jump(last, &q, cycles, warnings)) {
            self.forget();
            // Somebody may have moved the robot by other means.
            self.unfit = self.unfit.or(Some(trip).filter(|_| !braked));
        }
        self.filtered = self.filter.update(&q, cycles);
        let expected = expected.copied().unwrap_or_default();
        let lead = self.lead.as_mut().map_or_else(JointVector::zeros, |lead| lead.update(&expected, cycles));
        self.x = state(&q, &(self.filtered + lead));
        (self.filtered_seq, self.cycles) = (self.seq, cycles);
        // What the arm really does, not what the model expects.
        let arm = checks.arm(&state(&q, &self.filtered), warnings);
        self.unfit = self.unfit.or(arm);
        (true, restarted)
    }

    /// The measured angles, q8 without the turns that do not count, rad.
    pub fn position(&self, measurement: &Measurement) -> JointVector {
        let mut q = JointVector::from(measurement.q);
        q[Q8] -= self.turned;
        q
    }

    /// Drops whole turns of q8: a pendulum that fell over to the other side hangs at 0 again, where plans can begin. Only
    /// while nothing depends on q8.
    pub fn drop_turns(&mut self) {
        let q8 = self.x[Q8];
        if q8.abs() > PI + SLACK {
            let turns = (q8 / TAU).round() * TAU;
            self.turned += turns;
            self.x[Q8] -= turns;
            self.filter.shift(Q8, -turns);
        }
    }

    /// Forgets a plant that has gone or restarted.
    pub fn restart(&mut self) -> Trip {
        let trip = Trip::plain(TripCause::MeasurementRestarted);
        self.forget();
        (self.seq, self.filtered_seq, self.turned) = (0, 0, 0.0);
        (self.t_ns, self.age, self.stopped) = (0, 0, 0);
        self.unfit = Some(trip);
        trip
    }

    fn forget(&mut self) {
        self.filter.reset();
        if let Some(lead) = &mut self.lead {
            lead.reset();
        }
    }
}
