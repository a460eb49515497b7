//! The differential filter of Section VI, which estimates joint velocities from joint positions, and the compensation of its lag by
//! the accelerations of the model.

use upswing_model::{JointVector, Sizes};

/// The share 1 - exp(-t / T_1) of a change that a lag T_1 follows in a number of cycles.
#[derive(Clone, Copy, Debug)]
struct Lag {
    /// Cycle time T_s, s.
    period: f64,
    /// T_1, s.
    time_constant: f64,
    /// That of one cycle.
    of_one: f64,
}

impl Lag {
    fn new(period: f64, time_constant: f64) -> Self {
        let of_one = -libm::expm1(-period / time_constant);
        Self { period, time_constant, of_one }
    }

    fn share(&self, cycles: u64) -> f64 {
        if cycles == 1 {
            self.of_one
        } else {
            -libm::expm1(-(cycles as f64) * self.period / self.time_constant)
        }
    }
}

/// s / (T_1 s + 1) for every joint, discretised exactly for positions that are constant over a cycle.
///
/// With the state z: v = (q - z) / T_1 and, one cycle T_s later, z + (1 - exp(-T_s / T_1)) (q - z). The first
/// sample sets z = q, so that v = 0.
#[derive(Clone, Debug)]
pub struct DifferentialFilter {
    lag: Lag,
    /// z and the last q; `None` before the first sample.
    state: Option<(JointVector, JointVector)>,
}

impl DifferentialFilter {
    /// Creates a filter with the cycle time T_s = `period` and the time constant T_1, both in s and above 0.
    pub fn new(period: f64, time_constant: f64) -> Self {
        Self { lag: Lag::new(period, time_constant), state: None }
    }

    /// Resets the filter: the next sample is its first.
    pub fn reset(&mut self) {
        self.state = None;
    }

    /// Shifts the zeros of the joints, so that their positions grow by `offset`; their velocities do not change.
    pub fn shift(&mut self, offset: &JointVector) {
        if let Some((z, q)) = &mut self.state {
            *z += offset;
            *q += offset;
        }
    }

    /// The last sample.
    pub fn last(&self) -> Option<&JointVector> {
        self.state.as_ref().map(|(_, q)| q)
    }

    /// Takes the sample `q`, `cycles` cycles after the previous one; returns v.
    #[inline(always)]
    pub fn update(&mut self, q: &JointVector, cycles: u64) -> JointVector {
        let z = match &self.state {
            None => *q,
            Some((z, last)) => z + (last - z) * self.lag.share(cycles),
        };
        self.state = Some((z, *q));
        (q - z) / self.lag.time_constant
    }
}

/// Compensates the lag of the differential filter: with v = qd / (T_1 s + 1) and a = qdd / (T_1 s + 1), v + T_1 a = qd.
///
/// The model predicts the acceleration. An error of this acceleration causes an error of T_1 times as much in the
/// velocity, while the filter alone has an error of T_1 times the whole acceleration.
#[derive(Clone, Debug)]
pub struct LagCompensation {
    lag: Lag,
    /// The filtered acceleration a.
    acceleration: JointVector,
}

impl LagCompensation {
    /// Creates the compensation for a filter of a chain of `sizes` with the cycle time T_s = `period` and the time constant T_1, both in s
    /// and above 0.
    pub fn new(sizes: Sizes, period: f64, time_constant: f64) -> Self {
        Self { lag: Lag::new(period, time_constant), acceleration: JointVector::zeros(sizes) }
    }

    /// Resets the filtered acceleration to 0.
    pub fn reset(&mut self) {
        self.acceleration = JointVector::zeros(self.acceleration.sizes());
    }

    /// Takes the acceleration `qdd` of the last `cycles` cycles; returns T_1 a.
    #[inline(always)]
    pub fn update(&mut self, qdd: &JointVector, cycles: u64) -> JointVector {
        self.acceleration += (qdd - self.acceleration) * self.lag.share(cycles);
        self.acceleration * self.lag.time_constant
    }
}
