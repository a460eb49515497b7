//! From measurements to the state x = [q, qd], and whether it can be trusted.

use crate::checks::Checks;
use crate::filter::DifferentialFilter;
use crate::trip::{Trip, TripCause};
use std::f64::consts::{PI, TAU};
use upswing_config::CycleSettings;
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
    /// x = [q, qd], measured and filtered, rad and rad/s.
    pub x: State,
    /// What speaks against using the newest measurement.
    pub unfit: Option<Trip>,
    /// Whether every drive is powered.
    pub drives_ready: bool,
    /// `seq` of the newest measurement, and of the newest that entered the filter.
    seq: u64,
    filtered_seq: u64,
    /// Code of the plant's clock.
    clock: u64,
    /// Cycles without a new measurement.
    age: u32,
    /// Whole turns of q8 that do not count any more, rad.
    turned: f64,
}

impl Observer {
    /// An observer that has seen nothing.
    pub fn new(cycle: &CycleSettings) -> Self {
        Self {
            filter: DifferentialFilter::new(cycle.period.as_secs_f64(), cycle.velocity_filter),
            x: State::zeros(),
            unfit: Some(Trip::plain(TripCause::NoMeasurement)),
            drives_ready: false,
            seq: 0,
            filtered_seq: 0,
            clock: 0,
            age: 0,
            turned: 0.0,
        }
    }

    /// Takes in the newest measurement, whether or not it is new: whether it is, and whether a restart of the plant was
    /// noticed. `braked`: the brakes hold; what the robot did then is no fault.
    pub fn observe(
        &mut self,
        measurement: &Measurement,
        checks: &Checks,
        braked: bool,
        warnings: &mut u64,
    ) -> (bool, Option<Trip>) {
        if measurement.seq == self.seq {
            self.age = self.age.saturating_add(1);
            if measurement.clock() == Ok(Clock::Wall) && self.seq > 0 {
                self.unfit = checks.age(self.age, warnings).or(self.unfit);
            }
            return (false, None);
        }
        let restarts = measurement.seq < self.seq || (self.seq > 0 && measurement.clock != self.clock);
        let restarted = restarts.then(|| self.restart());
        if measurement.seq == 0 {
            return (false, restarted);
        }
        let missed = if self.seq == 0 { 0 } else { measurement.seq - self.seq - 1 };
        (self.seq, self.clock, self.age) = (measurement.seq, measurement.clock, 0);
        self.drives_ready = measurement.status & Measurement::DRIVES_READY != 0;
        self.unfit = checks.measurement(measurement, warnings);
        if checks.finite(measurement).is_some() {
            return (true, restarted);
        }
        let gap = checks.gap(missed, warnings).filter(|_| !braked);
        self.unfit = self.unfit.or(gap);
        let q = self.position(measurement);
        let cycles = self.seq - self.filtered_seq;
        let last = self.filter.last();
        if let Some(trip) = last.and_then(|last| checks.jump(last, &q, cycles, warnings)) {
            self.filter.reset();
            // Somebody may have moved the robot by other means.
            self.unfit = self.unfit.or(Some(trip).filter(|_| !braked));
        }
        self.x = state(&q, &self.filter.update(&q, cycles));
        self.filtered_seq = self.seq;
        let arm = checks.arm(&self.x, warnings);
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
        self.filter.reset();
        (self.seq, self.filtered_seq, self.age, self.turned) = (0, 0, 0, 0.0);
        self.unfit = Some(trip);
        trip
    }
}
