//! From measurements to the state x = [q, qd], and whether it can be trusted.

use crate::checks::Checks;
use crate::filter::DifferentialFilter;
use crate::trip::{Trip, TripCause};
use upswing_config::CycleSettings;
use upswing_ipc::{Clock, Measurement};
use upswing_model::{JointVector, State, state};

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
        let q = JointVector::from(measurement.q);
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

    /// Forgets a plant that has gone or restarted.
    pub fn restart(&mut self) -> Trip {
        let trip = Trip::plain(TripCause::MeasurementRestarted);
        self.filter.reset();
        (self.seq, self.filtered_seq, self.age) = (0, 0, 0);
        self.unfit = Some(trip);
        trip
    }
}
